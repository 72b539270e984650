"""A worker process as its parent sees it."""

import signal
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.shared_memory import SharedMemory
from typing import Any, NamedTuple

from jaxdet.engine.shared import Packed, make_memory, pack, unpack
from jaxdet.engine.worker import AHEAD, Failure, Task, serve
from jaxdet.errors import WorkerError

_JOIN_S = 2.0


class Result(NamedTuple):
    """What came back for an item."""

    where: str
    content: Any

    @property
    def value(self) -> Any:
        """The job's result.

        Raises:
            JaxdetError: The job's, or a WorkerError that says what the item was.
        """
        if not isinstance(self.content, Failure):
            return self.content
        error, trace = self.content
        if type(error) is WorkerError:
            error = WorkerError(f"{self.where}: {error}")
        error.add_note(f"{self.where}, in a worker process:\n{trace}")
        raise error


class _Slot:
    """The memory of one item that a worker has."""

    def __init__(self) -> None:
        self.given: SharedMemory | None = None
        self.found: SharedMemory | None = None

    def grown(self, kind: str, size: int) -> SharedMemory:
        """The memory ``given`` or ``found``, replaced where it is smaller than ``size``."""
        memory: SharedMemory | None = getattr(self, kind)
        if memory is None or memory.size < size:
            _free(memory)
            setattr(self, kind, None)
            memory = make_memory(size)
            setattr(self, kind, memory)
        return memory

    def free(self) -> None:
        _free(self.given)
        _free(self.found)


class WorkerProcess:
    """Starts a process, sends items to it and receives their results in the same order."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.slots = [_Slot() for _ in range(AHEAD)]
        self.flying: dict[int, tuple[int, str]] = {}
        """Number of each item that it has, with its slot and what it is, in order."""

    def send(self, message: Any) -> None:
        """Sends a message.

        Raises:
            WorkerError: The process has died.
        """
        try:
            self.pipe.send(message)
        except (BrokenPipeError, ConnectionResetError):
            raise self._died() from None

    def give(self, number: int, item: Any, where: str) -> None:
        """Sends an item; there must be fewer than ``AHEAD`` flying.

        Raises:
            WorkerError: The process has died, or there is no shared memory.
        """
        place = min(set(range(AHEAD)) - {place for place, _ in self.flying.values()})
        slot = self.slots[place]
        packed = pack(item, lambda size: slot.grown("given", size))
        self.flying[number] = place, where
        names = [memory and memory.name for memory in (slot.given, slot.found)]
        self.send(Task(place, packed, *names))

    def receive(self) -> tuple[int, Result]:
        """The number of the item that is done, and its result.

        Raises:
            WorkerError: The process has died.
        """
        number, (place, where) = next(iter(self.flying.items()))
        try:
            packed: Packed = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            raise self._died() from None
        slot = self.slots[place]
        content = unpack(packed, slot.found, copy=True)
        if packed.arrays:
            slot.grown("found", packed.room)  # the next result goes through memory
        del self.flying[number]
        return number, Result(where, content)

    def end(self, *, at_once: bool) -> None:
        """Tells the process to end, or ends it."""
        if at_once:
            self.process.kill()
        self.pipe.close()

    def wait(self) -> None:
        """Waits for the end of the process and frees the memory."""
        self.process.join(_JOIN_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process.close()
        for slot in self.slots:
            slot.free()

    def _died(self) -> WorkerError:
        self.process.join(_JOIN_S)
        code = self.process.exitcode or 0
        where = next((where for _, where in self.flying.values()), "at its start")
        if code >= 0:
            remedy = "its own message is above; a script needs: if __name__ == '__main__'"
            return WorkerError(f"{where}: a worker process ended with code {code}", remedy=remedy)
        name = f"signal {-code}"
        with suppress(ValueError):
            name = signal.Signals(-code).name
        remedy = "if memory ran out, take fewer workers (--workers) or smaller batches"
        return WorkerError(f"{where}: {name} ended a worker process", remedy=remedy)


def _free(memory: SharedMemory | None) -> None:
    if memory is not None:
        memory.close()
        memory.unlink()
