"""Signals that end a run: Ctrl-C, SIGTERM, and SIGHUP unless it is ignored.

An exception raised by a handler during an import, or in a callback of the garbage collector or of
native code, is swallowed or crashes the process. A signal is therefore raised only while jaxdet's
own code runs or waits, and is retried until then. In addition, the command has a guard
(:func:`guard_process`), which ends the process if this takes too long. Output files get their final
name only when they are complete, so the process may end at any time.
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
"""Time that the guard gives a command to end by itself [s]."""
END_S = 1.0
"""Maximum time of a function of :func:`called_at_end` in a process that is ended [s]."""
_RETRY = getattr(signal, "SIGALRM", None)
_RETRY_S = 0.02
_WAITS = {"threading", "multiprocessing.connection", "selectors", "queue", "subprocess"}
"""Standard library modules in which jaxdet's code waits."""
_BLOCKS = re.compile(r"waiter\.acquire\(|\block\.acquire\(block|_handle\.join\(")
"""Blocking lines of :mod:`threading`. An exception elsewhere in that module may release a lock
inside its ``with`` block; the end of this block then raises another exception."""
_IMPORTS = {"importlib._bootstrap", "importlib._bootstrap_external", "_frozen_importlib"}
_Handler = Callable[[int, FrameType | None], None]


@contextmanager
def stops_raised() -> Iterator[None]:
    """Raise :class:`jaxdet.errors.Interrupted` in the block if a signal of ``STOPS`` arrives.

    Ignored signals (nohup) stay ignored. Nothing changes in threads other than the main one.
    """
    pending = 0
    outer = signal.getsignal(_RETRY) if _RETRY is not None else None

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal pending
        if number == _RETRY and not pending:  # the timer of an enclosing block
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
    if pending:  # the block ended before the signal could be raised
        raise Interrupted(pending)


@contextmanager
def stops_held_back() -> Iterator[None]:
    """Delay signals until the end of the block."""
    held: list[int] = []
    try:
        with _handled(lambda number, _: held.append(number)):
            yield
    finally:
        for number in held:
            _handle(number)


@contextmanager
def called_at_end(action: Callable[[], object]) -> Iterator[None]:
    """Call a function at the end of the block, also if a signal ends the process in it.

    The guard calls the function while the block may still run, and gives it :data:`END_S`.
    """
    _at_end.append(action)
    try:
        yield
    finally:
        _at_end.remove(action)
        action()


def ignore_stops() -> None:
    """Ignore the signals of ``STOPS``, in a process that is ended by its parent."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)


def guard_process() -> None:
    """Make sure that a signal ends this process, with the exit code 128 + signal number.

    Outside of :func:`stops_raised` the process ends immediately. Inside, it ends :data:`GRACE_S`
    after the signal, or at the second signal. :func:`end_guard` turns the guard off.
    """
    for number in STOPS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda number, _: _end(number))
    receives, sends = os.pipe()
    os.set_blocking(sends, False)
    signal.set_wakeup_fd(sends, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(receives,), name="jaxdet-guard", daemon=True).start()


def end_guard() -> None:
    """Ignore signals from now on, since the command is complete."""
    signal.set_wakeup_fd(-1)
    _done.set()
    ignore_stops()


_done = threading.Event()
_at_end: list[Callable[[], object]] = []


def _watch(receives: int) -> None:
    """End the process :data:`GRACE_S` after the first signal, or at the second one."""
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
        with suppress(Exception):  # the module may be in any state
            for child in processes.active_children():
                child.kill()
    for action in [*_at_end]:
        last = threading.Thread(target=action, daemon=True)
        last.start()
        last.join(END_S)
    os._exit(128 + number)


def _handle(number: int) -> None:
    """Run the handler of a held-back signal, without notifying the guard a second time."""
    handler = signal.getsignal(number)
    if callable(handler):
        handler(number, sys._getframe())
    else:
        signal.raise_signal(number)


def _may_raise(frame: FrameType | None) -> bool:
    """Return whether jaxdet's code runs or waits, and no module is being imported."""
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
    """Replace the signal handlers inside the block, in the main thread only."""
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
