"""Worker processes: the code that runs in them, and their handles in the process that starts them.

A worker gets tasks one by one, and answers each. The first task of a job comes with the job, which
holds the data that its tasks share (an open log, for instance). A worker ends when its parent ends,
for any reason.
"""

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from importlib.machinery import ModuleSpec
from multiprocessing.connection import wait
from typing import Any, NamedTuple, Protocol

from jaxdet.engine.device import Device, OwnDevice, out_of_memory
from jaxdet.engine.settings import RunSettings
from jaxdet.engine.slots import GpuPipe, Served, SharedDevice
from jaxdet.engine.startup import start_reading, start_up
from jaxdet.errors import FrameStatus, JaxdetError, WorkerError
from jaxdet.pipeline import BackendName
from jaxdet.signals import ignore_stops

_ALIVE, _ALIVE_S = "alive", 1.0
"""Message that reports progress, and the minimum time between two such messages [s]."""


class Job(Protocol):
    """Tasks of one kind and the data that they share; it is pickled and sent to workers once."""

    def open(self, process: "WorkerProcess") -> AbstractContextManager[Callable[[Any], Any]]:
        """Return the function that performs a task, in a context that lasts until the next job.

        Args:
            process: The worker process in which the job is opened.
        """
        ...


class Failure(NamedTuple):
    """Answer to a task that raised an exception."""

    error: Exception
    trace: str
    """Traceback in the worker."""
    out_of_memory: bool

    def as_raised(self, where: str) -> Exception:
        """Return the exception to raise; an unforeseen exception names the task, ``where``."""
        if type(self.error) is not WorkerError:
            return self.error
        error = WorkerError(f"{where}: {self.error}")
        error.add_note(f"{where}, in a worker process:\n{self.trace}")
        return error


class Lost(NamedTuple):
    """Substitute for the answer to a task whose worker died, hung or ran out of memory."""

    status: FrameStatus
    """Status of the task's frames, which have no results."""
    reason: str

    def as_raised(self, where: str) -> WorkerError:
        """Return an error that names the task, ``where``."""
        remedy = "if memory ran out, take fewer workers (--workers) or smaller batches"
        return WorkerError(f"{where}: {self.reason}", remedy=remedy)


class _Answer(NamedTuple):
    """Message from a worker: the answer to its oldest task."""

    value: Any


class Worker:
    """Handle of a worker process, in the process that starts it.

    Args:
        context: Context of :mod:`multiprocessing`, which decides how processes start.
        backend: Backend that computes in the worker.
        gpu_pipe: Connection to the threads with GPUs; None if the worker computes itself.

    Attributes:
        pending: Tasks without an answer, the oldest first.
        ready: Whether the process has started up.
        idle_s: Time without a sign of progress while tasks are pending [s].
    """

    def __init__(self, context: Any, backend: BackendName, gpu_pipe: GpuPipe | None) -> None:
        self.pipe, self._theirs = multiprocessing.Pipe()
        self._gpu_pipe = gpu_pipe
        given = backend, self._theirs, gpu_pipe
        self.process = context.Process(target=_run_worker, args=given, daemon=True)
        self.pending: deque[Any] = deque()
        self.ready, self.idle_s = False, 0.0

    def start(self, *, imports_main: bool) -> None:
        """Start the process, which takes a while.

        Args:
            imports_main: Whether the process imports the main module, which defines observers.
        """
        try:
            with _from_any_program(imports_main=imports_main):
                self.process.start()
        finally:
            self._theirs.close()
            if self._gpu_pipe:
                self._gpu_pipe.pipe.close()  # so that the threads see when the worker ends

    def send(self, task: Any, job: bytes = b"") -> None:
        """Send a task, whose data must be small.

        Args:
            task: The task.
            job: Pickled :class:`Job` to which this and all further tasks belong; empty if it was
                sent with an earlier task. The call waits until the worker has read the job, so no
                task may be pending.
        """
        assert not (job and self.pending)
        self.pending.append(task)
        message = job and os.getcwd(), task
        with suppress(OSError):  # the worker has died, which receive() reports
            self.pipe.send(message)
            if job:
                self.pipe.send_bytes(job)

    def receive(self) -> list[tuple[Any, Any]]:
        """Return the tasks that were answered since the last call, with their answers.

        Raises:
            EOFError: The process has died.
        """
        answers = []
        try:
            while self.pipe.poll():
                message = self.pipe.recv()
                self.idle_s = 0.0
                if isinstance(message, _Answer):
                    answers.append((self.pending.popleft(), message.value))
                else:
                    self.ready = True
        except (EOFError, OSError):
            if not answers:
                raise EOFError from None
        return answers

    def end(self) -> None:
        """Kill the process."""
        if self.process.pid is not None:
            self.process.kill()
            self.process.join()
        self.pipe.close()
        self._theirs.close()

    @property
    def killed(self) -> bool:
        """Whether a signal ended the process, or the fork server before it started the process."""
        code = self._exit_code()
        return code is None or code < 0

    @property
    def death(self) -> str:
        """Description of how the process ended, for errors."""
        code = self._exit_code()
        if code is None:
            return "a worker process can't be started"
        if code >= 0:
            return f"a worker process ended with code {code}"
        name = f"signal {-code}"
        with suppress(ValueError):
            name = signal.Signals(-code).name
        return f"{name} ended a worker process"

    def _exit_code(self) -> int | None:
        if self.process.pid is None:
            return None
        self.process.join(5)
        return self.process.exitcode


_starting = threading.Lock()


@contextmanager
def _from_any_program(*, imports_main: bool) -> Iterator[None]:
    """Let :mod:`multiprocessing` start processes from programs that are not made for it.

    Processes don't import a main module whose name is ``__main__``, so scripts need no ``if
    __name__ == "__main__":``, and programs from standard input, which have no file, can start
    workers. Daemonic processes, for instance those of a :class:`multiprocessing.Pool`, may have
    children, since workers end with their parent.

    Args:
        imports_main: Whether the process imports the main module nevertheless.
    """
    main, process = sys.modules["__main__"], multiprocessing.current_process()
    with _starting:
        before = main.__spec__, process.daemon
        process.daemon = False
        if not imports_main:
            main.__spec__ = ModuleSpec("__main__", None)
        try:
            yield
        finally:
            main.__spec__, process.daemon = before


class WorkerProcess:
    """The worker process, with its connections and the job that it works on.

    Args:
        pipe: Connection to the parent.
        gpu_pipe: Connection to the threads with GPUs; None if this process computes itself.
    """

    def __init__(self, pipe: Any, gpu_pipe: GpuPipe | None) -> None:
        self._pipe, self._gpu_pipe = pipe, gpu_pipe
        self._next_report = 0.0
        self._shared: SharedDevice | None = None
        self._job = b""
        """Pickled job that is not open yet."""
        self._folder = ""
        """Current folder of the parent, to which paths in the job are relative."""
        self._perform: Callable[[Any], Any] | None = None
        self._context = ExitStack()

    def run(self) -> None:
        """Perform tasks until the parent closes its end of the connection."""
        with suppress(EOFError, OSError):
            self.report_progress()
            while True:
                folder, task = self._pipe.recv()
                if folder:  # a job follows
                    self._context.close()
                    self._folder, self._job = folder, self._pipe.recv_bytes()
                    self._perform = None
                self._pipe.send(_Answer(self._answer(task)))

    def _answer(self, task: Any) -> Any:
        """Return the job's answer to a task; open the job first, unless it is open.

        If anything fails, the answer is a :class:`Failure`.
        """
        try:
            if self._perform is None:
                os.chdir(self._folder)
                job: Job = pickle.loads(self._job)
                self._perform = self._context.enter_context(job.open(self))
                self._job = b""  # an index of a log may be large
            return self._perform(task)
        except Exception as error:
            known = isinstance(error, JaxdetError)
            shown = error if known else WorkerError(f"{type(error).__name__}: {error}")
            return Failure(shown, traceback.format_exc(), out_of_memory(error))

    def report_progress(self) -> None:
        """Report to the parent that the task makes progress, at most once per ``_ALIVE_S``."""
        now = time.monotonic()
        if now >= self._next_report:
            self._next_report = now + _ALIVE_S
            self._pipe.send(_ALIVE)

    def device(self, served: Served | None, settings: RunSettings) -> Device:
        """Return the device that computes.

        Args:
            served: Format of the frames that GPUs compute; None if this process computes itself.
            settings: Settings of the run.
        """
        if served is None:
            return OwnDevice(settings.config, settings.options.backend, ahead=0)
        if self._shared is None or self._shared.served != served:
            assert self._gpu_pipe is not None
            self._shared = SharedDevice(served, self._gpu_pipe)
        return self._shared


def _run_worker(backend: BackendName, pipe: Any, gpu_pipe: GpuPipe | None) -> None:
    """Perform tasks until the parent kills this process or ends itself."""
    ignore_stops()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _prepare(backend, reads_only=gpu_pipe is not None)
    WorkerProcess(pipe, gpu_pipe).run()


def _end_with_parent() -> None:
    if parent := multiprocessing.parent_process():
        wait([parent.sentinel])
        os._exit(1)


def _prepare(backend: BackendName, *, reads_only: bool) -> None:
    """Limit libraries to one thread, and load the modules that compute or read."""
    os.environ["PJRT_NPROC"] = "1"  # threads of XLA
    import cv2

    cv2.setNumThreads(1)
    if reads_only:
        start_reading()
    elif backend == "jax":
        start_up()
