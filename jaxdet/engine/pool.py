"""Processes that work on units: how many, how they start, and what is said when one dies."""

import importlib.util
import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import forkserver, resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from jaxdet.config import Config
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.startup import start_reading, start_up
from jaxdet.engine.station import Piped, Slots, Station
from jaxdet.engine.unit import run_unit
from jaxdet.errors import JaxdetError, WorkerError
from jaxdet.pipeline import BackendName
from jaxdet.results.summary import Counts

if TYPE_CHECKING:
    from jaxdet.io import Log

Value = TypeVar("Value")

WAITING = 4
"""Units given out ahead, for each worker."""
LOADED = ["jaxdet.engine.pool", "jaxdet.io.log"]
LOADED_TO_COMPUTE = ["jaxdet.stages"]
"""What the fork server loads once for all workers; none of it may start a thread."""


def gpus() -> tuple[Any, ...]:
    """The GPUs that JAX computes on; without its plugin for them JAX needn't be loaded."""
    if os.environ.get("JAX_PLATFORMS") == "cpu" or not importlib.util.find_spec("jax_plugins"):
        return ()
    start_up()
    from jaxdet.stages._device import on_cuda
    from jaxdet.stages._spread import devices_for

    return devices_for(None) if on_cuda() else ()


class Failure(NamedTuple):
    """Instead of a unit's counts."""

    error: Exception
    trace: str


class Pool:
    """Worker processes; a context manager that ends them.

    On the CPU each does the whole of a unit. For GPUs they read and make rows, and this process
    computes for all of them, see :mod:`jaxdet.engine.station`.

    They start when they are first needed and stay for the next log. On Linux and macOS they are
    forked from a server that has loaded JAX and Warp once, elsewhere each loads them itself.

    Args:
        count: Number of processes.
        backend: What they compute with.
        devices: GPUs to compute on.
    """

    def __init__(self, count: int, backend: BackendName, devices: Sequence[Any] = ()) -> None:
        self.count, self.devices = count, devices
        self._backend: BackendName = backend
        self._station: Station | None = None
        self._context = _context()
        self._executor: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Pool":
        """The pool itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the processes at once: what is whole is on the disk."""
        self.close()

    @property
    def started(self) -> bool:
        """Whether the processes are there, or on their way."""
        return self._executor is not None

    def start(self) -> None:
        """Begins to start the processes, if they are not there."""
        if self._executor is not None:
            return
        if self._context.get_start_method() == "forkserver":
            with _interrupts_held_back():
                compute = self._backend == "jax" and not self.devices
                multiprocessing.set_forkserver_preload(LOADED + LOADED_TO_COMPUTE * compute)
                forkserver.ensure_running()
        numbers = self._context.SimpleQueue()
        for number in range(self.count):
            numbers.put(number)
        self._station = Station(self.count, self.devices) if self.devices else None
        ends = self._station.ends if self._station else None
        begin = partial(_begin, self._backend, numbers, ends)
        self._executor = ProcessPoolExecutor(self.count, self._context, begin)
        # Not a thread to be joined: a Ctrl-C while Python joins one marks it as ended.
        self._ended, self._awake = threading.Event(), threading.Event()
        given = self._executor, self.count, self._ended, self._awake
        threading.Thread(target=_wake, args=given, name="jaxdet-pool", daemon=True).start()

    def serve(self, log: "Log", config: Config, batch_size: int | None) -> tuple[Slots, int]:
        """Starts the processes and begins to compute for them, see :meth:`Station.enter`."""
        self.start()
        assert self._station is not None
        return self._station.enter(log, config, batch_size)

    def close(self) -> None:
        """Ends the processes."""
        if self._executor is not None:
            self._ended.set()
            self._awake.wait()
        for process in self._context.started:
            process.kill()
        self._end()
        self._context.started.clear()

    def _end(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
        if self._station is not None:
            self._station.close()
        self._executor = self._station = None

    def call(self, function: Callable[..., Value], *args: Any) -> Value:
        """What a worker's call of a function returns.

        Raises:
            WorkerError: The worker died.
            JaxdetError: As the function raises it.
        """
        self.start()
        self._awake.wait()
        assert self._executor is not None
        try:
            found = self._executor.submit(_guarded, function, *args).result()
        except BrokenProcessPool:
            raise self._died(None) from None
        if isinstance(found, Failure):
            raise _as_raised(found, "before the first frame")
        return found

    def work_through(self, path: Path, plan: LogPlan) -> Generator[Counts, None, None]:
        """The counts of each unit of a log, in order, as its part is there.

        Args:
            path: See :func:`jaxdet.engine.unit.run_unit`.
            plan: The same plan.

        Raises:
            WorkerError: A worker died, or failed in a way that nobody foresaw.
            JaxdetError: As :func:`jaxdet.engine.unit.run_unit` raises it.
        """
        self.start()
        self._awake.wait()
        units = plan.units()
        waiting: deque[tuple[Unit, Future]] = deque()
        try:
            while self._give(waiting, path, units):
                unit, future = waiting.popleft()
                counts = future.result()
                if isinstance(counts, Failure):
                    raise _as_raised(counts, plan.where(unit))
                yield counts
        except BrokenProcessPool:
            raise self._died(plan) from None
        finally:
            for _, future in waiting:
                future.cancel()
            for _, future in waiting:
                with suppress(BaseException):
                    future.result()

    def _give(self, waiting: deque[tuple[Unit, Future]], path: Path, units: Iterable[Unit]) -> bool:
        """Gives out units up to the limit; whether any are waited for."""
        assert self._executor is not None
        while len(waiting) < WAITING * self.count and (unit := next(iter(units), None)):
            waiting.append((unit, self._executor.submit(_serve, path, unit)))
        return bool(waiting)

    def _died(self, plan: LogPlan | None) -> WorkerError:
        """What is said of the worker that died; the next log gets new ones."""
        self._end()  # the executor has ended the other workers by SIGTERM
        ended = [p for p in self._context.started if p.exitcode not in (None, 0)]
        self._context.started.clear()
        ended.sort(key=lambda process: process.exitcode == -signal.SIGTERM)
        code = ended[0].exitcode or 0 if ended else 0
        where = _claimed(plan, ended[0].pid) if plan and ended else "before the first frame"
        if code >= 0:
            remedy = "its own message is above; a script needs: if __name__ == '__main__'"
            return WorkerError(f"{where}: a worker process ended with code {code}", remedy=remedy)
        name = f"signal {-code}"
        with suppress(ValueError):
            name = signal.Signals(-code).name
        remedy = "if memory ran out, take fewer workers (--workers) or smaller batches"
        return WorkerError(f"{where}: {name} ended a worker process", remedy=remedy)


def _context() -> Any:
    """A way to start processes that keeps them in its list ``started``."""
    methods = multiprocessing.get_all_start_methods()
    kind: Any = type(
        multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    )

    class Recording(kind):
        def __init__(self) -> None:
            super().__init__()
            self.started: list[Any] = []

        def Process(self, *args: Any, **kwargs: Any) -> Any:  # noqa: N802
            self.started.append(super().Process(*args, **kwargs))
            return self.started[-1]

    return Recording()


def _wake(
    executor: ProcessPoolExecutor, count: int, ended: threading.Event, awake: threading.Event
) -> None:
    """Starts all processes of a pool, which starts one only where none is idle.

    In a thread, as the fork server takes a while to load what it loads, and so that a Ctrl-C never
    leaves a process half started.
    """
    for _ in range(count):
        if not ended.is_set():
            with suppress(BrokenProcessPool):  # said to whoever gives it work
                executor.submit(os.getpid)
    awake.set()


_piped: Piped | None = None
"""A worker's way to the station."""


def _begin(backend: BackendName, numbers: Any, ends: Sequence[Piped] | None) -> None:
    """What a worker does first."""
    global _piped
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the workers
    os.environ["PJRT_NPROC"] = "1"  # threads of XLA
    import cv2

    cv2.setNumThreads(1)
    number = numbers.get()
    for end in ends or ():
        if end.number == number:
            _piped = end
        else:
            end.pipe.close()
    if ends:
        start_reading()
    elif backend == "jax":
        start_up()


def _serve(path: Path, unit: Unit) -> Counts | Failure:
    """A unit in a worker; what comes back is small enough to come back whole or not at all."""
    _claim(path.parent, os.getpid()).write_text(f"{unit.number}", encoding="ascii")
    return _guarded(run_unit, path, unit, _piped)


def _guarded(function: Callable[..., Value], *args: Any) -> Value | Failure:
    """What a function returns or raises, as something that can be sent."""
    try:
        return function(*args)
    except Exception as error:
        return _failure(error)


def _claim(folder: Path, pid: int) -> Path:
    """The file that says which unit a worker has."""
    return folder / f"{pid}.worker"


def _claimed(plan: LogPlan, pid: int) -> str:
    """What a worker that has died worked on."""
    try:
        number = int(_claim(plan.folder, pid).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return f"{plan.log}, at the start of a worker"
    return next(plan.where(unit) for unit in plan.units() if unit.number == number)


def _failure(error: Exception) -> Failure:
    trace = traceback.format_exc()
    known = isinstance(error, JaxdetError)
    return Failure(error if known else WorkerError(f"{type(error).__name__}: {error}"), trace)


def _as_raised(failure: Failure, where: str) -> Exception:
    error, trace = failure
    if type(error) is WorkerError:
        error = WorkerError(f"{where}: {error}")
    error.add_note(f"{where}, in a worker process:\n{trace}")
    return error


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """A Ctrl-C waits meanwhile; processes started here never get one, their parent does.

    The mask is what the processes inherit; another thread may still take the signal, so there is
    a handler too.
    """
    if (
        not hasattr(signal, "pthread_sigmask")
        or threading.current_thread() is not threading.main_thread()
    ):
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
