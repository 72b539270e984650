"""Processes that work on units: how many, how they start, and what is done when one fails."""

import multiprocessing
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import chain
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.config import Config
from jaxdet.engine.device_server import DeviceServer, server_config
from jaxdet.engine.plan import LogPlan, Unit
from jaxdet.engine.shared_slots import ServerPipe, Slots
from jaxdet.engine.startup import may_use_gpus, start_cuda, start_up
from jaxdet.engine.tasks import TaskQueue, UnitQueue
from jaxdet.engine.unit_result import UnitResult
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
    from jaxdet.engine.device_queue import ServerConfig
    from jaxdet.io import Log

WAITING = 2
"""Units that a worker has been given: the one it works on, and the next."""
NO_PROGRESS_S = 600.0
"""A worker that finishes no batch for so long hangs; the first one may have to be compiled."""
LOADED = ["jaxdet.engine.log_per_worker", "jaxdet.io.opening", "numpy.ma", "jaxdet_kernels.decode"]
LOADED_TO_COMPUTE = ["jaxdet.stages._detect", "jaxdet.stages._points"]
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
    computes for all of them, see :mod:`jaxdet.engine.device_server`.

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
        self._server: DeviceServer | None = None
        self._pipes: list[Any] = []
        """With GPUs: to each worker, and the worker's end of it."""
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
            self._pipes = [multiprocessing.Pipe() for _ in range(self.count) if self.devices]
            ends = [ServerPipe(number, theirs) for number, (_, theirs) in enumerate(self._pipes)]
            self._workers = [
                Worker(self._context, self._backend, end) for end in ends or [None] * self.count
            ]
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
        """Start the processes and begin to compute for them, if that is not done for such a log.

        Args:
            log: Open log.
            config: The method's parameters.
            batch_size: Frames computed together; None: as many as the memory is meant for.
            piece_frames: Most frames of a slot that there is room for.

        Returns:
            The slots for the workers, and the frames computed together.

        Raises:
            WorkerError: There is not as much memory.
        """
        self.start()
        served = server_config(log, config, batch_size, piece_frames, self.count)
        if self._server is None or self._server.served != served:
            self._end_server()
            self._server = DeviceServer(served, [ours for ours, _ in self._pipes], self.devices)
        return self._server.memory.slots, served.pieces * served.slots.frames

    @property
    def serving(self) -> "ServerConfig | None":
        """What workers are served in: slots, camera and configuration."""
        one = self._server
        return one and one.served._replace(slots=one.memory.slots)

    def _end_server(self) -> None:
        if self._server:
            self._server.close()
        self._server = None

    def close(self) -> None:
        """Ends the processes."""
        with stops_held_back():
            if self._workers:
                self._ended.set()
                self._started.wait()
            for worker in self._workers:
                worker.end()
            self._end_server()
            for end in chain(*self._pipes):
                end.close()
            self._workers, self._pipes = [], []

    def call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return what a worker's call of a function returns; it is tried twice.

        Raises:
            WorkerError: The worker died or hangs.
            JaxdetError: As the function raises it.
        """
        where = "before the first frame"
        answer = self._alone(None, function, where, *args)
        if isinstance(answer, Lost):
            answer = self._alone(None, function, where, *args)
        if isinstance(answer, Lost):
            raise answer.as_raised(where)
        return answer

    def process_units(
        self, plan: LogPlan, make_context: MakeContext
    ) -> Generator[tuple[Unit, UnitResult], None, None]:
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
        todo, failure = UnitQueue(plan.units(), self.count), None
        while todo:
            given = make_context(), run_unit, todo, lambda unit: (plan.batch_size, unit)
            with closing(self.each(*given)) as answers:
                for unit, answer in answers:
                    if failure:
                        continue  # which lets the workers live
                    part = answer
                    if isinstance(part, Lost):
                        part = self._retry(plan, unit, part, make_context)
                    if isinstance(part, Failure):
                        failure = part.as_raised(plan.where(unit))
                        todo.clear()
                    else:
                        yield unit, part
        if failure:
            raise failure

    def _retry(
        self, plan: LogPlan, unit: Unit, lost: "Lost", make_context: MakeContext
    ) -> UnitResult:
        """Return the part of a lost unit, which is done alone; its frames get a status if not."""
        batch = plan.batch_size if self.devices else max(1, plan.batch_size // 2)
        where = plan.where(unit)
        found = self._alone(make_context(), run_unit, where, batch, unit)
        if not isinstance(found, Lost):
            return found
        reason = f"{found.reason}, twice" if found.reason == lost.reason else found.reason
        given = where, unit, found.status, reason
        found = self._alone(make_context(), mark_unit_failed, *given)
        if isinstance(found, Lost):
            raise found.as_raised(where)
        return found

    def _alone(
        self, context: Context | None, function: Callable[..., Any], where: str, *args: Any
    ) -> "Any | Lost":
        """Return what one call returns, while no other is made."""
        ((_, answer),) = self.each(context, function, TaskQueue([where]), lambda _: args)
        if isinstance(answer, Failure):
            raise answer.as_raised(where)
        return answer

    def each(
        self,
        context: Context | None,
        function: Callable[..., Any],
        tasks: TaskQueue | UnitQueue,
        args_of: Callable[[Any], tuple],
    ) -> Generator[tuple[Any, Any], None, None]:
        """Yield what workers' calls of a function return, as they come.

        Args:
            context: Makes the first argument of the calls; None: they have none.
            function: Of the module level.
            tasks: What is to be done. A worker gets the next one ahead while there are more than
                workers: the last ones wait for whoever is done first.
            args_of: Returns the other arguments of a task's call.

        Yields:
            A task, and what was returned, or a :class:`Failure`. When a worker dies, hangs or runs
            out of memory, all have ended: its task comes last, with :class:`Lost`, and those of
            the others are back among ``tasks``.
        """
        self.start()
        self._started.wait()
        packed = None if context is None else PackedContext(context)
        try:
            while True:
                for most in range(1, WAITING + 1):
                    for number, worker in enumerate(self._workers):
                        more = len(tasks) > len(self._workers) * (most > 1)
                        if more and len(worker.given) < most:
                            task = tasks.take(number)
                            worker.give(task, function, *args_of(task), context=packed)
                if not any(worker.given for worker in self._workers):
                    return
                for worker, told in self._poll():
                    if isinstance(told, Lost):
                        task, *rest = worker.given
                        others = (one.given for one in self._workers if one is not worker)
                        tasks.put_back([*rest, *chain(*others)])
                        self.close()
                        yield task, told
                        return
                    yield from told
        finally:
            if any(worker.given for worker in self._workers):
                self.close()

    def _poll(self) -> "Iterator[tuple[Worker, list[tuple[Any, Any]] | Lost]]":
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
                    yield worker, Lost(FrameStatus.TIMEOUT, text)
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
                    yield worker, Lost(FrameStatus.WORKER_CRASHED, worker.death)
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
                yield worker, Lost(FrameStatus.WORKER_CRASHED, "out of memory")
                return


class Lost(NamedTuple):
    """Instead of an answer: the worker died, hangs or ran out of memory."""

    status: FrameStatus
    reason: str

    def as_raised(self, where: str) -> WorkerError:
        """Return the error of a call that was lost."""
        remedy = "if memory ran out, take fewer workers (--workers) or smaller batches"
        return WorkerError(f"{where}: {self.reason}", remedy=remedy)


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
