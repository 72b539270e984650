"""One log into one folder: what other engines than this machine's call."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxdet.config import Config
from jaxdet.config_file import changed
from jaxdet.engine.local import run
from jaxdet.engine.options import RunOptions
from jaxdet.errors import InputError
from jaxdet.io import LogOptions, find_logs
from jaxdet.presets import DEFAULT_PRESET, preset

OPTIONS = ("backend", "workers", "memory", "batch_size", "pictures")
"""Keys of ``how`` that are fields of :class:`RunOptions`."""


def run_one(log_path: str, folder: str | Path, how: Mapping[str, Any]) -> dict[str, Any]:
    """Find the obstacles of one log and write its results into a new folder.

    Args:
        log_path: File of the log, or folder of the files of one recording.
        folder: New folder for the results; its parent exists. ``manifest.json`` arrives last.
        how: Plain values, all optional: ``name`` (of the log; by default from its path),
            ``preset``, ``config`` (sections of the configuration as in ``config.json``), ``log``
            (:class:`jaxdet.LogOptions`), ``backend``, ``workers``, ``memory``, ``batch_size`` and
            ``pictures`` (:class:`RunOptions`).

    Returns:
        ``status`` (``done`` or ``failed``), ``name``, ``frames``, ``obstacles``, ``seconds``,
        ``warnings``, ``lost`` (ranges of frames without results) and ``error``. A log that failed
        leaves no folder.

    Raises:
        ConfigError: Something in ``how`` is wrong.
        OutputError: The disk is full or broken.
        Interrupted: A signal ended it.
    """
    name = how.get("preset") or DEFAULT_PRESET
    config = preset(name)
    sections = {
        key: changed(getattr(config, key), values, key, "how")
        for key, values in (how.get("config") or {}).items()
    }
    config = Config(**{**vars(config), **sections})
    log_options = changed(LogOptions(), how.get("log") or {}, "log", "how")
    options = RunOptions(Path(folder), **{key: how[key] for key in OPTIONS if key in how})
    try:
        logs = find_logs([log_path])
        if len(logs) != 1:
            raise InputError(f"holds {len(logs)} logs, not one", path=log_path)
        given = logs[0]._replace(name=how.get("name") or logs[0].name)
        summary = run([given], config, log_options, options, preset=name)
    except InputError as error:
        return _outcome(how.get("name") or Path(log_path).stem, error=str(error))
    errors = "; ".join(log.error for log in summary.failed if log.error)
    return _outcome(
        given.name,
        frames=summary.frames,
        obstacles=summary.obstacles,
        seconds=round(summary.seconds, 3),
        warnings=[warning for log in summary.logs for warning in log.warnings],
        lost=[lost for log in summary.logs for lost in log.lost],
        error=errors or None,
    )


def _outcome(name: str, **values: Any) -> dict[str, Any]:
    nothing = {"frames": 0, "obstacles": 0, "seconds": 0.0, "warnings": [], "lost": []}
    found = {"name": name, **nothing, "error": None, **values}
    return {"status": "failed" if found["error"] else "done", **found}
