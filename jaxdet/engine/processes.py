"""Where a log's batches are worked on: in this process, or in workers."""

from collections.abc import Generator
from typing import Any

from jaxdet.cores import cores
from jaxdet.engine.batch import Done, LogWork
from jaxdet.engine.local import batches_here
from jaxdet.engine.pool import Pool, usual_count
from jaxdet.pipeline import BackendName

FRAMES_WORTH_WORKERS = 500
"""Fewer are done sooner than workers have started."""


class Processes:
    """Chooses for each log; a context manager that ends the workers.

    Args:
        count: Number of processes, or None for the default: one a core on the CPU, where a log
            has ``FRAMES_WORTH_WORKERS`` or the workers are there already, and one on a GPU.
        backend: What computes.

    Raises:
        ConfigError: ``count`` is below 1.
    """

    def __init__(self, count: int | None, backend: BackendName) -> None:
        self._automatic = count is None
        self._backend: BackendName = backend
        self._pool = Pool(cores() if count is None else count)
        self.used = 1
        """Processes that worked at a time, so far."""

    def __enter__(self) -> "Processes":
        """The object itself."""
        return self

    def __exit__(self, *_: Any) -> None:
        """Ends the workers."""
        self._pool.close()

    def work_through(self, work: LogWork) -> Generator[Done, None, None]:
        """The batches of a log, in order.

        Raises:
            JaxdetError: A batch failed, or a worker.
        """
        if not self._shared(work.log.num_frames):
            return batches_here(work)
        self.used = self._pool.count
        return self._pool.map(work, range(0, work.log.num_frames, work.job.batch_size))

    def _shared(self, frames: int) -> bool:
        if self._pool.count == 1:
            return False
        if not self._automatic or self._pool.started:
            return True
        return frames >= FRAMES_WORTH_WORKERS and usual_count(self._backend) > 1
