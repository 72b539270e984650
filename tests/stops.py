"""Signals sent by tests, and raised in code of jaxdet."""

import signal
import time

from jaxdet.signals import stops_held_back


def stop(number: int) -> None:
    """Send this process a signal and wait until it is raised."""
    signal.raise_signal(number)
    wait_in_jaxdet()


def wait_in_jaxdet() -> None:
    """Wait, at most 10 s, in code of jaxdet."""
    end = time.monotonic() + 10
    while time.monotonic() < end:
        with stops_held_back():
            time.sleep(0.001)
