"""Signals that tests send to their own process, for which code of jaxdet raises exceptions."""

import signal
import time

from jaxdet.signals import stops_held_back


def stop(number: int) -> None:
    """Send this process a signal and wait for the exception."""
    signal.raise_signal(number)
    wait_in_jaxdet()


def wait_in_jaxdet() -> None:
    """Run code of jaxdet for 10 s, or until it raises the exception of a signal."""
    end = time.monotonic() + 10
    while time.monotonic() < end:
        with stops_held_back():
            time.sleep(0.001)
