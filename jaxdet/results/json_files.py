"""Functions that write and read the JSON files of results.

The structure of a file is checked when it is read, as it may have been edited.
"""

import dataclasses
import json
import math
import os
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from jaxdet.errors import InputError, printable
from jaxdet.results.durable import writing

AGAIN = "run jaxdet run again, or name another folder"
COUNT, NUMBER, TEXT = "a count", "a number", "a line of text"
"""Shapes of values: an integer from 0 on; a finite number; text without control characters."""
MAYBE = "maybe"
"""First item of a pair; the value is null, or has the shape that is the second item."""
_LONGEST = 1 << 20

COUNTS = {TEXT: COUNT}
CAMERA = {
    "width": COUNT, "height": COUNT, "fx": NUMBER, "fy": NUMBER, "cx": NUMBER, "cy": NUMBER,
    "distortion": TEXT, "coefficients": [NUMBER],
}  # fmt: skip
CALIBRATION = {
    "depth": CAMERA,
    "color": (MAYBE, CAMERA),
    "color_from_depth": (MAYBE, {"rotation": [NUMBER], "translation": [NUMBER]}),
    "depth_unit": NUMBER,
}
DESCRIPTION = {
    "topics": [{"topic": TEXT, "chosen_as": TEXT}],
    "pose_source": TEXT,
    "is_folder": bool,
}
LOG = {
    "log": TEXT, "camera": (MAYBE, TEXT), "file_name": (MAYBE, TEXT), "paths": [TEXT],
    "error": (MAYBE, TEXT), "lost": [TEXT], "frames": COUNT, "obstacles": COUNT,
    "overflow_frames": COUNT, "tilted_frames": COUNT, "short_rectangles": COUNT,
    "status": COUNTS, "floor_sources": COUNTS, "floor_refused": COUNTS,
    "busy_s": {TEXT: NUMBER}, "workers": COUNT, "devices": COUNT,
    "seconds": NUMBER, "first_batch_s": NUMBER, "frames_per_s": (MAYBE, NUMBER),
    "map": (MAYBE, TEXT), "pictures": [TEXT], "warnings": [TEXT], "notes": [TEXT],
    "frame_errors": [TEXT], "cameras_left_out": [TEXT], "calibration": (MAYBE, CALIBRATION),
    "description": (MAYBE, DESCRIPTION),
}  # fmt: skip
"""Entry of a log's camera in ``summary.json`` and ``failed.json``."""
SUMMARY_SHAPE = {
    "jaxdet": TEXT, "backend": TEXT, "seconds": NUMBER, "frames": COUNT, "obstacles": COUNT
}  # fmt: skip


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a mapping as JSON.

    Raises:
        OutputError: The disk is full, or the folder can't be written to.
    """
    with writing(path):
        path.write_text(to_json(value), encoding="utf-8")


def to_json(value: Mapping[str, Any]) -> str:
    """Return a mapping as JSON with a final newline; paths and enums become strings.

    A value that doesn't fit into a line has a line for each of its parts, indented by two spaces.
    """
    return _json_text(value, "") + "\n"


_LINE = 100
_ENCODER = json.JSONEncoder(ensure_ascii=False, default=str, allow_nan=False)


def _json_text(value: Any, indent: str) -> str:
    line = _ENCODER.encode(value)
    if len(indent) + len(line) <= _LINE or not isinstance(value, Mapping | list | tuple):
        return line
    deeper = indent + "  "
    if isinstance(value, Mapping):
        ends = "{}"
        parts = [f"{_ENCODER.encode(k)}: {_json_text(v, deeper)}" for k, v in value.items()]
    else:
        ends, parts = "[]", [_json_text(part, deeper) for part in value]
    rows = ",\n".join(deeper + part for part in parts)
    return f"{ends[0]}\n{rows}\n{indent}{ends[1]}"


def plain(value: Any) -> Any:
    """Return a value for JSON: dataclasses and named tuples become mappings, NaN becomes null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        pairs = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        return {k: plain(v) for k, v in pairs.items() if not k.startswith("_")}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {k: plain(v) for k, v in value._asdict().items()}  # pyright: ignore
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return printable(str(value)) if isinstance(value, Enum | Path | str) else value


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file of results.

    Raises:
        InputError: The file is missing, can't be read, or holds no JSON object.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        problem = f"has no complete results ({path.name} is missing)"
        raise InputError(problem, path=str(path.parent), remedy=AGAIN) from error
    except OSError as error:
        raise unread(path, error) from error
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON", path=str(path), remedy=AGAIN) from error
    if not isinstance(found, dict):
        raise InputError("is not a JSON object", path=str(path), remedy=AGAIN)
    return found


def unread(path: Path, error: OSError) -> InputError:
    """Return the error for a file that the system can't read."""
    problem = f"can't be read ({os.strerror(error.errno or 0)})"
    return InputError(problem, path=str(path), remedy="check its permissions and its disk")


def leads_out(name: str) -> bool:
    """Return whether the name of a results file points outside of its folder."""
    return Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name


def entries_of(content: Mapping[str, Any], where: Path) -> list[dict[str, Any]]:
    """Return the entries of a log's cameras in ``summary.json`` or ``failed.json``.

    Raises:
        InputError: The entries don't have the shape that jaxdet writes.
    """
    check_shape(content, {"logs": [LOG]}, where)
    logs: list[dict[str, Any]] = content["logs"]
    for entry in logs:
        names = [entry["file_name"] or "", entry["map"] or "", *entry["pictures"]]
        if not (entry["error"] or entry["camera"]) or any(map(leads_out, names)):
            raise InputError("is not as jaxdet writes it", path=str(where), remedy=AGAIN)
    return logs


def check_shape(value: Any, shape: Any, path: Path, where: str = "") -> None:
    """Check a value of a JSON file.

    Args:
        value: The value.
        shape: A type; one of :data:`COUNT`, :data:`NUMBER`, :data:`TEXT`; a pair with
            :data:`MAYBE`; a list with the shape of its items; a mapping with the shape of each
            key, or with :data:`TEXT` as the only key, for any keys. Other keys are not checked.
        path: The file.
        where: Field of the value, for the error.

    Raises:
        InputError: The value has another shape.
    """
    if isinstance(shape, tuple):
        if value is not None:
            check_shape(value, shape[1], path, where)
    elif isinstance(shape, list):
        _require(isinstance(value, list), "a list", value, path, where)
        for number, item in enumerate(value):
            check_shape(item, shape[0], path, f"{where}[{number}]")
    elif isinstance(shape, Mapping):
        _require(isinstance(value, dict), "an object", value, path, where)
        some = dict.fromkeys(value, shape[TEXT]) if TEXT in shape else shape
        for name, inner in some.items():
            at = f"{where}.{name}" if where else name
            check_shape(name, TEXT, path, where)
            _require(name in value, "there", None, path, at)
            check_shape(value[name], inner, path, at)
    elif shape is COUNT:
        good = isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 62
        _require(good, COUNT, value, path, where)
    elif shape is NUMBER:
        good = isinstance(value, int | float) and not isinstance(value, bool)
        good = good and math.isfinite(value if abs(value) < 1e300 else math.inf)
        _require(good, NUMBER, value, path, where)
    elif shape is TEXT:
        good = isinstance(value, str) and len(value) < _LONGEST and value.isprintable()
        _require(good, TEXT, value, path, where)
    else:
        _require(isinstance(value, shape), shape.__name__, value, path, where)


def _require(good: bool, wanted: str, value: Any, path: Path, where: str) -> None:
    if not good:
        found = type(value).__name__ if value is not None else "missing or null"
        problem = f"{printable(where)[:200]} must be {wanted}, but is {found}"
        raise InputError(problem, path=str(path), remedy=AGAIN)
