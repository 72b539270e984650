"""What a worker process does: take a job, then work on its items one after the other."""

import contextlib
import os
import pickle
import signal
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from typing import Any, Literal, NamedTuple, Protocol

from jaxdet.engine.prefetch import prefetch
from jaxdet.engine.shared import Packed, pack, unpack
from jaxdet.engine.startup import start_up
from jaxdet.errors import JaxdetError, WorkerError

AHEAD = 2
"""Items that a worker has at a time: the one it works on and the next."""


class Job(Protocol):
    """Work on items that don't depend on each other; goes to each worker once, pickled."""

    def __call__(self, item: Any, /) -> Any:
        """The result for an item, with NumPy arrays only."""
        ...

    def where(self, item: Any, /) -> str:
        """What an item is, for messages."""
        ...

    def close(self) -> None:
        """Frees what the job holds."""
        ...


class Task(NamedTuple):
    """An item on its way to a worker."""

    slot: int
    """Which of the worker's places it has, below ``AHEAD``."""
    item: Packed
    given: str | None
    """Shared memory that the item's arrays are in."""
    found: str | None
    """Shared memory for the result's arrays."""


class Failure(NamedTuple):
    """Instead of a result."""

    error: Exception
    trace: str


def serve(pipe: Connection) -> None:
    """Answers tasks until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the workers
    os.environ["PJRT_NPROC"] = "1"  # threads of XLA
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    import cv2

    cv2.setNumThreads(1)
    start_up()
    worker = _Worker()
    with (
        contextlib.suppress(BrokenPipeError),
        contextlib.closing(prefetch(_messages(pipe), AHEAD)) as messages,
    ):
        for message in messages:
            if isinstance(message, Task):
                pipe.send(worker.answer(message))
            else:
                worker.take(message)
    os._exit(0)  # nothing is left to be saved, and JAX and Warp take their time to end


def _messages(pipe: Connection) -> Iterator[Any]:
    """Reads at once, so that the parent never waits for a worker that waits for the parent."""
    while True:
        try:
            yield pipe.recv()
        except (EOFError, ConnectionResetError):
            return


class _Worker:
    """The job at hand and the memory shared with the parent."""

    def __init__(self) -> None:
        self.job: Job | None = None
        self.failure: Failure | None = None
        self.memories: dict[tuple[int, str], SharedMemory] = {}

    def take(self, pickled: bytes) -> None:
        """A new job in place of the last."""
        if self.job:
            self.job.close()
        self.job = self.failure = None
        try:
            self.job = pickle.loads(pickled)
        except Exception as error:
            self.failure = _failure(error)

    def answer(self, task: Task) -> Packed:
        """The packed result of an item, or a packed failure."""
        memory = self._memory(task, "found")
        return pack(self._result(task), lambda size: memory and _large_enough(memory, size))

    def _result(self, task: Task) -> Any:
        if self.job is None:
            return self.failure
        try:
            return self.job(unpack(task.item, self._memory(task, "given"), copy=False))
        except Exception as error:
            return _failure(error)

    def _memory(self, task: Task, kind: Literal["given", "found"]) -> SharedMemory | None:
        """The memory of a task; the parent may have put a larger one in its place."""
        key, name = (task.slot, kind), getattr(task, kind)
        if name is None:
            return None
        old = self.memories.get(key)
        if old is None or old.name != name:
            self.memories[key] = SharedMemory(name)
            if old is not None:
                with contextlib.suppress(BufferError):  # an array still shows it
                    old.close()
        return self.memories[key]


def _large_enough(memory: SharedMemory, size: int) -> SharedMemory | None:
    return memory if memory.size >= size else None


def _failure(error: Exception) -> Failure:
    trace = traceback.format_exc()
    try:
        same = pickle.loads(pickle.dumps(error))
        if isinstance(same, JaxdetError) and str(same) == str(error):
            return Failure(same, trace)
    except Exception:  # some can't be pickled, some not unpickled
        pass
    return Failure(WorkerError(f"{type(error).__name__}: {error}"), trace)
