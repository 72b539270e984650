"""Signals that end a run: Ctrl-C, SIGTERM, and SIGHUP where it isn't ignored."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from jaxdet.errors import Interrupted

STOPS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@contextmanager
def stops_raised() -> Iterator[None]:
    """Inside the block each of the signals is raised as :class:`jaxdet.errors.Interrupted`.

    One that is ignored (nohup) stays so. In other threads than the main one nothing changes.
    """

    def stop(number: int, _: Any) -> None:
        raise Interrupted(number)

    with _handled(stop):
        yield


@contextmanager
def stops_held_back(*, drop: bool = False) -> Iterator[None]:
    """A signal waits until the end of the block; with ``drop`` it comes too late by then."""
    held: list[tuple[int, Any]] = []
    try:
        with _handled(lambda *given: held.append(given)):
            yield
    finally:
        for number, _ in held[: not drop]:
            signal.raise_signal(number)


def ignore_stops() -> None:
    """For processes that another one ends."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def _handled(handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Another handler inside the block, in the main thread."""
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            if (current := signal.getsignal(number)) not in (signal.SIG_IGN, None):
                before[number] = current
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, current in before.items():
            signal.signal(number, current)
