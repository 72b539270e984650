"""Threads that work on the frames of a batch together, on all cores of this process."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache
from threading import get_native_id

from jaxdet.cores import cores


def threads() -> int:
    """Return the number of threads of a kernel: ``PJRT_NPROC``, as in XLA, or one per core."""
    chosen = os.environ.get("PJRT_NPROC", "")
    return int(chosen) if chosen.isdecimal() and int(chosen) else cores()


def on_all_cores(work: Sequence[Callable[[], object]]) -> None:
    """Run the first function in this thread and the others in threads of their own, in parallel.

    By default, the system places threads that wake each other on one core for milliseconds. So each
    thread is pinned to its own core while it is started, if there is one thread per core. A thread
    that remained pinned would have to wait while another program uses its core.
    """
    own, *others = work
    if not others:
        own()
        return
    (core, pool), started = _pool(), []
    try:
        for thread, other in zip(pool, others, strict=False):
            with _on_core(thread.id, thread.core):
                started.append(thread.executor.submit(other))
        with _on_core(0, core):
            pass
        own()
    finally:
        wait(started)  # threads use the memory of the arguments
    for other in started:
        other.result()


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


class _Thread:
    """Thread that runs one task after the other."""

    def __init__(self, core: int | None) -> None:
        self.core = core
        self.executor = ThreadPoolExecutor(1, "jaxdet-kernel")
        self.id = self.executor.submit(get_native_id).result()


@lru_cache(maxsize=1)
def _pool() -> tuple[int | None, list[_Thread]]:
    """Return the core for the calling thread, and all other threads of a kernel.

    Cores are None, and threads are not pinned, unless there is one thread per core.
    """
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    count = threads()
    core, *others = sorted(allowed) if len(allowed) == count else [None] * count
    return core, [_Thread(other) for other in others]
