"""Division of the memory of a run among its processes.

Each process needs memory for libraries and programs, measured with frames of 640x480. The processes
share the rest. One part of it is for chunks of the log, which limits the size of chunks that a file
may have; the other part is for images. So the memory determines the number of processes, and the
number of frames computed together. Neither changes the tables of frames and obstacles.

All figures are resident memory; pages that processes share count once.
"""

from typing import NamedTuple

from jaxdet.errors import ConfigError, InputError
from jaxdet.io.limits import ReadMemory
from jaxdet.io.options import LogOptions
from jaxdet.memory import machine_memory, parse_size, size_text

MIB = 1 << 20
SHARE = 0.75
"""Fraction of the machine's memory that a run uses by default."""
ALONE = 608 * MIB
"""Memory of a process that does everything: JAX, Warp, their programs and temporaries. Measured:
520 MiB, of which 280 MiB are pages of libraries, and 70 MiB more while kernels are compiled."""
PARENT = 448 * MIB
"""Memory of the process that hands out units, of the server that workers are forked from, and of
pages that all processes share. Measured: 440 MiB."""
WORKER = 192 * MIB
"""Additional memory of each worker that computes. Measured: 145 to 180 MiB."""
ON_GPUS = 4096 * MIB
"""Memory of a process that computes on GPUs; not measured."""
READER = 160 * MIB
"""Memory of a worker that reads images for a process that computes on GPUs."""
TABLES = 640 * MIB
"""Memory of the rows of 65,536 frames of 640x480, which are packed together."""
LEAST_CHUNKS = 64 * MIB
"""Minimum memory for chunks in a process. The largest chunk may take half of it, as its compressed
form is in memory too."""
LEAST_IMAGES = 32 * MIB
"""Minimum memory for images in a process: four frames of 1920x1080."""
BATCH = 16
"""Number of frames computed together on the CPU, by default."""
BATCHES_IN_FLIGHT = 5
"""Number of batches in a process: one is filled, one is computed, one is finished, and temporaries
take as much memory as two."""


class MemoryPlan(NamedTuple):
    """Numbers of processes and frames for a log that fit into the memory."""

    workers: int
    """Number of processes that share the frames of the log."""
    batch: int
    """Number of frames read together by a process; on the CPU they are also computed together."""


class Memory:
    """Memory of a run.

    Args:
        requested: Value of ``--memory``; by default ``SHARE`` of the memory of the machine.
        workers: Maximum number of processes.
        devices: Number of GPUs.
        apart: Whether this process leaves all logs to workers, even to a single one, if there is
            memory for both.
        largest: Maximum size of a log's chunks [bytes].

    Attributes:
        total: Memory of the run [bytes].
        devices: Number of GPUs.
        workers: Number of processes that fit, at most the argument ``workers``.
        chunks: Memory for chunks in each process [bytes].
        reading: Limits for reading a log.
        room: Memory that libraries and programs leave for everything else [bytes].
        apart: Whether a single worker runs in addition to this process, not instead of it.

    Raises:
        ConfigError: ``requested`` is too little for any log.
    """

    def __init__(
        self,
        requested: str | None,
        workers: int,
        devices: int = 0,
        *,
        apart: bool = False,
        largest: int = LogOptions.max_chunk_mib * MIB,
    ) -> None:
        self._requested, self.devices, self.apart = requested, devices, False
        self._largest = largest
        least = self._fixed(1) + LEAST_CHUNKS + LEAST_IMAGES
        if requested is None:
            self.total = max(least, int(SHARE * machine_memory()))
        else:
            self.total = parse_size(requested, "--memory")
        if self.total < least:
            remedy = f"pass --memory {size_text(least)} or more"
            raise ConfigError(f"--memory {requested} is too little for any log", remedy=remedy)
        self.apart = apart and self.total >= PARENT + WORKER + LEAST_CHUNKS + LEAST_IMAGES
        fitting = [n for n in range(2, workers + 1) if self._left(n) >= LEAST_CHUNKS + LEAST_IMAGES]
        self.workers = max([1, *fitting])
        left = self._left(self.workers) - TABLES // self.workers
        self.chunks = max(LEAST_CHUNKS, min(2 * largest, left // 2))
        self.room = self.total - self._fixed(self.workers)
        index = (self.total - self._fixed(1) - self.chunks) // 2
        self.reading = ReadMemory(self.chunks // 2, index, max(0, 2 * LEAST_CHUNKS - left))

    def with_fewer_workers(self) -> "Memory | None":
        """Return the memory for half as many processes, which may read larger chunks.

        None is returned if there is only one process.
        """
        if self.workers == 1:
            return None
        given = self._requested, self.workers // 2, self.devices
        return Memory(*given, apart=self.apart, largest=self._largest)

    def allot(
        self, frame: int, index: int, rows: int, batch: int, workers: int, where: str
    ) -> MemoryPlan:
        """Return the largest numbers of processes and frames that fit.

        Args:
            frame: Memory of the images of a frame [bytes].
            index: Memory of the log's message index in each process [bytes].
            rows: Memory of the table rows that are packed together in this process [bytes].
            batch: Largest number of frames computed together.
            workers: Largest number of processes.
            where: Name of the log, for the error.

        Raises:
            InputError: There is no room for one frame.
        """
        for count in range(min(workers, self.workers), 0, -1):
            left = self._left(count) - self.chunks
            # If there are workers, this process also holds the pickled index that it sends.
            left -= (index * (count + 1 + (count > 1)) + rows) // count
            size = batch
            while size and BATCHES_IN_FLIGHT * size * frame > left:
                size //= 2
            if size:
                return MemoryPlan(count, size)
        rest = BATCHES_IN_FLIGHT * frame + 2 * index + rows
        chunks = max(LEAST_CHUNKS, min(2 * self._largest, rest))  # half of the remaining memory
        least = size_text(self._fixed(1) + chunks + rest)
        problem = f"its images, index and rows need more memory than {size_text(self.total)}"
        raise InputError(problem, path=where, remedy=f"pass --memory {least} or more")

    def _left(self, workers: int) -> int:
        """Return the memory for chunks and images of each process [bytes]."""
        return (self.total - self._fixed(workers)) // workers

    def _fixed(self, workers: int) -> int:
        if self.devices:
            return ON_GPUS + workers * READER
        return ALONE if workers == 1 and not self.apart else PARENT + workers * WORKER
