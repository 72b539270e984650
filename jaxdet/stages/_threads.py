"""Threads that work on the frames of a batch together, on all cores of this process."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import lru_cache
from threading import get_native_id

from jaxdet.cores import cores


def threads() -> int:
    """How many threads a kernel may use: ``PJRT_NPROC``, as XLA, or one a core."""
    chosen = os.environ.get("PJRT_NPROC", "")
    return int(chosen) if chosen.isdecimal() and int(chosen) else cores()


def on_all_cores(work: Sequence[Callable[[], None]]) -> None:
    """Does the first in this thread and the others in threads of their own, at the same time."""
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
        wait(started)  # they use the arguments' memory
    for other in started:
        other.result()


class _Thread:
    """A thread that starts each task on the same core, where all cores are used.

    Left alone, the system puts threads that wake each other on one core for milliseconds. Kept
    there for good, a thread would have to wait where another program has that core.
    """

    def __init__(self, core: int | None, allowed: set[int]) -> None:
        self._pool = ThreadPoolExecutor(1, "jaxdet-kernel")
        self._id = self._pool.submit(get_native_id).result()
        self._core, self._allowed = core, allowed

    def start(self, work: Callable[[], None]) -> Future[None]:
        """Starts it; the thread may be moved once it has been woken."""
        if self._core is None:
            return self._pool.submit(work)
        os.sched_setaffinity(self._id, {self._core})
        try:
            return self._pool.submit(work)
        finally:
            os.sched_setaffinity(self._id, self._allowed)


class _Pool:
    """The threads beside the caller's, :func:`threads` with it."""

    def __init__(self) -> None:
        self._allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        count = threads()
        places = sorted(self._allowed) if len(self._allowed) == count else [None] * count
        self._core = places[0]
        self.threads = [_Thread(place, self._allowed) for place in places[1:]]

    def place_caller(self) -> None:
        """Moves the calling thread to the core that the others leave; it may be moved again."""
        if self._core is not None:
            os.sched_setaffinity(0, {self._core})
            os.sched_setaffinity(0, self._allowed)


@lru_cache(maxsize=1)
def _pool() -> _Pool:
    return _Pool()
