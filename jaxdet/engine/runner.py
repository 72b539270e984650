"""Runs over many logs, which write a folder of results for each log."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Literal, TypedDict, Unpack

from jaxdet.config import Config
from jaxdet.config_file import find_config
from jaxdet.engine.memory import Memory
from jaxdet.engine.options import RunOptions
from jaxdet.engine.plan import Observer
from jaxdet.engine.pool import Pool
from jaxdet.engine.process_log import no_report, process_log
from jaxdet.engine.progress import ProgressCallback
from jaxdet.engine.resources import Resources
from jaxdet.engine.scheduler import check_outside, make_summary, run_logs
from jaxdet.engine.settings import RunSettings, make_settings
from jaxdet.io import LogFiles, LogOptions, find_logs
from jaxdet.presets import DEFAULT_PRESET, PRESETS
from jaxdet.results.summary import Summary
from jaxdet.signals import stops_raised

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
    same call continues a run that was stopped. If a log fails, the others are still processed; the
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
        backend: See :class:`jaxdet.engine.RunOptions`, also for the arguments below.
        workers: Number of processes.
        memory: Maximum memory of all processes.
        options: ``batch_size``, ``pictures``, ``map``, ``overwrite`` and ``update``.

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
    with Runner(backend, workers, memory) as runner:
        return runner.run(logs, output, config, log=log, progress=progress, **options)


class Runner:
    """Worker processes and compiled programs that outlive a run; a context manager that ends them.

    >>> with jaxdet.Runner() as runner:                           # doctest: +SKIP
    ...     for name in arriving_logs():
    ...         runner.run(name, "results")

    Args:
        backend: See :class:`jaxdet.engine.RunOptions`, also for the other arguments.
        workers: Number of processes.
        memory: Maximum memory of all processes.

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
        Memory(memory, 1)  # too little memory is an error before any file is touched
        self._pool = Pool(backend)

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
        **options: Unpack[Hooks],
    ) -> Summary:
        """Process logs as :func:`jaxdet.run` does.

        Args:
            logs: See :func:`jaxdet.run`, also for the other arguments.
            output: Folder for the results.
            config: Configuration.
            log: Options of reading the logs.
            progress: Called after each unit and each log.
            options: Those of :func:`jaxdet.run`, ``observers`` (which get each batch of every log,
                and whose results are in the log's summary) and ``preset`` (name of the preset that
                the configuration started from, for ``config.json``).
        """
        found = _find(logs)
        how = {name: options[name] for name in How.__annotations__ if name in options}
        chosen = replace(self._options, output=Path(output), **how)
        check_outside(chosen.output, found)
        preset = options.get("preset")
        if preset is None and isinstance(config, str) and config in PRESETS:
            preset = config
        given = find_config(config), log or LogOptions(), chosen, preset, options.get("observers")
        return run_logs(make_settings(*given), found, self._pool, progress)

    def run_alone(self, settings: RunSettings, files: LogFiles, folder: Path) -> Summary:
        """Write the results of one log into a new folder outside of any results folder.

        Args:
            settings: Settings; their backend and number of workers are those of this runner.
            files: The log.
            folder: New folder for the results.
        """
        start = time.perf_counter()
        check_outside(folder, [files])
        resources = Resources(settings, self._pool)
        try:
            with stops_raised():
                given = resources.memory, resources.choose, no_report
                logs = process_log(settings, files, folder, *given)
        except BaseException:
            self.close()
            raise
        return make_summary(settings, resources, logs, start)


def _find(logs: Logs) -> list[LogFiles]:
    """Return the logs in order."""
    if isinstance(logs, Iterable) and not isinstance(logs, str):
        given = list(logs)
        if given and all(isinstance(log, LogFiles) for log in given):
            return sorted(given, key=lambda log: log.name)  # pyright: ignore
    return sorted(find_logs(logs), key=lambda log: log.name)  # pyright: ignore[reportArgumentType]
