"""A process that works on units, and this side of it."""

import itertools
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from jaxdet.engine.device import OwnDevice, SharedDevice, out_of_memory
from jaxdet.engine.floors import Planes, decide_planes
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.shared_slots import ServerPipe, Slots
from jaxdet.engine.startup import start_reading, start_up
from jaxdet.engine.unit import UnitProcessor
from jaxdet.engine.unit_result import UnitResult, rows_path
from jaxdet.errors import FrameStatus, JaxdetError, WorkerError
from jaxdet.pipeline import BackendName
from jaxdet.signals import ignore_stops

if TYPE_CHECKING:
    from jaxdet.io import Log

_ALIVE, _ALIVE_S = "alive", 1.0
"""What a worker says, and how often at most."""
_NEW_CONTEXT = "context"
"""Sent to a worker before a context."""


class Failure(NamedTuple):
    """Instead of what a function returns."""

    error: Exception
    trace: str
    memory: bool
    """There was not enough."""

    def as_raised(self, where: str) -> Exception:
        """The error with where it happened."""
        if type(self.error) is not WorkerError:
            return self.error
        error = WorkerError(f"{where}: {self.error}")
        error.add_note(f"{where}, in a worker process:\n{self.trace}")
        return error


class Context(Protocol):
    """What several calls in a worker need; it is sent to each worker once."""

    def open(self) -> Any:
        """Return the first argument of the calls, in the worker."""
        ...


_numbers = itertools.count(1)


class PackedContext:
    """A context on its way to workers.

    Args:
        context: It, as it is now.
    """

    def __init__(self, context: Context) -> None:
        self.number, self.data = next(_numbers), pickle.dumps(context, 5)


class Worker:
    """A process that is given functions, one after the other.

    Args:
        context: How processes are started.
        backend: What it computes with.
        server_pipe: Its way to the process that computes for it; None: it computes itself.
    """

    def __init__(self, context: Any, backend: BackendName, server_pipe: ServerPipe | None) -> None:
        self.pipe, self._theirs = multiprocessing.Pipe()
        self._server_pipe = server_pipe
        given = backend, self._theirs, server_pipe
        self.process = context.Process(target=_work, args=given, daemon=True)
        self.given: deque[Any] = deque()
        """What it has been given and has not answered, the oldest first."""
        self.ready = False
        """It has begun."""
        self.idle_s = 0.0
        """Time without a sign of progress, while it has something to do [s]."""
        self._context = 0
        """Number of the context that it has."""

    def start(self) -> None:
        """Starts the process; takes a while."""
        try:
            self.process.start()
        finally:
            self._theirs.close()
            if self._server_pipe:
                self._server_pipe.pipe.close()  # so that the server sees when the worker ends

    def give(
        self, label: Any, function: Callable[..., Any], *args: Any, context: PackedContext | None
    ) -> None:
        """Give it a function to call.

        Args:
            label: Returned with the answer.
            function: Of the module level.
            args: Its arguments, small ones where the worker has something to do.
            context: Makes its first argument; None: it has none. A new one is sent only to a
                worker that has nothing to do, which therefore reads it.
        """
        new = context is not None and context.number != self._context
        assert not (new and self.given)
        self.given.append(label)
        with suppress(OSError):  # it has died, which receive() says
            if context is not None and new:
                self._context = context.number
                self.pipe.send_bytes(pickle.dumps(_NEW_CONTEXT, 5))
                self.pipe.send_bytes(context.data)
            self.pipe.send_bytes(pickle.dumps((function, args, context is not None), 5))

    def receive(self) -> list[tuple[Any, Any]]:
        """What it has answered since, with the labels.

        Raises:
            EOFError: It has died.
        """
        answers = []
        try:
            while self.pipe.poll():
                told = self.pipe.recv()
                self.idle_s = 0.0
                if isinstance(told, _Answer):
                    answers.append((self.given.popleft(), told.value))
                else:
                    self.ready = True
        except (EOFError, OSError):
            if not answers:
                raise EOFError from None
        return answers

    def end(self) -> None:
        """Kill it."""
        if self.process.pid is not None:
            self.process.kill()
            self.process.join()
        self.pipe.close()
        self._theirs.close()

    @property
    def by_signal(self) -> bool:
        """Whether a signal ended it."""
        return (self._code() or 0) < 0

    @property
    def death(self) -> str:
        """How it ended."""
        code = self._code()
        if code is None:
            return "a worker process can't be started"
        if code >= 0:
            return f"a worker process ended with code {code}"
        name = f"signal {-code}"
        with suppress(ValueError):
            name = signal.Signals(-code).name
        return f"{name} ended a worker process"

    def _code(self) -> int | None:
        if self.process.pid is None:
            return None
        self.process.join(5)
        return self.process.exitcode


class _Answer(NamedTuple):
    value: Any


_server_pipe: ServerPipe | None = None
"""In a worker: its way to the process that computes for it."""
_progress: Callable[[], Any] = int
"""In a worker: tells its parent that it is alive."""


def report_alive() -> None:
    """In a worker: tells its parent that there is progress."""
    _progress()


@lru_cache(maxsize=1)
def shared_device(slots: Slots) -> SharedDevice:
    """In a worker: the process that computes for it."""
    assert _server_pipe is not None
    return SharedDevice(slots, _server_pipe)


class UnitContext(NamedTuple):
    """What :func:`run_unit` needs in another process."""

    log: "Log"
    """Open log; the content of its files does not go with it."""
    plan: LogPlan
    slots: Slots | None
    """With GPUs: where images go."""

    def open(self) -> UnitProcessor:
        """Return the work on the log."""
        own = OwnDevice(self.plan.config, self.plan.backend, ahead=0)
        device = shared_device(self.slots) if self.slots else own
        work = UnitProcessor(self.log, self.plan, device)
        work.batch_done = report_alive
        return work


def run_unit(work: UnitProcessor, batch_size: int, unit: Unit) -> UnitResult:
    """In a worker: return the part of a unit, with its rows in a temporary file.

    Args:
        work: See :class:`UnitContext`.
        batch_size: Frames computed together, where not as many as planned.
        unit: One of the plan's.

    Raises:
        JaxdetError: The log can't be read any more, or needs to be scanned as a whole.
        OutputError: The disk is full or broken.
    """
    work.plan = work.plan._replace(batch_size=batch_size)
    ((_, part),) = work.process_units([unit])
    return part.saved(rows_path(work.plan.scratch, unit))


def mark_unit_failed(
    work: UnitProcessor, unit: Unit, status: FrameStatus, reason: str
) -> UnitResult:
    """In a worker: return a part of rows without results, see :meth:`UnitProcessor.mark_failed`."""
    part = work.mark_failed(unit, status, reason)
    return part.saved(rows_path(work.plan.scratch, unit))


def decide_floors(*args: Any) -> Planes:
    """In a worker: :func:`jaxdet.engine.floors.decide_planes`."""
    return decide_planes(*args, alive=report_alive)


def _work(backend: BackendName, pipe: Any, server_pipe: ServerPipe | None) -> None:
    """What a worker does, until its parent ends it or has ended."""
    global _server_pipe, _progress
    ignore_stops()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _begin(backend, reads_only=server_pipe is not None)
    _server_pipe, _progress = server_pipe, _Alive(pipe)
    context: Any = None
    with suppress(EOFError, OSError):
        pipe.send(_ALIVE)
        while True:
            message = pickle.loads(pipe.recv_bytes())
            if message == _NEW_CONTEXT:
                if isinstance(context, UnitProcessor):
                    context.close()
                context = _Lazy(pipe.recv_bytes())
                continue
            function, args, with_context = message
            if with_context and isinstance(context, _Lazy):
                opened = _guarded(context.open, ())
                if isinstance(opened, Failure):
                    pipe.send(_Answer(opened))
                    continue
                context = opened
            pipe.send(_Answer(_guarded(function, (context, *args) if with_context else args)))


class _Lazy(NamedTuple):
    """A context that is not open yet."""

    data: bytes

    def open(self) -> Any:
        """Return what calls need of it."""
        context: Context = pickle.loads(self.data)
        return context.open()


class _Alive:
    """Tells the parent that this process makes progress, at most once a second."""

    def __init__(self, pipe: Any) -> None:
        self._pipe, self._next = pipe, 0.0

    def __call__(self) -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + _ALIVE_S
            self._pipe.send(_ALIVE)


def _end_with_parent() -> None:
    if parent := multiprocessing.parent_process():
        wait([parent.sentinel])
        os._exit(1)


def _begin(backend: BackendName, *, reads_only: bool) -> None:
    os.environ["PJRT_NPROC"] = "1"  # threads of XLA
    import cv2

    cv2.setNumThreads(1)
    if reads_only:
        start_reading()
    elif backend == "jax":
        start_up()


def _guarded(function: Callable[..., Any], args: tuple) -> Any:
    """What a function returns or raises, as something that can be sent."""
    try:
        return function(*args)
    except Exception as error:
        known = isinstance(error, JaxdetError)
        told = error if known else WorkerError(f"{type(error).__name__}: {error}")
        return Failure(told, traceback.format_exc(), out_of_memory(error))
