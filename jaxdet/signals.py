"""Signals that end a run: Ctrl-C, SIGTERM, and SIGHUP where it isn't ignored.

An exception that a handler raises while a module is imported, or in a callback of the garbage
collector or of native code, is swallowed or ends the process with a crash. So a stop is raised
only where code of jaxdet runs or waits, and is tried again until it does. Besides, the command has
a guard (:func:`guard_process`) that ends the process if that takes too long. Whatever a run writes
gets its name when it is complete, so a process may end anywhere.
"""

import linecache
import os
import re
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from jaxdet.errors import Interrupted

STOPS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
GRACE_S = 1.5
"""How long the guard waits for a command to end by itself [s]."""
_RETRY = getattr(signal, "SIGALRM", None)
_RETRY_S = 0.02
_WAITS = {"threading", "multiprocessing.connection", "selectors", "queue", "subprocess"}
"""Modules of Python in which code of jaxdet waits."""
_BLOCKS = re.compile(r"waiter\.acquire\(|\block\.acquire\(block|_handle\.join\(")
"""Lines of :mod:`threading` that block. An exception elsewhere in it may leave a lock that a
``with`` around it holds unlocked, whose end then raises another one."""
_IMPORTS = {"importlib._bootstrap", "importlib._bootstrap_external", "_frozen_importlib"}
_Handler = Callable[[int, FrameType | None], None]


@contextmanager
def stops_raised() -> Iterator[None]:
    """Raise each of the signals as :class:`jaxdet.errors.Interrupted` inside the block.

    One that is ignored (nohup) stays so. In other threads than the main one nothing changes.
    """
    pending = 0
    outer = signal.getsignal(_RETRY) if _RETRY is not None else None

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal pending
        if number == _RETRY and not pending:  # an alarm of a block around this one
            if callable(outer):
                outer(number, frame)
            return
        pending = pending if number == _RETRY else number
        if _may_raise(frame) or _RETRY is None:
            number, pending = pending, 0
            raise Interrupted(number)
        signal.setitimer(signal.ITIMER_REAL, _RETRY_S)

    with _handled(stop):
        try:
            yield
        finally:
            if pending:
                signal.setitimer(signal.ITIMER_REAL, 0)
    if pending:  # the block ended before it could be raised
        raise Interrupted(pending)


@contextmanager
def stops_held_back() -> Iterator[None]:
    """Let a signal wait until the end of the block."""
    held: list[int] = []
    try:
        with _handled(lambda number, _: held.append(number)):
            yield
    finally:
        for number in held:
            _handle(number)


def ignore_stops() -> None:
    """Ignore the signals, in processes that another one ends."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)


def guard_process() -> None:
    """Make sure that a signal ends this process with the exit code 128 + number of the signal.

    Until :func:`stops_raised` takes over it ends at once; afterwards when it has not ended
    :data:`GRACE_S` after the signal, or at the second signal. The guard is off after
    :func:`end_guard`.
    """
    for number in STOPS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda number, _: _end(number))
    receives, sends = os.pipe()
    os.set_blocking(sends, False)
    signal.set_wakeup_fd(sends, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(receives,), name="jaxdet-guard", daemon=True).start()


def end_guard() -> None:
    """Ignore signals from now on: what the command had to do is done."""
    signal.set_wakeup_fd(-1)
    _done.set()
    ignore_stops()


_done = threading.Event()


def _watch(receives: int) -> None:
    """End the process some time after the first signal, or at the second one."""
    first, deadline = 0, 0.0
    while not _done.is_set():
        left = max(0.0, deadline - time.monotonic()) if first else None
        there, _, _ = select.select([receives], [], [], left)
        stops = [number for number in os.read(receives, 64) if number in STOPS] if there else []
        if first and (stops or time.monotonic() >= deadline) and not _done.is_set():
            _end(first)
        if stops and not first:
            first, deadline = stops[0], time.monotonic() + GRACE_S


def _end(number: int) -> None:
    """End this process and its children."""
    with suppress(OSError):
        os.write(2, b"\njaxdet: error: interrupted\n")
    if processes := sys.modules.get("multiprocessing"):
        with suppress(Exception):  # whatever state they are in
            for child in processes.active_children():
                child.kill()
    os._exit(128 + number)


def _handle(number: int) -> None:
    """Do what a signal does; the guard, which has seen it, does not count it again."""
    handler = signal.getsignal(number)
    if callable(handler):
        handler(number, sys._getframe())
    else:
        signal.raise_signal(number)


def _may_raise(frame: FrameType | None) -> bool:
    """Return whether code of jaxdet runs or waits, and no module is being imported."""
    name = str(frame.f_globals.get("__name__")) if frame else ""
    if name.partition(".")[0] != "jaxdet" and name not in _WAITS:
        return False
    if frame and name == "threading":
        line = linecache.getline(frame.f_code.co_filename, frame.f_lineno)
        if not _BLOCKS.search(line):
            return False
    while frame:
        if frame.f_globals.get("__name__") in _IMPORTS:
            return False
        frame = frame.f_back
    return True


@contextmanager
def _handled(handler: _Handler) -> Iterator[None]:
    """Use another handler inside the block, in the main thread."""
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            if (current := signal.getsignal(number)) not in (signal.SIG_IGN, None):
                before[number] = current
        if _RETRY is not None:
            before[_RETRY] = signal.getsignal(_RETRY)
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, current in before.items():
            signal.signal(number, current)
