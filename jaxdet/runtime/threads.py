"""Threads that work on the frames of a batch together, on all cores of this process."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache
from threading import get_native_id

from jaxdet.cores import cores


def threads() -> int:
    """Return the number of threads of a kernel: ``PJRT_NPROC``, as in XLA, or one per core."""
    chosen = os.environ.get("PJRT_NPROC", "")
    return int(chosen) if chosen.isdecimal() and int(chosen) else cores()


def on_all_cores(work: Sequence[Callable[[], None]]) -> None:
    """Run the first function in this thread and the others in threads of their own, in parallel."""
    own, *others = work
    if not others:
        own()
        return
    pool, started = _pool(), []
    try:
        for thread, other in zip(pool.threads, others, strict=False):
            started.append(thread.start(other))
        pool.place_caller()
        own()
    finally:
        wait(started)  # threads use the memory of the arguments
    for other in started:
        other.result()


class _Thread:
    """Thread that starts each task on the same core, if all cores are used.

    By default, the system places threads that wake each other on one core for milliseconds. A
    thread pinned permanently would have to wait while another program uses its core.
    """

    def __init__(self, core: int | None) -> None:
        self._pool = ThreadPoolExecutor(1, "jaxdet-kernel")
        self._id = self._pool.submit(get_native_id).result()
        self._core = core

    def start(self, work: Callable[[], None]) -> Future[None]:
        """Start a task; the thread may be moved once it has been woken."""
        with _on_core(self._id, self._core):
            return self._pool.submit(work)


@contextmanager
def _on_core(thread: int, core: int | None) -> Iterator[None]:
    """Pin a thread to a core within the context, if it may use that core."""
    allowed = set() if core is None else os.sched_getaffinity(thread)
    if core is None or core not in allowed:
        yield
        return
    os.sched_setaffinity(thread, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(thread, allowed)


class _Pool:
    """Threads in addition to the caller's, :func:`threads` in all."""

    def __init__(self) -> None:
        allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        count = threads()
        places = sorted(allowed) if len(allowed) == count else [None] * count
        self._core = places[0]
        self.threads = [_Thread(place) for place in places[1:]]

    def place_caller(self) -> None:
        """Move the calling thread to the core that the others leave free; it may be moved again."""
        with _on_core(0, self._core):
            pass


@lru_cache(maxsize=1)
def _pool() -> _Pool:
    return _Pool()
