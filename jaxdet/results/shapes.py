"""Structure of the JSON files of results, which is checked as files may have been edited."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError, printable

AGAIN = "run jaxdet run again, or name another folder"
COUNT, NUMBER, TEXT = "a count", "a number", "a line of text"
"""An integer from 0 on; a finite number; text without control characters."""
MAYBE = "maybe"
"""First item of a pair: the value is null, or has the shape in the second item."""
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
LOGS = {"logs": [LOG]}
SUMMARY = {"jaxdet": TEXT, "backend": TEXT, "seconds": NUMBER, "frames": COUNT, "obstacles": COUNT}
MANIFEST = {"files": {TEXT: {"size": COUNT, "sha256": TEXT}}, "log": TEXT, "inputs": [dict]}


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
        InputError: It has another shape.
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
