"""The page: what the tables say as JSON, in a page that draws it without anything from outside."""

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jaxdet.config import Config
from jaxdet.presets import preset
from jaxdet.results.summary import plain

if TYPE_CHECKING:
    from jaxdet.results.reading import Results

REASONS = {
    "no_depth": "The depth image has no measurement in range.",
    "no_color": "The preset paper has no colour image near enough in time that can be decoded.",
    "decode_error": "The depth image could not be decoded.",
    "bad_calibration": "The images contradict the calibration of the log.",
    "worker_crashed": "The processes that worked on it died.",
    "timeout": "The processes that worked on it made no progress.",
}
"""What each :class:`jaxdet.errors.FrameStatus` means but ``ok``."""
SOURCES = {
    "frame": "its own depth",
    "window": "frames of its time window",
    "log": "frames of the log",
    "tf": "the log's TF",
    "flags": "the settings",
    "none": "nowhere",
}
"""What ``floor_source`` means."""
FIRST_DATE_S = 946684800
"""Stamps before the year 2000 count from somewhere else, and have no date."""


def page(title: str, data: Mapping[str, Any]) -> str:
    """The whole page.

    Only the script and the style that are in it may run, by their hashes, and nothing may be
    loaded: a name in a log that were not escaped could still do nothing.

    Args:
        title: Of the report.
        data: What the script draws, as JSON has it.
    """
    parts = files("jaxdet.export.html")
    style, script, text = (
        parts.joinpath(f"page.{end}").read_text("utf-8") for end in ("css", "js", "html")
    )
    values = {
        "STYLE_HASH": _hash(style),
        "SCRIPT_HASH": _hash(script),
        "STYLE": style,
        "SCRIPT": script,
        "TITLE": escape(title),
        "DATA": _in_script(data),
    }
    pieces = text.split("@")  # the page has no other @
    return "".join(values[p] if i % 2 else p for i, p in enumerate(pieces))


def _hash(text: str) -> str:
    return f"sha256-{b64encode(sha256(text.encode()).digest()).decode()}"


def _in_script(data: Mapping[str, Any]) -> str:
    """JSON that can't end the element it is in."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def changed_settings(config: Mapping[str, Any], method: Config) -> list[list[str]]:
    """The settings that differ from their preset: name, value, the preset's.

    Args:
        config: ``config.json``.
        method: The configuration in it.
    """
    standard = plain(preset(config.get("preset") or "wheeled"))
    found = []
    for section, values in plain(method).items():
        for name, value in values.items():
            if value != standard[section][name]:
                found.append([f"{section}.{name}", _said(value), _said(standard[section][name])])
    return found


def given_options(options: Any, standard: Any) -> list[list[str]]:
    """What the user said about the logs: name, value, the default."""
    pairs = zip(plain(options).items(), plain(standard).values(), strict=True)
    return [[f"log.{n}", _said(v), _said(d)] for (n, v), d in pairs if v != d]


def run_lines(results: "Results") -> list[list[str]]:
    """Return how the results were made: what and its value."""
    told = list(results.summaries.values())
    lines = [["jaxdet", results.version], ["backend", str(results.config.get("backend", ""))]]
    if told:
        for key in ("workers", "batch_size"):
            values = sorted({summary[key] for summary in told if key in summary})
            lines.append([key.replace("_", " "), ", ".join(map(str, values))])
        lines.append(["took", f"{sum(summary.get('seconds', 0.0) for summary in told):.1f} s"])
    versions = results.config_source.get("versions") or {}
    return lines + [[k, v] for k, v in versions.items() if v]


def about(version: str, frames: int, begins_s: Sequence[float]) -> str:
    """The line below the title."""
    dates = [datetime.fromtimestamp(s, UTC).date().isoformat() for s in begins_s if s]
    recorded = ""
    if dates:
        first, last = min(dates), max(dates)
        recorded = f", recorded {first}" + (f" to {last}" if last != first else "")
    return f"Obstacles of {frames:,} frames, found by jaxdet {version}{recorded}."


def _said(value: Any) -> str:
    return "–" if value is None else value if isinstance(value, str) else json.dumps(value)
