"""Processes that work on units: how many, how they start, and what is done when one fails."""

import multiprocessing
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from jaxdet.config import Config
from jaxdet.engine.part import Part
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.slots import Slots
from jaxdet.engine.startup import may_use_gpus, start_cuda, start_up
from jaxdet.engine.station import Station
from jaxdet.engine.unit_queue import UnitQueue
from jaxdet.engine.worker import (
    Context,
    Failure,
    PackedContext,
    UnitContext,
    Worker,
    mark_unit_failed,
    run_unit,
)
from jaxdet.errors import FrameStatus, WorkerError, WorkerStartError
from jaxdet.pipeline import BackendName
from jaxdet.signals import STOPS, stops_held_back

if TYPE_CHECKING:
    from jaxdet.engine.lane import Served
    from jaxdet.io import Log

Value = TypeVar("Value")
Label = TypeVar("Label")

LOST = "lost"
"""Instead of an answer."""

WAITING = 2
"""Units that a worker has been given: the one it works on, and the next."""
NO_PROGRESS_S = 600.0
"""A worker that finishes no batch for so long hangs; the first one may have to be compiled."""
LOADED = ["jaxdet.engine.whole_logs", "jaxdet.io.log", "numpy.ma", "jaxdet_kernels.decode"]
LOADED_TO_COMPUTE = ["jaxdet.stages"]
"""What the fork server loads once for all workers, with what pyarrow and decoders would load in
each of them; none of it may start a thread, or Warp."""
_LOOK_S = 1.0
"""So often workers are looked after."""
_SHORT_TMPDIR = "set TMPDIR to a folder with a short name and room, for instance /tmp"
_ENDED_EARLY = "its own message is above; a script needs: if __name__ == '__main__'"


def gpus() -> tuple[Any, ...]:
    """The GPUs that JAX computes on; without its plugin for them JAX needn't be loaded."""
    if not may_use_gpus():
        return ()
    if start_cuda():
        _start_server(LOADED)  # while JAX looks for them
    start_up()
    import jax

    from jaxdet.stages._batches import check_capability, default_device, on_cuda

    if not on_cuda():
        return ()
    chosen = getattr(jax.config, "jax_default_device", None)
    devices = tuple(jax.local_devices()) if chosen is None else (default_device(),)
    check_capability(devices)
    return devices


def _start_method() -> str:
    return "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def _start_server(loaded: list[str]) -> None:
    """Starts the process that workers are forked from, if there is to be one and it isn't there.

    Raises:
        WorkerError: The temporary folder has no room for its socket, whose name is short.
    """
    if _start_method() == "forkserver":
        with _stops_kept_from_processes():
            multiprocessing.set_forkserver_preload(loaded)
            try:
                forkserver.ensure_running()
            except OSError as error:
                problem = f"workers can't be started ({error.strerror or error})"
                raise WorkerStartError(problem, remedy=_SHORT_TMPDIR) from error


MakeContext = Callable[[], UnitContext]
"""Makes what workers need for a log, as things are now."""


class Pool:
    """Worker processes; a context manager that ends them.

    On the CPU each does the whole of a unit. For GPUs they read and make rows, and this process
    computes for all of them, see :mod:`jaxdet.engine.station`.

    They start when they are first needed and stay for the next log. On Linux and macOS they are
    forked from a server that has loaded JAX and Warp once, elsewhere each loads them itself.

    When one dies or hangs, all are ended and started again; each loses at most the units that it
    was given.

    Args:
        count: Number of processes.
        backend: What they compute with.
        devices: GPUs to compute on.
    """

    def __init__(self, count: int, backend: BackendName, devices: Sequence[Any] = ()) -> None:
        self.count, self.devices = count, devices
        self._backend: BackendName = backend
        self._station: Station | None = None
        self._context: Any = multiprocessing.get_context(_start_method())
        self._workers: list[Worker] = []
        self._early = 0
        """Workers that died before they had begun, since one has answered."""
        self._ended, self._started = threading.Event(), threading.Event()

    def __enter__(self) -> "Pool":
        """The pool itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes at once."""
        self.close()

    @property
    def started(self) -> bool:
        """Whether the processes are there, or on their way."""
        return bool(self._workers)

    def start(self) -> None:
        """Begins to start the processes, if they are not there."""
        if self._workers:
            return
        compute = self._backend == "jax" and not self.devices
        _start_server(LOADED + LOADED_TO_COMPUTE * compute)
        with stops_held_back():  # close() waits for the thread
            self._station = Station(self.count, self.devices) if self.devices else None
            ends = self._station.ends if self._station else [None] * self.count
            self._workers = [Worker(self._context, self._backend, end) for end in ends]
            self._ended, self._started = threading.Event(), threading.Event()
            # In a thread, as the fork server takes a while to load what it loads, and so that a
            # signal never leaves a process half started; not to be joined: a Ctrl-C while Python
            # joins one marks it as ended.
            given = self._workers, self._ended, self._started
            threading.Thread(target=_wake, args=given, name="jaxdet-pool", daemon=True).start()

    def resize(self, count: int) -> None:
        """Another number of processes from now on; those that are there end."""
        if count != self.count:
            self.close()
            self.count = count

    def serve(
        self, log: "Log", config: Config, batch_size: int | None, piece_frames: int
    ) -> tuple[Slots, int]:
        """Starts the processes and begins to compute for them, see :meth:`Station.enter`."""
        self.start()
        assert self._station is not None
        return self._station.enter(log, config, batch_size, piece_frames)

    @property
    def serving(self) -> "Served | None":
        """What workers are served in, see :attr:`Station.serving`."""
        return self._station and self._station.serving

    def close(self) -> None:
        """Ends the processes."""
        with stops_held_back():
            if self._workers:
                self._ended.set()
                self._started.wait()
            for worker in self._workers:
                worker.end()
            if self._station is not None:
                self._station.close()
            self._workers, self._station = [], None

    def call(self, function: Callable[..., Value], *args: Any) -> Value:
        """Return what a worker's call of a function returns; it is tried twice.

        Raises:
            WorkerError: The worker died or hangs.
            JaxdetError: As the function raises it.
        """
        where = "before the first frame"
        try:
            return self._call(where, None, function, *args)
        except _WorkerLostError:
            return self._call(where, None, function, *args)

    def each(
        self, context: Context, function: Callable[..., Any], tasks: Mapping[Label, tuple]
    ) -> Generator[tuple[Label, Any], None, None]:
        """What workers' calls of a function return, as they come.

        When a worker dies, hangs or runs out of memory all have ended, and nothing comes after.

        Args:
            context: What the calls have in common.
            function: Of the module level.
            tasks: Its other arguments, in the order in which they are given out.

        Returns:
            The task's key, and what was returned; :data:`LOST` for what the lost worker was at.
        """
        todo = deque(tasks.items())
        give = partial(self._give_each, PackedContext(context), function, todo)
        with closing(self._answers(give)) as answers:
            for worker, told in answers:
                if isinstance(told, _Problem):
                    yield worker.given[0], LOST
                    return
                yield from told

    def _give_each(
        self,
        context: PackedContext,
        function: Callable[..., Any],
        todo: deque[tuple[Any, tuple]],
    ) -> None:
        """Gives workers calls to do, one ahead while there are more than workers.

        The last ones wait here for whoever is done first.
        """
        for most in range(1, WAITING + 1):
            for worker in self._workers:
                spare = len(todo) > len(self._workers) * (most > 1)
                if len(worker.given) < most and spare:
                    label, args = todo.popleft()
                    worker.give(label, function, *args, context=context)

    def _answers(
        self, give: Callable[[], None]
    ) -> "Generator[tuple[Worker, list[tuple[Any, Any]] | _Problem], None, None]":
        """What :meth:`_poll` yields until workers have nothing to do; ends those that still have.

        Args:
            give: Gives them more, if there is more.
        """
        self.start()
        self._started.wait()
        try:
            while True:
                give()
                if not any(worker.given for worker in self._workers):
                    return
                yield from self._poll()
        finally:
            if any(worker.given for worker in self._workers):
                self.close()

    def work_through(
        self, plan: LogPlan, make_context: MakeContext
    ) -> Generator[tuple[Unit, Part], None, None]:
        """Yield the units of a log with their parts, as they come.

        A unit whose worker dies, hangs or runs out of memory is tried once more, alone and, where
        workers compute, in smaller batches. If that fails too its part says that it is lost.

        Args:
            plan: The log's.
            make_context: Called now and after each new start.

        Raises:
            WorkerError: A worker failed in an unforeseen way.
            JaxdetError: As :func:`jaxdet.engine.worker.run_unit` raises it.
        """
        todo = UnitQueue(plan.units(), self.count)
        while todo:
            lost = yield from self._until_one_is_lost(plan, todo, PackedContext(make_context()))
            if lost:
                yield lost[0], self._retry(plan, *lost, make_context)

    def _until_one_is_lost(
        self, plan: LogPlan, todo: UnitQueue, context: PackedContext
    ) -> "Generator[tuple[Unit, Part], None, tuple[Unit, _Problem] | None]":
        """Take units from ``todo`` until none is left, or a worker failed; then all have ended."""
        give = partial(self._give, todo, context, plan.batch_size)
        with closing(self._answers(give)) as answers:
            for worker, told in answers:
                if isinstance(told, _Problem):
                    lost = worker.given[0]
                    given = {unit for one in self._workers for unit in one.given}
                    todo.put_back(given - {lost})
                    return lost, told
                for unit, part in told:
                    if isinstance(part, Failure):
                        self._drain()
                        raise part.as_raised(plan.where(unit))
                    yield unit, part
        return None

    def _give(self, todo: UnitQueue, context: PackedContext, batch_size: int) -> None:
        """Give workers units to do."""
        for most in range(1, WAITING + 1):
            for number, worker in enumerate(self._workers):
                if len(worker.given) < most and (unit := todo.take(number)):
                    worker.give(unit, run_unit, batch_size, unit, context=context)

    def _drain(self) -> None:
        """Waits for what has been given out, which is not wanted any more."""
        while any(worker.given for worker in self._workers):
            if any(isinstance(told, _Problem) for _, told in self._poll()):
                return

    def _retry(
        self, plan: LogPlan, unit: Unit, problem: "_Problem", make_context: MakeContext
    ) -> Part:
        """Return the part of a lost unit, which is done alone; its frames get a status if not."""
        batch = plan.batch_size if self.devices else max(1, plan.batch_size // 2)
        where = plan.where(unit)
        try:
            return self._call(where, make_context, run_unit, batch, unit)
        except _WorkerLostError as again:
            self.close()
            status, reason = again.problem
            reason += ", twice" * (reason == problem.reason)
            return self._call(where, make_context, mark_unit_failed, unit, status, reason)

    def _call(
        self,
        where: str,
        make_context: MakeContext | None,
        function: Callable[..., Value],
        *args: Any,
    ) -> Value:
        self.start()
        self._started.wait()
        context = PackedContext(make_context()) if make_context else None
        self._workers[0].give(where, function, *args, context=context)
        while True:
            for _, told in self._poll():
                if isinstance(told, _Problem):
                    self.close()
                    raise _WorkerLostError(where, told)
                for _, found in told:
                    if isinstance(found, Failure):
                        raise found.as_raised(where)
                    return found

    def _poll(self) -> "Iterator[tuple[Worker, list[tuple[Any, Any]] | _Problem]]":
        """Waits a little; what workers answered, or what is the matter with one.

        Raises:
            WorkerError: Workers can't start.
        """
        before = time.monotonic()
        told = wait([worker.pipe for worker in self._workers], _LOOK_S)
        # Not more than a second or two, so that time in which this process was stopped, or the
        # machine asleep, is nobody's fault.
        passed = min(time.monotonic() - before, 2 * _LOOK_S)
        for worker in list(self._workers):
            if worker.pipe not in told:
                worker.idle_s += passed if worker.given else 0.0
                if worker.idle_s > NO_PROGRESS_S:
                    text = f"a worker process made no progress for {NO_PROGRESS_S:g} s"
                    yield worker, _Problem(FrameStatus.TIMEOUT, text)
                    return
                continue
            try:
                answers = worker.receive()
            except EOFError:
                self._early = 0 if worker.ready else self._early + 1
                if not worker.ready and (self._early > 1 or not worker.by_signal):
                    died = worker.death
                    self.close()
                    raise WorkerStartError(died, remedy=_ENDED_EARLY) from None
                if worker.given:
                    yield worker, _Problem(FrameStatus.WORKER_CRASHED, worker.death)
                    return
                worker.end()
                self._workers.remove(worker)
                continue
            if answers:
                self._early = 0
            short = [one for one, found in answers if isinstance(found, Failure) and found.memory]
            yield worker, [answer for answer in answers if answer[0] not in short]
            if short:
                worker.given.extendleft(reversed(short))
                yield worker, _Problem(FrameStatus.WORKER_CRASHED, "out of memory")
                return


class _Problem(NamedTuple):
    """Why a worker has to be replaced."""

    status: FrameStatus
    reason: str


class _WorkerLostError(WorkerError):
    """A worker died, hangs or ran out of memory."""

    def __init__(self, where: str, problem: _Problem) -> None:
        remedy = "if memory ran out, take fewer workers (--workers) or smaller batches"
        super().__init__(f"{where}: {problem.reason}", remedy=remedy)
        self.problem = problem


def _wake(workers: list[Worker], ended: threading.Event, awake: threading.Event) -> None:
    """Starts all processes."""
    try:
        for worker in workers:
            if not ended.is_set():
                worker.start()
    finally:
        awake.set()


@contextmanager
def _stops_kept_from_processes() -> Iterator[None]:
    """Signals that end a run wait meanwhile; processes started here never get one from a terminal.

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
    with stops_held_back():
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
