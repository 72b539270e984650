"""One number of bytes, divided among all that holds memory in a run.

The libraries and programs of each process come first, in figures measured with frames of 640x480.
What is left is shared by the processes: a part for chunks of the log, which bounds what a file may
ask for, and the rest for images. So it decides how many processes there are, how many frames they
compute together, and how far they read ahead. None of these changes a byte of the two tables.

Counted is resident memory, pages that processes share once.
"""

from typing import NamedTuple

from jaxdet.errors import ConfigError, InputError
from jaxdet.io.limits import ReadMemory
from jaxdet.io.options import LogOptions
from jaxdet.memory import machine_memory, parse_size, size_text

MIB = 1 << 20
SHARE = 0.75
"""Of the machine's memory, where the user says nothing."""
ALONE = 608 * MIB
"""A process that does all: JAX, Warp, their programs and temporaries; 520 MiB, of which 280 are
pages of libraries, and 70 more while kernels are compiled."""
PARENT = 448 * MIB
"""The process that hands out units, the server that workers are forked from, and what all share;
440 MiB."""
WORKER = 192 * MIB
"""A worker that computes, beside that; 145 to 180 MiB."""
ON_GPUS = 4096 * MIB
"""A process that computes on GPUs; not measured."""
READER = 160 * MIB
"""A worker that reads for it."""
TABLES = 640 * MIB
"""The rows of 65,536 frames of 640x480, which wait for each other and are packed together."""
LEAST_CHUNKS = 64 * MIB
"""For chunks in a process, of which the largest may take half, as it is there packed too."""
LEAST_IMAGES = 32 * MIB
"""For images in a process; four frames of 1920x1080."""
BATCH = 16
"""Frames computed together by a process of the CPU, unless the user says."""
READ_AHEAD = 2
"""Batches that wait, read, where one process has all cores."""
BATCHES_IN_FLIGHT = 5
"""Batches in a process beside those: filled, started, finished, and as much for temporaries."""


class Needs(NamedTuple):
    """What a log takes [bytes]."""

    frame: int
    """A frame's images."""
    known: int
    """What is known of its messages, which each process has."""
    rows: int
    """Rows of the tables that wait in this process."""


class MemoryPlan(NamedTuple):
    """How a log is worked on, so that the memory is enough."""

    workers: int
    """Processes; 1: this one alone."""
    batch: int
    """Frames read together by a process; on the CPU they are computed together."""
    read_ahead: int
    """Batches that wait, read, in a process that is alone."""


class Memory:
    """The memory of a run.

    Args:
        asked: What the user gave; None: a share of the machine.
        workers: Processes that would be of use.
        devices: GPUs.
        apart: Logs are to be left to workers, be it one, where there is room for it.
        largest: Bytes of the largest chunk that a log may have.

    Attributes:
        total: Bytes.
        workers: Processes that there is room for, at most as many.
        chunks: Bytes for chunks in each process.
        reading: What reading a log may take.
        room: Bytes beside what processes take at rest.
        apart: One worker is beside this process, not in its place.

    Raises:
        ConfigError: The user gave too little.
    """

    def __init__(
        self,
        asked: str | None,
        workers: int,
        devices: int = 0,
        *,
        apart: bool = False,
        largest: int = LogOptions.max_chunk_mib * MIB,
    ) -> None:
        self._asked, self._devices, self.apart = asked, devices, False
        self._largest = largest
        least = self._fixed(1) + LEAST_CHUNKS + LEAST_IMAGES
        if asked is None:
            self.total = max(least, int(SHARE * machine_memory()))
        else:
            self.total = parse_size(asked, "--memory")
        if self.total < least:
            remedy = f"give --memory {size_text(least)} or more"
            raise ConfigError(f"--memory {asked} is too little for any log", remedy=remedy)
        self.apart = apart and self.total >= PARENT + WORKER + LEAST_CHUNKS + LEAST_IMAGES
        fitting = [n for n in range(2, workers + 1) if self._left(n) >= LEAST_CHUNKS + LEAST_IMAGES]
        self.workers = max([1, *fitting])
        left = self._left(self.workers) - TABLES // self.workers
        self.chunks = max(LEAST_CHUNKS, min(2 * largest, left // 2))
        self.room = self.total - self._fixed(self.workers)
        index = (self.total - self._fixed(1) - self.chunks) // 2
        self.reading = ReadMemory(self.chunks // 2, index)

    def with_fewer_workers(self) -> "Memory | None":
        """The same for half as many, who may read larger chunks; None: there is one."""
        if self.workers == 1:
            return None
        given = self._asked, self.workers // 2, self._devices
        return Memory(*given, apart=self.apart, largest=self._largest)

    def allot(self, needs: Needs, batch: int, workers: int, where: str) -> MemoryPlan:
        """How a log is worked on, with the most of everything that there is room for.

        Args:
            needs: What it takes.
            batch: Frames that would be computed together.
            workers: Processes that would be of use.
            where: The log, for the error.

        Raises:
            InputError: There is no room for one frame.
        """
        for count in range(min(workers, self.workers), 0, -1):
            left = self._left(count) - self.chunks
            # With workers the index is on its way to them once more.
            left -= (needs.known * (count + 1 + (count > 1)) + needs.rows) // count
            ahead = READ_AHEAD if count == 1 and not self._devices else 0
            size = batch
            while size:
                for waiting in range(ahead, -1, -1):
                    if (BATCHES_IN_FLIGHT + waiting) * size * needs.frame <= left:
                        return MemoryPlan(count, size, waiting)
                size //= 2
        rest = BATCHES_IN_FLIGHT * needs.frame + 2 * needs.known + needs.rows
        chunks = max(LEAST_CHUNKS, min(2 * self._largest, rest))  # which get half of what is left
        least = size_text(self._fixed(1) + chunks + rest)
        problem = f"its images, index and rows need more memory than {size_text(self.total)}"
        raise InputError(problem, path=where, remedy=f"give --memory {least} or more")

    def _left(self, workers: int) -> int:
        """Bytes for the chunks and images of each process."""
        return (self.total - self._fixed(workers)) // workers

    def _fixed(self, workers: int) -> int:
        if self._devices:
            return ON_GPUS + workers * READER
        return ALONE if workers == 1 and not self.apart else PARENT + workers * WORKER
