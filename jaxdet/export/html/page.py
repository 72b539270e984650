"""HTML page with the data as JSON, and a script that draws it without external resources."""

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from jaxdet.config import Config
from jaxdet.errors import InputError
from jaxdet.presets import preset
from jaxdet.results.json_files import AGAIN, plain

if TYPE_CHECKING:
    from jaxdet.results.reading import Results

REASONS = {
    "no_depth": "The depth image has no measurement in range.",
    "no_color": "The preset paper has no colour image near enough in time that can be decoded.",
    "decode_error": "The depth image could not be decoded.",
    "bad_calibration": "The images contradict the calibration of the log.",
    "worker_crashed": "The processes that worked on the frame died.",
    "timeout": "The processes that worked on the frame made no progress.",
}
"""Meaning of each :class:`jaxdet.errors.FrameStatus` except ``ok``."""
SOURCES = {
    "frame": "its own depth",
    "window": "frames of its time window",
    "log": "frames of the log",
    "tf": "the log's TF",
    "flags": "the settings",
    "none": "nowhere",
}
"""Source of a frame's floor in words, by value of the column ``floor_source``."""
FIRST_DATE_S = 946684800
"""Start of the year 2000 [s]; earlier timestamps are not taken as UNIX times and have no date."""
_LONGEST = 120
"""Maximum number of characters that are shown of a setting's value."""


def page(title: str, data: Mapping[str, Any]) -> str:
    """Return the HTML page.

    Its content security policy allows only the embedded script and style, by their hashes, and no
    loading, so that even an unescaped name of a log would be harmless.

    Args:
        title: Title of the report.
        data: Data for the script, as JSON values.
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
    """Encode JSON so that it can't end its script element.

    Raises:
        InputError: A number is not finite, although the columns used here never contain such ones.
    """
    try:
        text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except ValueError as error:
        problem = "a number of the results is not finite"
        raise InputError(problem, remedy=AGAIN) from error
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def changed_settings(config: Mapping[str, Any], method: Config) -> list[list[str]]:
    """Return the settings that differ from their preset: name, value, the preset's value.

    Args:
        config: Contents of ``config.json``.
        method: Configuration in it.
    """
    standard = plain(preset(config.get("preset") or "wheeled"))
    changes = []
    for section, values in plain(method).items():
        for name, value in values.items():
            if value != standard[section][name]:
                changes.append(
                    [f"{section}.{name}", _value_text(value), _value_text(standard[section][name])]
                )
    return changes


def given_options(options: Any, standard: Any) -> list[list[str]]:
    """Return the log options that differ from the defaults: name, value, default."""
    pairs = zip(plain(options).items(), plain(standard).values(), strict=True)
    return [[f"log.{n}", _value_text(v), _value_text(d)] for (n, v), d in pairs if v != d]


def run_lines(results: "Results") -> list[list[str]]:
    """Return pairs of name and value that describe how the results were made."""
    summaries = list(results.summaries.values())
    lines = [["jaxdet", results.version], ["backend", str(results.config.get("backend", ""))]]
    if summaries:
        for key in ("workers", "batch_size"):
            values = sorted({summary[key] for summary in summaries if key in summary})
            lines.append([key.replace("_", " "), ", ".join(map(str, values))])
        lines.append(["took", f"{sum(summary.get('seconds', 0.0) for summary in summaries):.1f} s"])
    versions = results.config_source.get("versions") or {}
    return lines + [[k, v] for k, v in versions.items() if v]


def about(version: str, frames: int, begins_s: Sequence[float]) -> str:
    """Return the line of text below the page's title."""
    dates = [datetime.fromtimestamp(s, UTC).date().isoformat() for s in begins_s if s]
    recorded = ""
    if dates:
        first, last = min(dates), max(dates)
        recorded = f", recorded {first}" + (f" to {last}" if last != first else "")
    return f"Obstacles of {frames:,} frames, found by jaxdet {version}{recorded}."


def _value_text(value: Any) -> str:
    text = "–" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"  # a mask has many numbers
