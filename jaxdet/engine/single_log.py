"""Processing of one log into one folder, for systems that distribute logs among machines."""

import atexit
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from jaxdet.config import Config
from jaxdet.config_changes import changed
from jaxdet.engine.options import RunOptions
from jaxdet.engine.runner import Runner
from jaxdet.engine.settings import RunSettings, make_settings
from jaxdet.errors import InputError
from jaxdet.io import LogOptions, find_logs
from jaxdet.pipeline import BackendName
from jaxdet.presets import DEFAULT_PRESET, preset


def run_one(log_path: str, folder: str | Path, how: Mapping[str, Any]) -> dict[str, Any]:
    """Find the obstacles of one log and write its results into a new folder.

    Worker processes and compiled programs stay for the next call in this process.

    Args:
        log_path: File of the log, or folder of the files of one recording.
        folder: New folder for the results; its parent exists. ``manifest.json`` is written last.
        how: Plain values, all optional: fields of :class:`jaxdet.engine.RunOptions`, ``name`` (of
            the log; by default from its path), ``preset``, ``config`` (sections of the
            configuration as in ``config.json``), ``log`` (fields of :class:`jaxdet.LogOptions`)
            and ``about`` (more entries of the manifest, for instance ``fetched``, the address of
            the log's files). Other keys are ignored.

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
    try:
        logs = find_logs([log_path])
        if len(logs) != 1:
            raise InputError(f"holds {len(logs)} logs, not one", path=log_path)
    except InputError as error:
        found = {"name": how.get("name") or log_path, "frames": 0, "obstacles": 0, "seconds": 0.0}
        return {"status": "failed", **found, "warnings": [], "lost": [], "error": str(error)}
    given = logs[0]._replace(name=how.get("name") or logs[0].name)
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
    runner = Runner(backend=backend)
    atexit.register(runner.close)
    return runner
