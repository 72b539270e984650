"""Pool of worker processes: their number, their start, and the handling of lost workers."""

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import chain
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from multiprocessing.util import Finalize
from typing import Any
from weakref import WeakMethod

from jaxdet.engine.gpu import GpuThreads
from jaxdet.engine.plan import UnitQueue
from jaxdet.engine.slots import GpuPipe, Served
from jaxdet.engine.startup import may_use_gpus, start_cuda, start_up
from jaxdet.engine.worker import Failure, Job, Lost, Worker
from jaxdet.errors import FrameStatus, WorkerStartError
from jaxdet.pipeline import BackendName, process_that_used
from jaxdet.signals import STOPS, stops_held_back

WAITING = 2
"""Maximum number of tasks assigned to a worker: the current one and the next."""
NO_PROGRESS_S = 600.0
"""Time without progress after which a worker counts as lost; compiling may take long [s]."""
LOADED = [
    *("jaxdet.engine.process_log", "jaxdet.io.opening", "jaxdet.stages._on_cpu"),
    *("jaxdet_kernels.decode", "numpy.ma"),
]
LOADED_TO_COMPUTE = ["jaxdet.stages._detect", "jaxdet.stages.paper._detect"]
"""Modules that the fork server loads once for all workers, including modules that pyarrow and the
decoders would load later; none of them may start a thread or Warp."""
_LOOK_S = 1.0
"""Maximum time between two checks of all workers [s]."""
_ENDING_S = 0.5
"""Time in which a killed fork server ends, before a new one is started [s]."""
_SHORT_TMPDIR = "set TMPDIR to a folder with a short name and room, for instance /tmp"
_AGAIN = "its fork server may have been killed; run the same command again"
_ENDED_EARLY = "its own message is above; a script with observers needs: if __name__ == '__main__'"


def gpus() -> tuple[Any, ...]:
    """Return the GPUs that JAX computes on; JAX is only loaded if it has a plugin for GPUs."""
    if not may_use_gpus():
        return ()
    if start_cuda():
        _start_server(LOADED)  # loads its modules while JAX looks for GPUs
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
    """Start the process that workers are forked from, on systems that have one, unless it runs.

    Args:
        loaded: Modules that it loads once for all workers.

    Raises:
        WorkerStartError: Its socket can't be made in the temporary folder.
    """
    if _start_method() == "forkserver":
        with _stops_kept_from_processes():
            multiprocessing.set_forkserver_preload(loaded)
            try:
                forkserver.ensure_running()
            except OSError as error:
                problem = f"workers can't be started ({error.strerror or error})"
                raise WorkerStartError(problem, remedy=_SHORT_TMPDIR) from error


class TaskQueue:
    """Tasks that free workers take in order.

    Args:
        tasks: The tasks.
    """

    def __init__(self, tasks: Iterable[Any]) -> None:
        self._left = deque(tasks)

    def __len__(self) -> int:
        return len(self._left)

    def take(self, worker: int) -> Any:
        """Return the next task for the worker of this number; the queue must not be empty."""
        return self._left.popleft()

    def put_back(self, tasks: Iterable[Any]) -> None:
        """Put tasks that were taken but not done back at the front."""
        self._left.extendleft(tasks)


class Pool:
    """Worker processes; a context manager that ends them.

    On the CPU each worker does all steps of a unit. With GPUs, workers read images and make rows,
    and this process computes for all of them, see :mod:`jaxdet.engine.gpu`.

    Workers start when they are first needed and stay for the next log. On Linux and macOS they are
    forked from a server that has loaded JAX and Warp once; elsewhere each worker loads both. If a
    worker dies or makes no progress, all workers are ended; they start again with the next task.

    Args:
        backend: Backend with which the workers compute.
        count: Number of processes, see :meth:`resize`.
    """

    def __init__(self, backend: BackendName, count: int = 1) -> None:
        self.count = count
        self._backend: BackendName = backend
        self._gpus: GpuThreads | None = None
        self._pipes: list[Any] = []
        """With GPUs: both ends of a pipe to each worker."""
        self._context: Any = multiprocessing.get_context(_start_method())
        self._workers: list[Worker] = []
        self._imports_main = False
        self._early = 0
        """Number of workers with tasks that died during their start since the last answer."""
        self._ended, self._started = threading.Event(), threading.Event()
        # Before multiprocessing sends workers SIGTERM, which they ignore, and waits for them.
        Finalize(self, _close, (WeakMethod(self.close),), exitpriority=0)

    def __enter__(self) -> "Pool":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @cached_property
    def devices(self) -> tuple[Any, ...]:
        """GPUs that compute for the workers; empty with the reference backend."""
        return gpus() if self._backend == "jax" else ()

    @property
    def started(self) -> bool:
        """Whether the processes have started, or are starting."""
        return bool(self._workers)

    def start(self) -> None:
        """Begin to start the processes, unless they have been started.

        Raises:
            WorkerStartError: They can't be started.
        """
        if process_that_used("workers") != os.getpid():
            problem = "workers can't be started in a process forked from one that started some"
            raise WorkerStartError(problem, remedy="start processes with spawn")
        if self._workers:
            return
        if self._early:
            time.sleep(_ENDING_S)
        compute = self._backend == "jax" and not self.devices
        _start_server(LOADED + LOADED_TO_COMPUTE * compute)
        with stops_held_back():  # close() waits for the thread
            self._pipes = [multiprocessing.Pipe() for _ in range(self.count) if self.devices]
            ends = [GpuPipe(number, theirs) for number, (_, theirs) in enumerate(self._pipes)]
            self._workers = [
                Worker(self._context, self._backend, end) for end in ends or [None] * self.count
            ]
            self._ended, self._started = threading.Event(), threading.Event()
            # A thread starts the workers, as the fork server takes a while to load its modules, and
            # so that no signal leaves a process half started. The thread is never joined, because a
            # Ctrl-C while Python joins a thread marks the thread as ended.
            given = self._workers, self._ended, self._started, self._imports_main
            threading.Thread(target=_wake, args=given, name="jaxdet-pool", daemon=True).start()

    def resize(self, count: int) -> None:
        """Set the number of processes; if it changes, running processes are ended."""
        if count != self.count:
            self.close()
            self.count = count

    def import_main(self) -> None:
        """Import the program's main module in the processes; running ones are ended."""
        if not self._imports_main:
            self.close()
            self._imports_main = True

    def serve(self, wanted: Served) -> Served:
        """Start the processes, and threads that compute frames of this format, unless they run.

        Returns:
            The format with the memory of the frames, see :attr:`serving`.

        Raises:
            WorkerError: There is too little memory.
        """
        self.start()
        if self._gpus is None or self._gpus.wanted != wanted:
            self._end_gpus()
            self._gpus = GpuThreads(wanted, [ours for ours, _ in self._pipes], self.devices)
        return self._gpus.memory.served

    @property
    def serving(self) -> Served | None:
        """Format and memory of frames for the GPUs; None before :meth:`serve`."""
        return self._gpus and self._gpus.memory.served

    def _end_gpus(self) -> None:
        if self._gpus:
            self._gpus.close()
        self._gpus = None

    def close(self) -> None:
        """End the processes."""
        with stops_held_back():
            if self._workers:
                self._ended.set()
                self._started.wait()
            for worker in self._workers:
                worker.end()
            self._end_gpus()
            for end in chain(*self._pipes):
                end.close()
            self._workers, self._pipes = [], []

    def call(self, job: Job, task: Any, where: str, tries: int = 1) -> Any:
        """Return the answer to a single task.

        Args:
            job: Job of the task.
            task: The task.
            where: Name of the task for errors.
            tries: Maximum number of tries; the task is tried again if its worker is lost.

        Returns:
            The answer; :class:`Lost` if a worker was lost in each try.

        Raises:
            WorkerError: The task raised an unforeseen exception.
            JaxdetError: Exception of the task.
        """
        answer = None
        for _ in range(tries):
            ((_, answer),) = self.each(job, TaskQueue([task]))
            if isinstance(answer, Failure):
                raise answer.as_raised(where)
            if not isinstance(answer, Lost):
                break
        return answer

    def each(
        self, job: Job, tasks: TaskQueue | UnitQueue
    ) -> Generator[tuple[Any, Any], None, None]:
        """Yield tasks with their answers, in the order in which workers answer.

        Args:
            job: Job of the tasks.
            tasks: Queue of tasks. A worker gets its next task in advance while there are more tasks
                than workers; the last tasks go to the workers that are free first.

        Yields:
            A task and its answer, which may be a :class:`Failure`. If a worker is lost, all workers
            are ended: its task comes last, with :class:`Lost`, and the tasks of the other workers
            are put back into ``tasks``.
        """
        self.start()
        self._started.wait()
        packed, opened = pickle.dumps(job, 5), set[Worker]()
        try:
            while True:
                for most in range(1, WAITING + 1):
                    for number, worker in enumerate(self._workers):
                        more = len(tasks) > len(self._workers) * (most > 1)
                        if more and len(worker.pending) < most:
                            first = worker not in opened
                            opened.add(worker)
                            worker.send(tasks.take(number), packed if first else b"")
                if not any(worker.pending for worker in self._workers):
                    return
                for worker, found in self._poll():
                    if isinstance(found, Lost):
                        task, *rest = worker.pending
                        others = (one.pending for one in self._workers if one is not worker)
                        tasks.put_back([*rest, *chain(*others)])
                        self.close()
                        yield task, found
                        return
                    yield from found
        finally:
            if any(worker.pending for worker in self._workers):
                self.close()

    def _poll(self) -> Iterator[tuple[Worker, list[tuple[Any, Any]] | Lost]]:
        """Wait a second at most; yield workers with their answers, or with the loss of a worker.

        Raises:
            WorkerError: Workers can't start.
        """
        before = time.monotonic()
        readable = wait([worker.pipe for worker in self._workers], _LOOK_S)
        # Time for which this process was stopped or the machine slept is not counted.
        passed = min(time.monotonic() - before, 2 * _LOOK_S)
        for worker in list(self._workers):
            if worker.pipe not in readable:
                worker.idle_s += passed if worker.pending else 0.0
                if worker.idle_s > NO_PROGRESS_S:
                    text = f"a worker process made no progress for {NO_PROGRESS_S:g} s"
                    yield worker, Lost(FrameStatus.TIMEOUT, text)
                    return
                continue
            try:
                answers = worker.receive()
            except EOFError:
                self._early = 0 if worker.ready else self._early + bool(worker.pending)
                if not worker.ready and (self._early > 1 or not worker.killed):
                    died = worker.death
                    self.close()
                    remedy = _AGAIN if worker.process.pid is None else _ENDED_EARLY
                    raise WorkerStartError(died, remedy=remedy) from None
                if worker.pending:
                    yield worker, Lost(FrameStatus.WORKER_CRASHED, worker.death)
                    return
                worker.end()
                self._workers.remove(worker)
                continue
            if answers:
                self._early = 0
            short = [
                task
                for task, answer in answers
                if isinstance(answer, Failure) and answer.out_of_memory
            ]
            yield worker, [answer for answer in answers if answer[0] not in short]
            if short:
                worker.pending.extendleft(reversed(short))
                yield worker, Lost(FrameStatus.WORKER_CRASHED, "out of memory")
                return


def _close(close: WeakMethod) -> None:
    """End the processes of a pool that was not closed, if it is still there."""
    if there := close():
        there()


def _wake(
    workers: list[Worker], ended: threading.Event, awake: threading.Event, imports_main: bool
) -> None:
    """Start all processes, unless the pool is closed meanwhile."""
    try:
        for worker in workers:
            if not ended.is_set():
                # If the fork server was killed, the worker's pipe is closed, which is reported.
                with suppress(EOFError, OSError):
                    worker.start(imports_main=imports_main)
    finally:
        awake.set()


@contextmanager
def _stops_kept_from_processes() -> Iterator[None]:
    """Hold back signals that end a run; processes started meanwhile never get them from a terminal.

    These processes inherit the signal mask. As another thread of this process may still get a
    signal, a handler holds it back too.
    """
    if (
        not hasattr(signal, "pthread_sigmask")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    resource_tracker.ensure_running()  # starting it later would reset the mask
    with stops_held_back():
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
