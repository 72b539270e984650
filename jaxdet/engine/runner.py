"""Runs over many logs: each log in, a folder of results out."""

import logging
import os
import pickle
import signal
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from jaxdet.config import Config
from jaxdet.config_file import find_config
from jaxdet.cores import cores
from jaxdet.engine.crew import Crew, Job, OneProcess, PoolCrew, memory_plan
from jaxdet.engine.device import OwnDevice
from jaxdet.engine.log_job import make_log
from jaxdet.engine.memory import Memory
from jaxdet.engine.options import RunOptions
from jaxdet.engine.output import OutputFolder
from jaxdet.engine.plan import Observer
from jaxdet.engine.pool import Pool, gpus
from jaxdet.engine.progress import Progress, ProgressCallback
from jaxdet.engine.tasks import TaskQueue
from jaxdet.engine.whole_logs import FEW_BYTES, OtherCamera, WorkerJob, choose_whole, do_log
from jaxdet.errors import ConfigError, InputError, Interrupted, OutputError
from jaxdet.io import LogFiles, LogOptions, find_logs
from jaxdet.memory import size_text
from jaxdet.presets import DEFAULT_PRESET, PRESETS
from jaxdet.results.manifest import fingerprint
from jaxdet.results.publish import remove
from jaxdet.results.record import digest, make_record
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.signals import stops_held_back, stops_raised

if TYPE_CHECKING:
    from jaxdet.io import Log
    from jaxdet.types import Calibration

LOGGER = logging.getLogger("jaxdet")
FRAMES_WORTH_WORKERS = 500
"""Fewer are done sooner by this process than workers have started."""
Logs = str | PathLike[str] | Sequence[str | PathLike[str]] | Sequence[LogFiles]


class How(TypedDict, total=False):
    """Arguments of a run, fields of :class:`jaxdet.engine.RunOptions`."""

    batch_size: int | None
    pictures: int
    map: bool
    overwrite: bool
    update: bool


class Hooks(How, total=False):
    """Arguments of :meth:`Runner.run`."""

    observers: Mapping[str, Observer]
    preset: str | None


def run(
    logs: Logs,
    output: str | PathLike[str],
    config: Config | str | PathLike[str] = DEFAULT_PRESET,
    *,
    log: LogOptions | None = None,
    progress: ProgressCallback | None = None,
    backend: Literal["jax", "reference"] = "jax",
    workers: int | None = None,
    memory: str | None = None,
    **options: Unpack[How],
) -> Summary:
    """Find the obstacles in every frame of logs and write a folder of results for each.

    Logs that are done already, with this configuration and version, are left as they are, so the
    same call continues a run that was stopped. A log that fails costs no other; it is in the
    summary, and its folder holds ``failed.json`` in place of results.

    >>> summary = jaxdet.run("bags/", "results", "d435")          # doctest: +SKIP
    >>> [(log.log, log.error) for log in summary.failed]          # doctest: +SKIP
    []

    Args:
        logs: Files, folders and globs, as :func:`jaxdet.find_logs` takes them, or what it returns.
        output: Folder for the results: ``output/<log>/``, see ``jaxdet help runs``.
        config: Configuration, name of a preset, or file.
        log: How to read the logs; by default as the command does.
        progress: Called after each unit of frames and each log.
        backend: Flag of ``jaxdet run`` (:class:`jaxdet.engine.RunOptions`), as those below.
        workers: Number of processes.
        memory: Most memory of all processes.
        options: ``batch_size``, ``pictures``, ``map``, ``overwrite`` and ``update``.

    Returns:
        Counts and the summary of every log.

    Raises:
        ConfigError: The output folder holds results of another configuration or version or of a
            log that has changed; another run works there; or an argument is wrong.
        InputError: There are no logs, or the output folder can't be written to.
        OutputError: The disk is full or broken; logs that are done are kept.
        WorkerStartError: Worker processes can't be started.
        Interrupted: A signal (Ctrl-C) ended it; logs that are done are kept.
    """
    with Runner(backend, workers, memory) as runner:
        return runner.run(logs, output, config, log=log, progress=progress, **options)


class Runner:
    """Worker processes and compiled programs that outlive a run; a context manager that ends them.

    >>> with jaxdet.Runner() as runner:                           # doctest: +SKIP
    ...     for name in arriving_logs():
    ...         runner.run(name, "results")

    Args:
        backend: See :class:`jaxdet.engine.RunOptions`, as for the others.
        workers: Number of processes.
        memory: Most memory of all processes.

    Raises:
        ConfigError: There is too little memory for any log, or an argument is wrong.
    """

    def __init__(
        self,
        backend: Literal["jax", "reference"] = "jax",
        workers: int | None = None,
        memory: str | None = None,
    ) -> None:
        self._options = RunOptions(Path(), backend=backend, workers=workers, memory=memory)
        Memory(memory, 1)  # too little is refused before anything is touched
        self._pool: Pool | None = None

    def __enter__(self) -> "Runner":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes."""
        if self._pool:
            self._pool.close()
        self._pool = None

    def run(
        self,
        logs: Logs,
        output: str | PathLike[str],
        config: Config | str | PathLike[str] = DEFAULT_PRESET,
        *,
        log: LogOptions | None = None,
        progress: ProgressCallback | None = None,
        **options: Unpack[Hooks],
    ) -> Summary:
        """Do what :func:`jaxdet.run` does.

        Args:
            logs: See there, as the others.
            output: Folder for the results.
            config: Configuration.
            log: How to read the logs.
            progress: Called after each unit and each log.
            options: As there, and ``observers`` (which see each batch of every log, and whose
                answers are in its summary) and ``preset`` (name of the preset that the
                configuration started from, for ``config.json``).
        """
        one = self._prepared(_find(logs), Path(output), config, log, options)
        one.progress = progress
        return one.run()

    def run_alone(
        self, files: LogFiles, folder: Path, config: Config, log: LogOptions, **options: Any
    ) -> Summary:
        """Write the results of one log into a new folder, which is no part of a run's.

        Args:
            files: The log.
            folder: New folder for the results.
            config: Configuration.
            log: How to read it.
            options: As of :meth:`run`, and ``about``, see :func:`jaxdet.engine.run_one`.
        """
        one = self._prepared([files], folder, config, log, options)
        one.job.about.update(options.get("about") or {})
        return one.run_alone(folder)

    def _prepared(
        self,
        logs: Sequence[LogFiles],
        output: Path,
        config: Config | str | PathLike[str],
        log: LogOptions | None,
        options: Mapping[str, Any],
    ) -> "_Run":
        how = {name: options[name] for name in How.__annotations__ if name in options}
        chosen = replace(self._options, output=output, **how)
        return _Run(self, logs, config, log or LogOptions(), chosen, options)

    def pool(self, memory: Memory, devices: tuple[object, ...]) -> Pool:
        """Return the worker processes, which need not be there yet."""
        if self._pool is None:
            self._pool = Pool(memory.workers, self._options.backend, devices)
        self._pool.resize(memory.workers)
        return self._pool


def _find(logs: Logs) -> list[LogFiles]:
    """Return the logs in order."""
    if isinstance(logs, Iterable) and not isinstance(logs, str):
        given = list(logs)
        if given and all(isinstance(log, LogFiles) for log in given):
            return sorted(given, key=lambda log: log.name)  # pyright: ignore
    return sorted(find_logs(logs), key=lambda log: log.name)  # pyright: ignore[reportArgumentType]


class _Run:
    """One run; arguments as of :meth:`Runner.run`."""

    def __init__(
        self,
        runner: Runner,
        logs: Sequence[LogFiles],
        config: Config | str | PathLike[str],
        log_options: LogOptions,
        options: RunOptions,
        hooks: Mapping[str, Any],
    ) -> None:
        self.runner, self.logs, self.options = runner, logs, options
        self.progress: ProgressCallback | None = None
        preset, observers = hooks.get("preset"), hooks.get("observers") or {}
        if preset is None and isinstance(config, str) and config in PRESETS:
            preset = config
        self.config = config = find_config(config)
        _check_observers(observers)
        _check_outside(options.output, logs)
        self.record = make_record(
            config,
            log_options,
            preset,
            backend=options.backend,
            pictures=options.pictures,
            map=options.map,
            observers=observers,
        )
        about = {name: self.record["about"][name] for name in ("jaxdet", "source", "versions")}
        self.job = Job(config, log_options, options, observers, about, self.record["config"])
        self.done: dict[str, list[LogSummary]] = {}
        """Summaries of the cameras of logs, by the logs' names."""
        self.kept: frozenset[str] = frozenset()
        self.numbers = {log.name: number for number, log in enumerate(logs)}
        self.batch, self.workers = options.batch_size or 0, 1
        """Frames computed together and processes that shared the work, at most."""

    def run(self) -> Summary:
        """Do all logs that are not done."""
        start = time.perf_counter()
        with OutputFolder(self.options.output, self.record, self.options) as output:
            self.output = output
            self.done = output.begin(self.logs)
            self.job.about["run"] = output.run
            self.kept = frozenset(self.done)
            if self.done and len(self.done) < len(self.logs):
                done, total = len(self.done), len(self.logs)
                LOGGER.info("continuing: %d of %d logs are done", done, total)
            try:
                with stops_raised():
                    self._run_logs({f.name: f for f in self.logs if f.name not in self.done})
            except KeyboardInterrupt as stop:
                self.runner.close()
                number = getattr(stop, "signal", signal.SIGINT)
                raise Interrupted(number, f"interrupted; {self._standing()}") from None
            except BaseException as error:
                self.runner.close()
                if isinstance(error, InputError | OutputError) and self.done:
                    error.add_remedy(self._standing())
                raise
        return self._summary(time.perf_counter() - start)

    def run_alone(self, folder: Path) -> Summary:
        """Write the results of the only log into a new folder."""
        start, (log,) = time.perf_counter(), self.logs
        self.job.about["run"] = digest(self.record)
        self.memory, self.pool = self._resources(apart=False)
        try:
            with stops_raised():
                given = self.memory, self._choose, self._report
                self.done[log.name] = make_log(self.job, log, folder, *given)
        except BaseException:
            self.runner.close()
            raise
        return self._summary(time.perf_counter() - start)

    def _summary(self, seconds: float) -> Summary:
        found = [about for log in self.logs for about in self.done[log.name]]
        summary = Summary(self.options.backend, self.batch, found, seconds, kept=self.kept)
        summary.workers = max([self.workers, *(about.workers for about in found)])
        return summary

    def _standing(self) -> str:
        done, total = len(self.done), len(self.logs)
        some = "no log is done" if not done else f"{done} of {total} logs are done"
        but = " without --overwrite" if self.options.overwrite else ""
        return f"{some}; the same command{but} goes on"

    def _run_logs(self, left: dict[str, LogFiles]) -> None:
        """Do logs: small ones one per worker, the others shared by all workers, one by one."""
        if not left:
            return
        self.memory, self.pool = self._resources(apart=self.output.taken_over)
        alone = self._for_workers(left)
        cameras: dict[str, Calibration] = {}
        while left:
            ready = [name for name in alone if self._ready(cameras.get(name))]
            if ready:
                for name, answer in self._by_workers({name: left[name] for name in ready}):
                    if isinstance(answer, OtherCamera):
                        cameras[name] = answer.calibration
                    elif isinstance(answer, list):
                        alone.remove(name)
                        self._take(left.pop(name), answer)
                    else:
                        alone.remove(name)
                continue
            name = next((name for name in left if name not in alone), None) or alone.pop(0)
            self._do_here(left.pop(name))

    def _resources(self, *, apart: bool) -> tuple[Memory, Pool]:
        """Return memory and processes; ``apart``: logs are left to workers, be it one."""
        asked, options = self.options.workers, self.options
        devices = gpus() if options.backend == "jax" else ()
        workers = asked or max(1, cores() - bool(devices))
        largest = self.job.log_options.max_chunk_mib << 20
        memory = Memory(options.memory, workers, len(devices), apart=apart, largest=largest)
        if asked and memory.workers < asked:
            room = f"{size_text(memory.total)} of memory have no room for more"
            LOGGER.warning("%d of %d workers: %s", memory.workers, asked, room)
        return memory, self.runner.pool(memory, devices)

    def _for_workers(self, left: Mapping[str, LogFiles]) -> list[str]:
        """Return the logs that are done one per worker, the largest first."""
        if self.memory.workers == 1 or len(left) == 1:
            return []
        sizes = {name: sum(map(_size, log.paths)) for name, log in left.items()}
        workers_wanted = self.options.workers or self.pool.devices or self.pool.started
        if sum(sizes.values()) < FEW_BYTES and not workers_wanted:
            return []
        return sorted(choose_whole(sizes, self.memory.workers), key=lambda name: -sizes[name])

    def _ready(self, camera: "Calibration | None") -> bool:
        """Whether a worker can do a log of a camera by itself, as the pool is now."""
        if not self.pool.devices:
            return True
        served = self.pool.serving
        if served is None or self.pool.count != self.memory.workers:
            return False  # the next log that is shared out makes all workers be served
        return served.config == self.config and camera in (None, served.calibration)

    def _by_workers(self, logs: Mapping[str, LogFiles]):  # noqa: ANN202 (a generator)
        """Yield logs as workers have done them, one per worker, each with the answer."""
        self.pool.resize(self.memory.workers)
        self.workers = self.pool.count
        served = self.pool.serving
        slots = served and (served.slots, served.calibration)
        batch = served.pieces * served.slots.frames if served else 0
        context = WorkerJob(self.job, self.memory, len(self.pool.devices), slots, batch)
        tasks = {name: (log, self.output.staged(name)) for name, log in logs.items()}
        for _, staged in tasks.values():
            remove(staged)  # of a worker that was ended
        first = next(iter(logs))
        self._report(LogSummary(first, ()), first, 0, "opening")
        for name, answer in self.pool.each(context, do_log, TaskQueue(tasks), tasks.__getitem__):
            if not isinstance(answer, list):
                remove(tasks[name][1])
            yield name, answer

    def _do_here(self, log: LogFiles) -> None:
        """Do a log by this process, or by all workers together."""
        staged = self.output.staged(log.name)
        remove(staged)  # of a worker that was lost
        done = make_log(self.job, log, staged, self.memory, self._choose, self._report)
        if any(about.error for about in done):
            self._check_there(log)
        self._take(log, done)

    def _take(self, log: LogFiles, done: list[LogSummary]) -> None:
        """Put the results of a log in their place."""
        with stops_held_back():
            self.output.publish(log.name)
            self.done[log.name] = done
        for about in done:
            self._report(about, about.log, about.frames, "")
            if about.error:
                LOGGER.info("%s: failed: %s", about.log, about.error)
            else:
                counts = about.frames, about.obstacles
                LOGGER.info("%s: done, %d frames, %d obstacles", about.log, *counts)

    def _choose(self, log: "Log", memory: Memory) -> Crew:
        """Choose who works on a log: this process where it has few frames."""
        # After a run that ended without a word this process leaves all logs to workers: what
        # ended it may be in one of them.
        apart = bool(self.pool.devices) or memory.apart
        workers = self.options.workers or self.pool.started
        few = not apart and not (workers or len(log.frames) >= FRAMES_WORTH_WORKERS)
        alone = few or (memory.workers == 1 and not apart)
        plan = memory_plan(self.job, log, memory, 1 if alone else memory.workers)
        self.batch = max(self.batch, plan.batch)
        if alone or (plan.workers == 1 and not apart):
            if not few:
                self.pool.resize(1)  # there is no memory for others
            device = OwnDevice(self.config, self.options.backend, ahead=1)
            return OneProcess(self.job, plan, device)
        return PoolCrew(self.job, self.pool, plan)

    def _report(self, about: LogSummary, label: str, total: int, doing: str) -> None:
        """Tell the log and the callback where the run stands."""
        stands = doing or f"{about.frames} of {total} frames"
        LOGGER.debug("%s: %s", label, stands)
        if self.progress:
            state = about.frames, total, about.num_bad, about.frames_per_s, about.bottleneck
            number, count = self.numbers[about.log], len(self.logs)
            failed = sum(any(one.error for one in done) for done in self.done.values())
            logs = len(self.done), failed
            self.progress(Progress(label, number, count, *state, about.rates, doing, *logs))

    def _check_there(self, failed: LogFiles) -> None:
        """Make sure that the disk of a log that failed is still there.

        It is gone where other logs are gone with it. A single log that is gone was removed, and
        costs no other.

        Raises:
            InputError: It is gone; nothing that is done is lost.
        """
        others = [log for log in self.logs if log is not failed and log.name not in self.done]
        if _gone(failed) and (not others or any(map(_gone, others))):
            path, remedy = str(failed.paths[0]), "see that its disk is there"
            raise InputError("is not there any more", path=path, remedy=remedy)


def _gone(log: LogFiles) -> bool:
    return not all(map(os.path.exists, log.paths))


def _size(path: Path) -> int:
    """Return the size of a file, or of a folder's files [bytes]; 0 where it can't be read."""
    with suppress(OSError):
        return fingerprint(path).get("size", 0) if path.is_dir() else path.stat().st_size
    return 0


def _check_observers(observers: Mapping[str, Observer]) -> None:
    """Make sure that observers can be sent to other processes.

    Raises:
        ConfigError: They can't.
    """
    try:
        pickle.dumps(dict(observers))
    except Exception as error:
        problem = f"observers can't go to other processes ({error})"
        raise ConfigError(problem, remedy="make them instances of a module's classes") from error


def _check_outside(output: Path, logs: Sequence[LogFiles]) -> None:
    """Make sure that results don't change a log that is a folder.

    Raises:
        ConfigError: The output is in one.
    """
    place = output.resolve()
    for folder in (path for log in logs for path in log.paths if path.is_dir()):
        if place.is_relative_to(folder.resolve()):
            problem, remedy = f"is in the log {folder}", "give an --output beside it"
            raise ConfigError(problem, path=str(output), remedy=remedy)
