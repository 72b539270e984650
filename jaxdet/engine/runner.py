"""Runs over many logs, or one, which write a folder of results for each log."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

from jaxdet.arguments import named_type, of_type
from jaxdet.config import Config
from jaxdet.config_changes import changed
from jaxdet.config_file import find_config
from jaxdet.engine.executors import first_process
from jaxdet.engine.placement import Machine
from jaxdet.engine.pool import Pool
from jaxdet.engine.process_log import process_log
from jaxdet.engine.scheduler import make_summary, run_logs
from jaxdet.engine.settings import (
    Observer,
    ProgressCallback,
    RunOptions,
    RunSettings,
    make_settings,
)
from jaxdet.errors import ConfigError, InputError
from jaxdet.io import LogFiles, LogOptions, find_logs
from jaxdet.pipeline import BackendName
from jaxdet.presets import DEFAULT_PRESET, PRESETS, preset
from jaxdet.results.summary import Summary
from jaxdet.signals import stops_raised

Logs = str | PathLike[str] | Sequence[str | PathLike[str]] | Sequence[LogFiles]


def run(
    logs: Logs,
    output: str | PathLike[str],
    config: Config | str | PathLike[str] = DEFAULT_PRESET,
    *,
    log: LogOptions | None = None,
    progress: ProgressCallback | None = None,
    **options: Any,
) -> Summary:
    """Find the obstacles in every frame of logs and write a folder of results for each.

    Logs that are done already, with this configuration and version, are skipped, so the same call
    continues a run that was stopped. If a log fails, the other logs are still processed; the
    summary lists it, and its folder holds ``failed.json`` in place of results.

    >>> summary = jaxdet.run("bags/", "results", "d435")          # doctest: +SKIP
    >>> [(log.log, log.error) for log in summary.failed]          # doctest: +SKIP
    []

    Args:
        logs: Files, folders and globs, as for :func:`jaxdet.find_logs`, or the logs it returned.
        output: Folder for the results: ``output/<log>/``, see ``jaxdet help runs``.
        config: Configuration, name of a preset, or file.
        log: Options of reading the logs; by default those of ``jaxdet run``.
        progress: Called after each unit of frames and each log.
        options: Fields of :class:`jaxdet.engine.RunOptions`, for instance ``workers=4``.

    Returns:
        Counts and the summary of every log.

    Raises:
        ConfigError: The output folder holds results of another configuration or version or of a
            log that has changed; another run works there; or an argument is wrong.
        InputError: There are no logs, or the output folder can't be written to.
        OutputError: The disk is full or broken; logs that are done are kept.
        WorkerStartError: Worker processes can't be started.
        Interrupted: A signal, for instance Ctrl-C, ended the run; logs that are done are kept.
    """
    with Runner(**options) as runner:
        return runner.run(logs, output, config, log=log, progress=progress)


class Runner:
    """Worker processes and compiled programs that outlive a run; a context manager that ends them.

    >>> with jaxdet.Runner() as runner:                           # doctest: +SKIP
    ...     for name in arriving_logs():
    ...         runner.run(name, "results")

    Args:
        options: Fields of :class:`jaxdet.engine.RunOptions`, the defaults of its runs.

    Raises:
        ConfigError: An option is wrong.
    """

    def __init__(self, **options: Any) -> None:
        self._options = RunOptions(**options)
        self._pool = Pool(self._options.backend)

    def __enter__(self) -> "Runner":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes."""
        self._pool.close()

    def run(
        self,
        logs: Logs,
        output: str | PathLike[str],
        config: Config | str | PathLike[str] = DEFAULT_PRESET,
        *,
        log: LogOptions | None = None,
        progress: ProgressCallback | None = None,
        observers: Mapping[str, Observer] = MappingProxyType({}),
        preset: str | None = None,
        **options: Any,
    ) -> Summary:
        """Process logs as :func:`jaxdet.run` does.

        Args:
            logs: See :func:`jaxdet.run`, also for the other arguments.
            output: Folder for the results.
            config: Configuration.
            log: Options of reading the logs.
            progress: Called after each unit and each log.
            observers: Called with each batch of a log; their results are in the log's summary.
            preset: Name of the preset that the configuration started from, for ``config.json``.
            options: Options that differ from those of the runner; ``backend`` must not differ.

        Raises:
            ConfigError: See :func:`jaxdet.run`; or the backend differs.
        """
        chosen = replace(self._options, **options)
        if chosen.backend != self._options.backend:
            problem = f"this Runner computes with {self._options.backend}, not {chosen.backend}"
            raise ConfigError(problem, remedy=f'make another: Runner(backend="{chosen.backend}")')
        found, folder = _find(logs), _folder(output)
        log = of_type("log", LogOptions() if log is None else log, LogOptions, ConfigError)
        _check_outside(folder, found)
        if preset is None and isinstance(config, str) and config in PRESETS:
            preset = config
        given = find_config(config), log, chosen, preset, observers
        return run_logs(make_settings(*given), found, folder, self._pool, progress)

    def run_alone(self, settings: RunSettings, files: LogFiles, folder: Path) -> Summary:
        """Write the results of one log into a new folder outside of any results folder.

        Args:
            settings: Settings, with the backend of this runner.
            files: The log.
            folder: New folder for the results.
        """
        start = time.perf_counter()
        _check_outside(folder, [files])
        machine = Machine(settings, self._pool)
        try:
            with stops_raised():
                logs = process_log(settings, files, folder, first_process(machine))
        except BaseException:
            self.close()
            raise
        return make_summary(settings, machine, logs, start)


def _find(logs: Logs) -> list[LogFiles]:
    """Return the logs in order.

    Raises:
        InputError: There are none.
    """
    given: Any = logs
    if isinstance(logs, Iterable) and not isinstance(logs, str):
        given = list(logs)
        if not given:
            raise InputError("no logs are named", topic="logs", remedy="pass at least one")
    if not (isinstance(given, list) and all(isinstance(log, LogFiles) for log in given)):
        given = find_logs(given)
    return sorted(given, key=lambda log: log.name)


def _folder(output: Any) -> Path:
    """Return the path of the results.

    Raises:
        ConfigError: It is not the path of a folder.
    """
    if not isinstance(output, str | PathLike) or not str(output):
        problem, remedy = f"expected a path, got {named_type(output)}", "pass that of a folder"
        raise ConfigError(problem, topic="output", remedy=remedy)
    if "://" in str(output):
        problem, remedy = "is not a folder", "write to addresses with the command jaxdet run"
        raise ConfigError(problem, path=str(output), remedy=remedy)
    return Path(output)


def _check_outside(output: Path, logs: Sequence[LogFiles]) -> None:
    """Check that results are not written into a log that is a folder.

    Raises:
        ConfigError: The output folder is in the folder of a log.
    """
    place = output.resolve()
    for folder in (path for log in logs for path in log.paths if path.is_dir()):
        if place.is_relative_to(folder.resolve()):
            problem, remedy = f"is in the log {folder}", "pass an --output next to it"
            raise ConfigError(problem, path=str(output), remedy=remedy)


def run_one(
    log_path: str | Sequence[str], folder: str | Path, how: Mapping[str, Any]
) -> dict[str, Any]:
    """Find the obstacles of one log and write its results into a new folder.

    Worker processes and compiled programs stay for the next call in this process.

    Args:
        log_path: File of the log, all files of one recording, or the folder that has them.
        folder: New folder for the results; its parent exists. ``manifest.json`` is written last.
        how: Plain values, all optional: fields of :class:`jaxdet.engine.RunOptions`, ``name`` (the
            log's name; by default from its path), ``preset``, ``config`` (sections of the
            configuration as in ``config.json``), ``log`` (fields of :class:`jaxdet.LogOptions`),
            ``about`` (more entries of the manifest, for instance ``fetched``, the address of the
            log's files) and ``remarks`` (the fields ``note`` and ``about`` of
            :class:`jaxdet.io.LogFiles`). Other keys are ignored.

    Returns:
        ``status`` (``done`` or ``failed``), ``name``, ``frames``, ``obstacles``, ``seconds``,
        ``warnings``, ``lost`` (ranges of frames without results) and ``error``. The folder of a
        log that failed holds ``failed.json`` in place of results.

    Raises:
        ConfigError: A value in ``how`` is wrong.
        OutputError: The disk is full or broken.
        Interrupted: A signal ended the run.
    """
    settings = _settings(how)
    runner = _runner(settings.options.backend)
    paths = [log_path] if isinstance(log_path, str) else log_path
    try:
        logs = find_logs(paths)
        if len(logs) != 1:
            raise InputError(f"holds {len(logs)} logs, not one", path=paths[0])
    except InputError as error:
        found = {"name": how.get("name") or paths[0], "frames": 0, "obstacles": 0, "seconds": 0.0}
        return {"status": "failed", **found, "warnings": [], "lost": [], "error": str(error)}
    name = how.get("name") or logs[0].name
    given = logs[0]._replace(**{**(how.get("remarks") or {}), "name": name})
    summary = runner.run_alone(settings, given, Path(folder))
    errors = "; ".join(log.error for log in summary.failed if log.error)
    return {
        "status": "done" if summary.whole else "failed",
        "name": given.name,
        "frames": summary.frames,
        "obstacles": summary.obstacles,
        "seconds": round(summary.seconds, 3),
        "warnings": [warning for log in summary.logs for warning in log.warnings],
        "lost": [lost for log in summary.logs for lost in log.lost],
        "error": errors or None,
    }


def record_of(how: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the content of ``run.json`` for logs that :func:`run_one` processes with ``how``."""
    return _settings(how).record


def _settings(how: Mapping[str, Any]) -> RunSettings:
    name = how.get("preset") or DEFAULT_PRESET
    config = preset(name)
    sections = {
        key: changed(getattr(config, key), values, key, "how")
        for key, values in (how.get("config") or {}).items()
    }
    log_options = changed(LogOptions(), how.get("log") or {}, "log", "how")
    names = [field.name for field in fields(RunOptions)]
    options = RunOptions(**{name: how[name] for name in names if how.get(name) is not None})
    config = Config(**{**vars(config), **sections})
    return make_settings(config, log_options, options, name, about=how.get("about") or {})


@cache
def _runner(backend: BackendName) -> Runner:
    """Return the runner of this process for a backend."""
    return Runner(backend=backend)
