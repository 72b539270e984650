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
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.engine.device import OwnDevice, SharedDevice, out_of_memory
from jaxdet.engine.floors import Planes, decide_planes
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.slots import Piped, Slots
from jaxdet.engine.startup import start_reading, start_up
from jaxdet.engine.unit import LogWork
from jaxdet.errors import FrameStatus, JaxdetError, WorkerError
from jaxdet.pipeline import BackendName
from jaxdet.results.durable import writing
from jaxdet.results.summary import Counts
from jaxdet.signals import ignore_stops

if TYPE_CHECKING:
    from jaxdet.io import Log

_ALIVE, _ALIVE_S = "alive", 1.0
"""What a worker says, and how often at most."""


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


class Worker:
    """A process that is given functions, one after the other.

    Args:
        context: How processes are started.
        backend: What it computes with.
        piped: Its way to the process that computes for it; None: it computes itself.
    """

    def __init__(self, context: Any, backend: BackendName, piped: Piped | None) -> None:
        self.pipe, self._theirs = multiprocessing.Pipe()
        self._piped = piped
        given = backend, self._theirs, piped
        self.process = context.Process(target=_work, args=given, daemon=True)
        self.given: deque[Any] = deque()
        """What it has been given and has not answered, the oldest first."""
        self.ready = False
        """It has begun."""
        self.still = 0.0
        """Seconds without a sign of progress, while it has something to do."""

    def start(self) -> None:
        """Starts the process; takes a while."""
        try:
            self.process.start()
        finally:
            self._theirs.close()
            if self._piped:
                self._piped.pipe.close()  # so that the station sees when the worker is gone

    def give(self, label: Any, function: Callable[..., Any], *args: Any) -> None:
        """Gives it a function; ``label`` says what it is."""
        self.given.append(label)
        with suppress(OSError):  # it has died, which receive() says
            self.pipe.send_bytes(pickle.dumps((function, args), 5))

    def receive(self) -> list[tuple[Any, Any]]:
        """What it has answered since, with the labels.

        Raises:
            EOFError: It has died.
        """
        answers = []
        try:
            while self.pipe.poll():
                told = self.pipe.recv()
                self.still = 0.0
                if isinstance(told, _Answer):
                    answers.append((self.given.popleft(), told.value))
                else:
                    self.ready = True
        except (EOFError, OSError):
            if not answers:
                raise EOFError from None
        return answers

    def end(self) -> None:
        """Kills it; what is whole is on the disk."""
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


_piped: Piped | None = None
"""In a worker: its way to the process that computes for it."""
_progress: Callable[[], Any] = int
"""In a worker: tells its parent that it is alive."""


def tell_alive() -> None:
    """In a worker: tells its parent that there is progress."""
    _progress()


@lru_cache(maxsize=1)
def shared_device(slots: Slots) -> SharedDevice:
    """In a worker: the process that computes for it."""
    assert _piped is not None
    return SharedDevice(slots, _piped)


_open: dict[Path, LogWork] = {}
"""Likewise: the log of the last unit, by the file of :func:`save_work`."""


_numbers = itertools.count()
"""Of the files that workers are given."""


def save_work(folder: Path, given: Any) -> Path:
    """Writes what workers need of several tasks, in a new file of a folder."""
    path = folder / f"{os.getpid()}-{next(_numbers)}.work"
    with writing(path):
        path.write_bytes(pickle.dumps(given, 5))
    return path


class UnitWork(NamedTuple):
    """What :func:`run_unit` needs in another process."""

    log: "Log"
    """Open; what is in its files does not go with it."""
    plan: LogPlan
    slots: Slots | None
    """With GPUs: where images go."""


def run_unit(path: Path, unit: Unit) -> Counts:
    """In a worker: leaves the part of a unit, which depends on nothing but the arguments.

    Args:
        path: Holds :class:`UnitWork`.
        unit: One of the plan's.

    Returns:
        Its counts.

    Raises:
        JaxdetError: The log can't be read any more, or needs to be scanned as a whole.
        OutputError: The disk is full or broken, or the plan's store can't be reached.
    """
    (counts,) = _opened(path).work_through([unit])
    return counts


def lose_unit(path: Path, unit: Unit, status: FrameStatus, reason: str) -> Counts:
    """In a worker: leaves a part of rows without results, see :meth:`LogWork.lose`."""
    return _opened(path).lose(unit, status, reason)


def _opened(path: Path) -> LogWork:
    if path not in _open:
        for work in _open.values():
            work.log.close()
        _open.clear()
        given: UnitWork = pickle.loads(path.read_bytes())
        log, plan, slots = given
        own = OwnDevice(plan.config, plan.backend, ahead=0)
        _open[path] = work = LogWork(log, plan, shared_device(slots) if slots else own)
        work.batch_done = tell_alive
    return _open[path]


def decide_floors(*args: Any) -> Planes:
    """In a worker: :func:`jaxdet.engine.floors.decide_planes`."""
    return decide_planes(*args, alive=tell_alive)


def _work(backend: BackendName, pipe: Any, piped: Piped | None) -> None:
    """What a worker does, until its parent ends it or has ended."""
    global _piped, _progress
    ignore_stops()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _begin(backend, reads_only=piped is not None)
    _piped, _progress = piped, _Alive(pipe)
    with suppress(EOFError, OSError):
        pipe.send(_ALIVE)
        while True:
            function, args = pickle.loads(pipe.recv_bytes())
            pipe.send(_Answer(_guarded(function, args)))


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
