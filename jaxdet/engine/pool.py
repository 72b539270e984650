"""Worker processes that share the items of a job and give the results in order."""

import importlib.util
import os
import pickle
import signal
import weakref
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from threading import current_thread, main_thread
from typing import Any

from jaxdet.cores import cores
from jaxdet.engine.process import Result, WorkerProcess
from jaxdet.engine.worker import AHEAD, Job
from jaxdet.errors import ConfigError
from jaxdet.pipeline import BackendName


def usual_count(backend: BackendName) -> int:
    """A process a core on the CPU, one on a GPU."""
    return 1 if backend == "jax" and _has_gpu() else cores()


def _has_gpu() -> bool:
    """Whether JAX computes on a GPU; without its plugin for them JAX needn't be loaded."""
    if os.environ.get("JAX_PLATFORMS") == "cpu" or not importlib.util.find_spec("jax_plugins"):
        return False
    from jaxdet.stages._device import on_cuda

    return on_cuda()


class Pool:
    """Processes, one thread each; a context manager.

    They start with the first job and stay for the next. Each has a pipe of its own and no lock
    in common with another, so one that dies holds up nobody. Every worker has two items at a
    time, so it doesn't wait for this process.

    Args:
        count: Number of processes.

    Raises:
        ConfigError: ``count`` is below 1.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise ConfigError(f"{count} workers", remedy="give --workers 1 or more")
        self.count = count
        self._busy = False
        self._workers: list[WorkerProcess] = []
        weakref.finalize(self, _end, self._workers, at_once=True)

    def __enter__(self) -> "Pool":
        """The pool itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the processes."""
        self.close()

    @property
    def started(self) -> bool:
        """Whether the processes are there."""
        return bool(self._workers)

    def map(self, job: Job, items: Iterable[Any]) -> Generator[Any, None, None]:
        """Yields the result of each item, in order.

        Items are taken as workers become free, at most a few ahead of the results; so memory
        doesn't grow with their number. When the generator is left before its end, an item fails
        or a process died since the last job, the next job starts new processes.

        Raises:
            WorkerError: A worker died, or failed in a way that nobody foresaw.
            JaxdetError: As the job raised it.
            RuntimeError: Another job is not at its end.
        """
        if self._busy:
            raise RuntimeError("the workers have another job that is not at its end")
        if not all(worker.process.is_alive() for worker in self._workers):
            _end(self._workers, at_once=True)
        if not self._workers:
            with _interrupts_held_back():
                for _ in range(self.count):
                    self._workers.append(WorkerProcess())
        ended, self._busy = False, True
        try:
            pickled = pickle.dumps(job, 5)
            for worker in self._workers:
                worker.send(pickled)
            yield from self._in_order(job, enumerate(items))
            ended = True
        finally:
            self._busy = False
            if not ended:
                _end(self._workers, at_once=True)

    def close(self) -> None:
        """Ends the processes."""
        _end(self._workers, at_once=False)

    def _in_order(self, job: Job, items: Iterator[tuple[int, Any]]) -> Iterator[Any]:
        window = 2 * AHEAD * self.count
        found: dict[int, Result] = {}
        given = taken = 0
        more = True
        while True:
            while more and given - taken < window and (worker := self._free()):
                number, item = next(items, (-1, None))
                more = number >= 0
                if more:
                    worker.give(number, item, job.where(item))
                    given += 1
            if taken in found:
                yield found.pop(taken).value
                taken += 1
            elif taken == given:
                return
            else:
                found.update(worker.receive() for worker in self._answering())

    def _free(self) -> WorkerProcess | None:
        worker = min(self._workers, key=lambda worker: len(worker.flying))
        return worker if len(worker.flying) < AHEAD else None

    def _answering(self) -> list[WorkerProcess]:
        busy = {worker.pipe: worker for worker in self._workers if worker.flying}
        ready: list[Any] = wait(list(busy))
        return [busy[pipe] for pipe in ready]


def _end(workers: list[WorkerProcess], *, at_once: bool) -> None:
    """Ends processes and takes them from the list."""
    ending = workers[:]
    workers.clear()
    for worker in ending:
        worker.end(at_once=at_once)
    for worker in ending:
        worker.wait()


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """A Ctrl-C waits meanwhile; processes started here never get one, their parent does.

    The mask is what the processes inherit; another thread may still take the signal, so there is
    a handler too.
    """
    if not hasattr(signal, "pthread_sigmask") or current_thread() is not main_thread():
        yield
        return
    resource_tracker.ensure_running()  # else the first process starts it, and it ends the mask
    held: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        if held:
            signal.raise_signal(signal.SIGINT)
