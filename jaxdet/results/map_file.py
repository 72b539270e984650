"""Occupancy grids of the world's floor, and their files for nav2's map_server.

A map is stored as a grey-level picture and a YAML file, by the rules of nav2: the occupancy of a
pixel is its darkness, or its brightness if ``negate`` is set; thresholds turn it into a state.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from jaxdet.elementary import sin_cos
from jaxdet.errors import InputError
from jaxdet.io.png import MAGIC, read_png_head
from jaxdet.results.occupancy import MAX_CELLS

OCCUPIED, FREE, UNKNOWN = 100, 0, -1
"""States of a cell, as in ``nav_msgs/OccupancyGrid``."""
OCCUPIED_GREY, FREE_GREY, UNKNOWN_GREY = 0, 254, 205
"""Grey levels, as written by nav2's map_saver."""
MODES = ("trinary", "scale", "raw")
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_TEXT_BYTES, _PICTURE_BYTES = 1 << 16, 1 << 29
_CELLS_M = (1e-3, 10.0)
_FARTHEST_M = 1e7
_YAML = """\
# Map of {log}, in the frame {frame}.
image: {image}
mode: trinary
resolution: {cell_m:.9g}
origin: [{x:.12g}, {y:.12g}, {yaw:.12g}]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
# Unknown cells, of grey level 205, have the occupancy 0.19608, just above free_thresh.


class Grid(NamedTuple):
    """Occupancy grid of the world's floor; row 0 is the lowest Y."""

    states: np.ndarray
    """States ``(rows, columns)`` int8: OCCUPIED, FREE or UNKNOWN."""
    origin: tuple[float, float]
    """World X and Y of the outer corner of cell (0, 0) [m]."""
    cell_m: float
    """Side of a cell [m]."""
    yaw: float = 0.0
    """Direction of the rows, counter-clockwise from the world's X [rad]."""

    def places(self, points: np.ndarray) -> np.ndarray:
        """Return fractional columns and rows of points ``(..., 2)`` in the world [m], float64."""
        sin, cos = sin_cos(self.yaw)
        x, y = points[..., 0] - self.origin[0], points[..., 1] - self.origin[1]
        return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1) / self.cell_m

    def world(self, places: np.ndarray) -> np.ndarray:
        """Return points in the world [m] from fractional columns and rows ``(..., 2)``."""
        sin, cos = sin_cos(self.yaw)
        x, y = places[..., 0] * self.cell_m, places[..., 1] * self.cell_m
        x, y = x * cos - y * sin + self.origin[0], x * sin + y * cos + self.origin[1]
        return np.stack([x, y], axis=-1)


def write_map(path: Path, grid: Grid, log: str, frame: str) -> None:
    """Write the picture ``path``, whose row 0 has the highest Y, and the YAML file next to it.

    Args:
        path: Picture, ``.pgm`` or ``.png``.
        grid: Map.
        log: Name of the log, for a comment.
        frame: Name of the world's frame.
    """
    greys = np.full(grid.states.shape, UNKNOWN_GREY, np.uint8)
    greys[grid.states == FREE] = FREE_GREY
    greys[grid.states == OCCUPIED] = OCCUPIED_GREY
    rows, columns = grid.states.shape
    if path.suffix == ".png":
        path.write_bytes(cv2.imencode(".png", greys[::-1])[1].tobytes())
    else:
        path.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + greys[::-1].tobytes())
    x, y = grid.origin
    log, frame = (" ".join(text.split()) for text in (log, frame))
    names = {"log": log, "frame": frame, "image": path.name}
    text = _YAML.format(**names, cell_m=grid.cell_m, x=x, y=y, yaw=grid.yaw)
    path.with_suffix(".yaml").write_text(text, encoding="utf-8")


def read_map(path: Path) -> Grid:
    """Read a map from its YAML file.

    Raises:
        InputError: The file or its picture is missing, damaged, too large or not a map.
    """
    about = _read_yaml(path)
    try:
        mode = about.get("mode", "trinary").lower()
        negate = {"0": False, "1": True, "false": False, "true": True}[about["negate"].lower()]
        numbers = [float(part) for part in about["origin"].strip("[]").split(",")]
        cell_m, occupied, free = (float(about[key]) for key in _NUMBERS)
    except (KeyError, ValueError) as error:
        raise _bad(path, f"has an invalid value ({error})") from error
    x, y, yaw = numbers if len(numbers) == 3 else (math.nan,) * 3
    rules = {
        f"mode {mode}": mode in MODES,
        "resolution": _CELLS_M[0] <= cell_m <= _CELLS_M[1],
        "origin": abs(x) <= _FARTHEST_M and abs(y) <= _FARTHEST_M and abs(yaw) <= 2 * math.pi,
        "occupied_thresh and free_thresh": 0 <= free <= occupied <= 1,
    }
    for name, kept in rules.items():
        if not kept:
            raise _bad(path, f"{name} is out of range")
    picture = path.parent / about["image"]
    occupancy, known = _read_picture(picture, mode == "raw")
    if mode != "raw":
        occupancy = occupancy if negate else 1 - occupancy
    states = np.where(occupancy > occupied, OCCUPIED, np.where(occupancy < free, FREE, UNKNOWN))
    states = np.where(known, states, UNKNOWN).astype(np.int8)[::-1]
    return Grid(np.ascontiguousarray(states), (x, y), cell_m, yaw)


_NUMBERS = ("resolution", "occupied_thresh", "free_thresh")


def _bad(path: Path, problem: str) -> InputError:
    remedy = "pass the YAML file of a map for nav2's map_server"
    return InputError(problem, path=str(path), remedy=remedy)


def _read_yaml(path: Path) -> dict[str, str]:
    """Read the keys of the file, which is a flat mapping; lists are returned as ``[a,b,c]``."""
    try:
        with path.open("rb") as file:
            data = file.read(_TEXT_BYTES + 1)
    except OSError as error:
        raise _bad(path, f"can't be read ({error.strerror})") from error
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _bad(path, "is not a YAML file") from error
    if len(data) > _TEXT_BYTES:
        raise _bad(path, f"has more than {_TEXT_BYTES:,} bytes")
    found: dict[str, str] = {}
    key = ""
    for line in text.splitlines():
        line = re.sub(r"(^|\s)#.*", "", line).strip()
        if match := re.fullmatch(r"(\w+)\s*:\s*(.*)", line):
            key, found[match[1]] = match[1], match[2].strip("'\"")
        elif key and line.startswith("- "):  # an item of a list, which follows its key
            found[key] += ("," if found[key] else "") + line[2:].strip()
    if missing := [key for key in _KEYS if not found.get(key)]:
        raise _bad(path, f"lacks {', '.join(missing)}")
    return found


def _read_picture(path: Path, raw: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the brightness of each pixel, 0 to 1, and whether it is opaque, ``(rows, columns)``.

    Args:
        path: PGM or PNG file.
        raw: Whether values are occupancies in percent; those above 100 are unknown.
    """
    remedy = "the map's YAML file names it as its image"
    try:
        if path.stat().st_size > _PICTURE_BYTES:
            raise InputError("is too large for a map", path=str(path), remedy=remedy)
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"can't be read ({reason})", path=str(path), remedy=remedy) from error
    size = _size(data)
    if size is None:
        remedy = "convert the map's picture to PGM or PNG"
        raise InputError("is not a PGM or PNG picture", path=str(path), remedy=remedy)
    if not 0 < size[0] * size[1] <= MAX_CELLS:
        problem = f"has {size[0]:,} x {size[1]:,} pixels"
        raise InputError(problem, path=str(path), remedy=f"use at most {MAX_CELLS:,} in all")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.shape[1::-1] != size:
        raise InputError("is damaged", path=str(path), remedy=remedy)
    top = 255 if image.dtype == np.uint8 else 65535
    image = image.reshape(*image.shape[:2], -1)
    colors, alpha = (image[..., :3], image[..., 3]) if image.shape[2] == 4 else (image, None)
    known = np.ones(image.shape[:2], bool) if alpha is None else alpha == top
    if raw:
        return colors[..., 0] / 100, known & (colors[..., 0] <= 100)
    return colors.sum(axis=2, dtype=np.int64) / (top * colors.shape[2]), known


def _size(data: bytes) -> tuple[int, int] | None:
    """Return width and height of a PGM or PNG picture; None if it is neither."""
    comment = rb"(?:\s|#[^\n]*\n)+"
    head = re.match(rb"P[25]" + comment + rb"(\d{1,9})" + comment + rb"(\d{1,9})\s", data[:4096])
    if head:
        return int(head[1]), int(head[2])
    if not data.startswith(MAGIC):
        return None
    try:
        return read_png_head(data)[:2]
    except ValueError:
        return None


class KnownPlaces:
    """Look-up of occupied and unknown cells of a map near given points.

    Args:
        grid: Map.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        rows, columns = grid.states.shape
        self._sums = np.zeros((rows + 1, columns + 1), np.int32)
        """Number of occupied cells below and left of each corner of the cell grid."""
        np.cumsum(grid.states == OCCUPIED, axis=0, dtype=np.int32, out=self._sums[1:, 1:])
        np.cumsum(self._sums, axis=1, out=self._sums)

    def near(self, points: np.ndarray, reach_m: np.ndarray) -> np.ndarray:
        """Return whether a square around each point contains an occupied cell.

        Args:
            points: World X and Y ``(P, 2)`` [m].
            reach_m: Half the side of each square, ``(P,)`` [m].

        Returns:
            ``(P,)`` bool; False if a point is NaN or far off the map.
        """
        rows, columns = self._grid.states.shape
        place = self._grid.places(points)
        reach = (reach_m / self._grid.cell_m)[:, None]
        bounds = [np.floor(place - reach), np.floor(place + reach) + 1]
        low, high = (
            np.nan_to_num(np.clip(b, 0, (columns, rows)), nan=0).astype(int) for b in bounds
        )
        (x0, y0), (x1, y1) = low.T, high.T
        sums = self._sums
        return sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0] > 0

    def is_unknown(self, points: np.ndarray) -> np.ndarray:
        """Return whether the cell of a point is unknown.

        Args:
            points: World X and Y ``(P, 2)`` [m].

        Returns:
            ``(P,)`` bool; False for points that are NaN or off the map.
        """
        rows, columns = self._grid.states.shape
        cell = np.floor(self._grid.places(points))
        inside = np.all((cell >= 0) & (cell < (columns, rows)), axis=1, keepdims=True)
        column, row = np.where(inside, cell, 0).astype(int).T
        return inside[:, 0] & (self._grid.states[row, column] == UNKNOWN)
