"""Labelled boxes from a JSON file: COCO, or a plain list."""

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxdet.errors import InputError, JaxdetError
from jaxdet.eval.boxes import BoxLabels

_LIST = '[{"frame": 12, "box": [u_min, v_min, u_max, v_max]}, ...]'
_REMEDY = f"pass a COCO file, or a list {_LIST}"


class _Row(NamedTuple):
    """A labelled box, or an ignored region."""

    box: list[float] | None
    distance_m: float
    ignored: bool


def read_labels(path: Path) -> dict[tuple[str, int], BoxLabels]:
    """Read the labelled boxes of images.

    In COCO files, an image belongs to the frame of its key ``frame``, else to the depth image of
    its key ``stamp_ns`` (``jaxdet export --to coco`` writes both), else to the frame whose number
    is at the end of its ``file_name``. Boxes with ``iscrowd`` are ignored regions, and an image
    without boxes has no obstacles. A plain list has objects with ``frame`` (or ``stamp_ns``, or
    ``image``, a file name as above), ``box`` as in the obstacle table, and optionally
    ``distance_m`` and ``ignore``; without ``box`` the frame has no obstacles.

    Returns:
        Labels by ``("frame", number)`` or ``("stamp_ns", timestamp)``.

    Raises:
        InputError: The file can't be read, or an entry is invalid.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"labels can't be read ({error.strerror})", path=str(path)) from error
    except (ValueError, RecursionError) as error:
        problem = f"invalid JSON ({error})"
        raise InputError(problem, path=str(path), remedy=_REMEDY) from error
    try:
        return _of_coco(data) if isinstance(data, dict) else _of_list(data)
    except (KeyError, TypeError, ValueError) as error:
        missing = isinstance(error, KeyError)
        problem = f"key {error} is missing" if missing else f"not a list of labels ({error})"
        raise InputError(problem, path=str(path), remedy=_REMEDY) from error
    except JaxdetError as error:
        raise InputError(error.problem, path=str(path), remedy=error.remedy) from error


def _of_coco(data: Mapping[str, Any]) -> dict[tuple[str, int], BoxLabels]:
    images, rows, sizes = {}, {}, {}
    for n, image in enumerate(data["images"]):
        images[image["id"]] = key = _key(image, "file_name", f"image {n}")
        rows[key] = []
        if "width" in image and "height" in image:
            sizes[key] = int(image["width"]), int(image["height"])
    for n, label in enumerate(data["annotations"]):
        where = f"annotation {n}"
        if label["image_id"] not in images:
            raise InputError(f"{where}: unknown image {label['image_id']!r}")
        u, v, width, height = _numbers(label["bbox"], f"{where}: bbox")
        box = _box([u, v, u + width - 1, v + height - 1], f"{where}: bbox")
        row = _Row(box, _distance(label, where), bool(label.get("iscrowd")))
        rows[images[label["image_id"]]].append(row)
    return {key: _labels(own, sizes.get(key)) for key, own in rows.items()}


def _of_list(data: list[Mapping[str, Any]]) -> dict[tuple[str, int], BoxLabels]:
    rows: dict[tuple[str, int], list[_Row]] = {}
    for n, label in enumerate(data):
        where = f"label {n}"
        own = rows.setdefault(_key(label, "image", where), [])
        if label.get("box") is not None:
            box = _box(_numbers(label["box"], f"{where}: box"), f"{where}: box")
            own.append(_Row(box, _distance(label, where), bool(label.get("ignore"))))
    return {key: _labels(own, None) for key, own in rows.items()}


def _key(entry: Mapping[str, Any], name: str, where: str) -> tuple[str, int]:
    """Return the frame to which an entry belongs, as a key of :func:`read_labels`."""
    for key in ("frame", "stamp_ns"):
        if key in entry:
            return key, int(entry[key])
    number = re.search(r"(\d+)(?:\.\w+)?$", str(entry.get(name, "")))
    if number is None:
        remedy = 'add the key "frame" with the number'
        raise InputError(f"{where}: the frame number is missing", remedy=remedy)
    return "frame", int(number[1])


def _numbers(values: Any, where: str) -> list[float]:
    good = isinstance(values, list) and len(values) == 4
    if not good or not all(isinstance(v, int | float) and math.isfinite(v) for v in values):
        raise InputError(f"{where} must be 4 numbers, got {json.dumps(values)[:80]}")
    return values


def _box(box: list[float], where: str) -> list[float]:
    if box[2] < box[0] or box[3] < box[1]:
        problem = f"{where} has a maximum below its minimum"
        raise InputError(problem, remedy="use u_min v_min u_max v_max, or COCO")
    return box


def _distance(label: Mapping[str, Any], where: str) -> float:
    distance = label.get("distance_m")
    if distance is None:
        return math.nan
    if not isinstance(distance, int | float) or not 0 <= distance < math.inf:
        raise InputError(f"{where}: distance_m must be metres, got {json.dumps(distance)[:80]}")
    return float(distance)


def _labels(rows: list[_Row], size: tuple[int, int] | None) -> BoxLabels:
    boxes, ignored = (
        np.array([r.box for r in rows if r.ignored == ignore], np.float64).reshape(-1, 4)
        for ignore in (False, True)
    )
    distance_m = np.array([r.distance_m for r in rows if not r.ignored], np.float64)
    return BoxLabels(boxes, distance_m, ignored, size)
