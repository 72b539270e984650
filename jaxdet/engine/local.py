"""The local loop: logs in, a results folder out."""

import pickle
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxdet.config import Config
from jaxdet.cores import cores
from jaxdet.engine.join import WHOLE
from jaxdet.engine.kept import KeptLogs
from jaxdet.engine.log_run import PLAN, RunContext
from jaxdet.engine.memory import Memory
from jaxdet.engine.options import RunOptions
from jaxdet.engine.part_store import PartStore
from jaxdet.engine.plan import LogPlan, Observer
from jaxdet.engine.pool import Pool, gpus
from jaxdet.engine.pooled_run import PooledLogRun, Results
from jaxdet.engine.progress import ProgressCallback, reporter
from jaxdet.engine.record import digest, inputs_of, make_record
from jaxdet.engine.sharing import open_store
from jaxdet.engine.whole_logs import FEW_BYTES, Task, WholeLogs, choose_whole
from jaxdet.engine.workspace import Workspace
from jaxdet.errors import CamerasError, ConfigError, InputError, Interrupted, OutputError
from jaxdet.memory import size_text
from jaxdet.results.durable import writing
from jaxdet.results.manifest import MANIFEST, fingerprint, make_manifest
from jaxdet.results.names import file_names
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.results.writer import ResultWriter, write_json
from jaxdet.signals import stops_held_back, stops_raised

if TYPE_CHECKING:
    from jaxdet.io import LogFiles, LogOptions


def run(
    logs: Sequence["LogFiles"],
    config: Config,
    log_options: "LogOptions",
    options: RunOptions,
    progress: ProgressCallback | None = None,
    observers: Mapping[str, Observer] | None = None,
    preset: str | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Finds the obstacles of every frame of every log and writes the results folder.

    A run that was stopped goes on where it was, when it is asked for again; its results are the
    same bytes. A signal that ends it (Ctrl-C, SIGTERM, SIGHUP) keeps what is done. One log that
    fails, or some of its frames, costs no other.

    Args:
        logs: What :func:`jaxdet.io.find_logs` returns.
        config: The method.
        log_options: How to read.
        options: Where to write, and how to run.
        progress: Called after each unit.
        observers: See each batch of every log; what they say is in the summary under their names.
        preset: Name of the preset that the configuration started from, for config.json.
        say: Gets a line for each thing worth knowing at the start, such as a run that goes on.

    Returns:
        What is in ``summary.json``. Of logs that an update left as they were ``description``,
        ``calibration`` and ``ground`` are what JSON has of them.

    Raises:
        ResultsError: The output folder holds results already.
        ConfigError: It holds an unfinished run with other inputs (but for an update),
            configuration or versions;
            another run works there; it is in a log that is a folder; or the backend has no program
            for the configuration; or there is too little memory for any log; or observers can't
            be pickled.
        InputError: The output folder can't be written to; or the logs are gone, as their disk is;
            what is done is kept.
        OutputError: The disk is full or broken, or there is no memory for the rows of a log; what
            is done is kept.
        Interrupted: A signal ended it; what is done is kept.
    """
    Memory(options.memory, 1)  # too little is said before anything is touched
    _check_observers(observers or {})
    ordered = sorted(logs, key=lambda log: log.name)
    seen = observers or {}
    output = options.output
    _check_outside(output, ordered)
    record = make_record(ordered, config, log_options, options, seen, preset)
    store = options.parts and open_store(options.parts, record, begin=options.share is not None)
    update = partial(KeptLogs, output, ordered, record) if options.update else None
    with Workspace(output, record, overwrite=options.overwrite, update=update, say=say) as work:
        if work.done is not None:
            return work.done
        given = ordered, config, log_options, options, seen, progress, say
        whole = _Run(*given, work, store or None)
        if there := whole.standing():
            say(f"continuing: {there} there")
        try:
            with stops_raised():
                return whole.run(work.record)
        except KeyboardInterrupt as stop:
            there = whole.standing()
            there = f"{there} done; the same command goes on" if there else "nothing is done yet"
            number = getattr(stop, "signal", signal.SIGINT)
            raise Interrupted(number, f"interrupted; {there}") from None
        except (InputError, OutputError) as error:
            if there := whole.standing():
                error.add_remedy(f"the same command goes on: {there} done")
            raise


def _check_observers(observers: Mapping[str, Observer]) -> None:
    """Makes sure that observers can go to other processes."""
    try:
        pickle.dumps(dict(observers))
    except Exception as error:
        problem = f"observers can't go to other processes ({error})"
        raise ConfigError(problem, remedy="make them instances of a module's classes") from error


def _check_outside(output: Path, logs: Sequence["LogFiles"]) -> None:
    """Makes sure that results don't change a log that is a folder."""
    place = output.resolve()
    for folder in (path for log in logs for path in log.paths if path.is_dir()):
        if place.is_relative_to(folder.resolve()):
            problem, remedy = f"is in the log {folder}", "give an --output beside it"
            raise ConfigError(problem, path=str(output), remedy=remedy)


def _is_whole(log: Path) -> bool:
    """Whether a log, by its folder, is done, or its only camera is."""
    return any((log / where).exists() for where in (WHOLE, f"0/{WHOLE}"))


@dataclass
class _Run:
    """The logs of a run, one after the other; the first fields are as of :func:`run`."""

    logs: Sequence["LogFiles"]
    config: Config
    log_options: "LogOptions"
    options: RunOptions
    observers: Mapping[str, Observer]
    progress: ProgressCallback | None
    say: Callable[[str], None]
    work: Workspace
    store: PartStore | None

    def __post_init__(self) -> None:
        """Nothing is done yet."""
        self.kept = kept = self.work.kept
        self.summary = Summary(self.options.backend, self.options.batch_size or 0)
        if kept:
            self.logs, self.summary.kept = kept.logs, kept.names
            self.summary.batch_size = self.options.batch_size or kept.batch_size
        self.files: dict[str, Path] = {}
        """Of the results, by their names."""
        self._start = time.perf_counter()
        self._names = file_names(log.name for log in self.logs)
        """What the logs' files are called."""

    def run(self, record: Mapping[str, Any]) -> Summary:
        """All logs are in the results, but those that have failed."""
        summary, result = self.summary, self.work.result
        with ResultWriter(result) as writer, ThreadPoolExecutor(1, "jaxdet-tables") as thread:
            with self._pool() as pool:
                self._run_logs(pool, writer)
                summary.seconds = time.perf_counter() - self._start
                if not summary.whole or self.options.share:
                    self.work.drop(self.files)
                    return summary
                how = {"preset": None, "backend": None, "batch_size": summary.batch_size}
                config, told = {**how, **record["config"]}, summary.to_dict()
                tables = thread.submit(writer.close, config, told)  # while the processes end
            self.files |= tables.result()
        if self.kept:
            self.files |= self.kept.link_tracks(tables.result(), result / "kept")
        self.files |= write_json(result / "config.json", config)
        self.files |= write_json(result / "summary.json", told)
        with writing(result):
            about = {**record["about"], "run": digest(record)}
            manifest = make_manifest(about, self.files)
        self.files |= write_json(result / MANIFEST, manifest)
        with stops_held_back(drop=True):
            self.work.commit(self.files, summary)
        return summary

    def standing(self) -> str:
        """How much is on the disk, for people; empty: nothing."""
        logs = [self._folder(log) for log in self._to_do]
        left = [log for log in logs if not _is_whole(log)]
        begun: list[tuple[str, int, int]] = []
        for folder in (camera for log in left for camera in sorted(log.glob("*/"))):
            parts = 0 if (folder / WHOLE).exists() else len(list(folder.glob("*.part")))
            plan: LogPlan | None = self.work.read(folder / PLAN) if parts else None
            if plan:
                begun.append((plan.label, parts, len(list(plan.units()))))
        done = len(logs) - len(left)
        text = f"{done} of {len(logs)} logs"
        if begun:
            labels, parts, units = zip(*begun, strict=True)
            which = labels[0] if len(begun) == 1 else f"{len(begun)} others"
            text += f" and {sum(parts)} of {sum(units)} units of {which}"
        return f"{text} are" if done or begun else ""

    @property
    def _to_do(self) -> list["LogFiles"]:
        """The logs that do not stay as they are."""
        return [log for log in self.logs if log.name not in self.summary.kept]

    def _folder(self, log: "LogFiles") -> Path:
        """Where a log's parts are."""
        return self.work.log_folder(log.name, self._names[log.name])

    def _pool(self) -> Pool:
        """The processes that share the work, of which none is there yet."""
        devices = gpus() if self.options.backend == "jax" else ()
        asked = self.options.workers or max(1, cores() - bool(devices))
        how = {"apart": self.work.taken_over, "largest": self.log_options.max_chunk_mib << 20}
        self.memory = Memory(self.options.memory, asked, len(devices), **how)
        workers = self.memory.workers
        if self.options.workers and workers < asked:
            room = f"{size_text(self.memory.total)} of memory have no room for more"
            self.say(f"{workers} of {asked} workers: {room}")
        return Pool(workers, self.options.backend, devices)

    def _run_logs(self, pool: Pool, writer: ResultWriter) -> None:
        given = self.config, self.options, self.observers, self.work
        context = RunContext(*given, self.memory, self.store, self.say)
        results = Results(self.work, self.summary, self.files, writer)
        whole = WholeLogs(pool, context, self.log_options, self._whole_tasks(pool))
        fetched = 0
        for number, files in enumerate(self.logs):
            if self.kept and files.name in self.kept.names:
                self.summary.logs += self.kept.take(files, writer)
                self.files |= self.kept.link_files(files, self.work.result / "kept")
                continue
            report = reporter(self.progress, number, len(self.logs))
            folder, options = self._folder(files), self.log_options
            tell = partial(report, LogSummary(files.name, ()), files.name, 0)
            by_worker = whole.wait_for(files.name, self.summary.batch_size, tell)
            given = context, pool, results, files, self._names[files.name]
            one = PooledLogRun(*given, report, number)
            try:
                found = [one.take(folder / "0", options)]
            except CamerasError as error:
                each = [replace(options, camera=camera) for camera in error.cameras]
                found = [one.take(folder / f"{i + 1}", each[i]) for i in range(len(each))]
            if any(about.error for about in found):
                self._check_there(files)
            if self.log_options.camera is None:
                for about in (about for about in found if about.description):
                    about.cameras_left_out = list(about.description.cameras_left_out)
            self.summary.logs += found
            if by_worker:
                report(found[0], files.name, found[0].frames, "")
            fetched += one.fetched
            if not (self.options.share or any(about.error for about in found)):
                self.work.write(folder / WHOLE, None)
        if self.options.share:
            if not any(about.error or about.lost for about in self.summary.logs):
                self.say(
                    f"share {self.options.share} is in {self.store}; without --share the command "
                    "joins them when all are there"
                )
        elif self.store:
            units = "1 unit was" if fetched == 1 else f"{fetched} units were"
            self.say(f"{units} in {self.store}")

    def _whole_tasks(self, pool: Pool) -> dict[str, Task]:
        """Logs that workers should do whole, the largest first."""
        if self.memory.workers == 1 or self.options.share or self.store:
            return {}
        tasks, sizes = {}, {}
        for number, files in enumerate(self.logs):
            folder = self._folder(files)
            if files.name not in self.summary.kept and not _is_whole(folder):
                known = inputs_of(self.work.record, files)
                sizes[files.name] = sum(was.get("size", 0) for _, was in known)
                file_name = self._names[files.name]
                tasks[files.name] = Task(files, file_name, number, folder / "0")
        few = sum(sizes.values()) < FEW_BYTES and not (self.options.workers or pool.devices)
        chosen = set() if few else choose_whole(sizes, self.memory.workers)
        largest_first = sorted(chosen, key=lambda name: -sizes[name])
        return {name: tasks[name] for name in largest_first}

    def _check_there(self, failed: "LogFiles") -> None:
        """Makes sure that the disk of a log that failed is still there.

        It is gone where others that are to be done are gone with the log. One that is gone alone
        was removed, and costs no other.

        Raises:
            InputError: It is gone; nothing that is done is lost.
        """
        others = [log for log in self._to_do if log is not failed]
        if self._gone(failed) and (not others or any(map(self._gone, others))):
            path, remedy = str(failed.paths[0]), "see that its disk is there"
            raise InputError("is not there any more", path=path, remedy=remedy)

    def _gone(self, log: "LogFiles") -> bool:
        """Whether a file of a log can't be read that could be when the run began."""
        known = inputs_of(self.work.record, log)
        return any("size" in was and "size" not in fingerprint(path) for path, was in known)
