"""``python -m benchmarks same OLD NEW``: compare the obstacles of two commits on the same logs.

Rows of ``OLD`` belong to colour images and their lengths refer to the colour camera; those of
``NEW`` belong to depth images and refer to the depth camera. Frames are matched by the timestamp of
the depth image. If depth is aligned to colour, both cameras are the same and all columns must be
equal. Otherwise the old obstacles are transformed to the depth camera with the extrinsics of the
log and matched one to one with the new ones, nearest first. Compared are distance, lowest and
highest point, contour and rectangle, which both commits compute from all cells of an obstacle;
differences beyond a tolerance are counted by reason. Boxes and centroids are not compared, because
the old ones cover only the cells in the colour image.
"""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pyarrow.parquet as pq
import tyro

from jaxdet.floor.plane import down_vector, forward_vector

EXACT = (
    *("distance_m", "bottom_m", "top_m", "contour", "corners_ground"),
    *("u_min", "u_max", "v_min", "v_max"),
    *("x_min", "x_max", "y_min", "y_max", "z_min", "z_max"),
)
"""Columns that must be equal if depth is aligned to colour."""
PAIRED_M = 0.05
"""Maximum distance between the contours of matched obstacles [m]."""
EDGE_PX = 12
"""Maximum distance of a cut box from the edge of the colour image: one or two depth cells
[pixel]."""
LEAST_M = 0.08
"""Obstacles with a smaller width and height are close to the minimum size of 5 cm [m]."""
FLOOR_M, FLOOR_RAD = 0.005, 0.005
"""Maximum differences in height and angle of floors that count as equal [m, rad]."""
OUTSIDE = "outside of the colour image"
CUT = "cut by the edge of the colour image"
FLOOR = "another floor was found"
LEVEL = "no floor is known, and the depth camera is taken as level"
JOINED = "cells are joined otherwise"
SMALL = "near the least size"
OTHER = "none of these"
FEW = 0.1
"""Up to this fraction of the points of a contour, or two points, count as single cells."""
RECTANGLE = "the rectangle alone"
CELLS = "single cells of the contour"


@dataclass(frozen=True)
class Options:
    """Compare the obstacles of two results folders, log by log."""

    old: tyro.conf.Positional[Path]
    """Results of the earlier commit."""
    new: tyro.conf.Positional[Path]
    """Results of the later commit, on the same logs."""
    tolerance_m: float = 0.03
    """Maximum difference of the lengths of equal obstacles [m]."""
    boxes: bool = True
    """Whether boxes in the image must be equal too, if depth is aligned to colour."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """File for the counts and all differences."""


class Frame(NamedTuple):
    """A row of ``frames`` with its rows of ``obstacles``."""

    row: dict[str, Any]
    obstacles: list[dict[str, Any]]


class LogResult(NamedTuple):
    """Results of a log."""

    frames: dict[int, Frame]
    """Frames by the timestamp of the depth image [ns]."""
    calibration: dict[str, Any]
    """Calibration in the summary."""


class Difference(NamedTuple):
    """An obstacle that differs between the results."""

    stamp_ns: int
    side: str
    """``old`` or ``new`` if it exists only there, ``both`` if it changed."""
    reason: str
    text: str


class Comparison(NamedTuple):
    """Comparison of the obstacles of a log."""

    aligned: bool
    frames: int
    """Number of frames in both results."""
    only_old: int
    """Number of frames only in the old results."""
    only_new: int
    """Number of frames only in the new results."""
    old: int
    """Number of old obstacles in the frames of both results."""
    new: int
    same: int
    """Number of obstacles that are equal, or equal within the tolerance."""
    differences: tuple[Difference, ...]

    @property
    def reasons(self) -> Counter[str]:
        """Number of obstacles that differ, by result (old, new, both) and reason."""
        return Counter(f"{one.side}: {one.reason}" for one in self.differences)


def main(options: Options) -> int:
    """Print a line for each log; return 1 if a log with aligned depth differs."""
    old, new = load(options.old), load(options.new)
    names = [name for name in old if name in new]
    for name in sorted(old.keys() ^ new.keys()):
        print(f"{name}: only in {options.old if name in old else options.new}")
    columns = EXACT if options.boxes else tuple(c for c in EXACT if c[:2] not in ("u_", "v_"))
    found = {name: compare(old[name], new[name], options.tolerance_m, columns) for name in names}
    print("| log | depth | frames | old | new | same | differ |\n" + "|---" * 7 + "|")
    for name, one in [*found.items(), *_totals(found)]:
        print(row_of(name, one))
    if options.json_file:
        text = json.dumps({name: one._asdict() for name, one in found.items()}, indent=1)
        options.json_file.write_text(text, encoding="utf-8")
    return int(any(one.aligned and one.differences for one in found.values()))


def row_of(name: str, one: Comparison) -> str:
    """Return a row of the table."""
    frames = f"{one.frames}"
    frames += f", {one.only_old} old only" if one.only_old else ""
    frames += f", {one.only_new} new only" if one.only_new else ""
    reasons = "; ".join(f"{count} {reason}" for reason, count in one.reasons.most_common())
    kind = "aligned" if one.aligned else "own rays"
    cells = (name, kind, frames, str(one.old), str(one.new), str(one.same), reasons)
    return "| " + " | ".join(cells) + " |"


def _totals(found: dict[str, Comparison]) -> Iterator[tuple[str, Comparison]]:
    for aligned in (True, False):
        mine = [one for one in found.values() if one.aligned == aligned]
        if mine:
            names = Comparison._fields[1:-1]
            sums = {name: sum(getattr(one, name) for one in mine) for name in names}
            every = tuple(part for one in mine for part in one.differences)
            yield "**all**", Comparison(aligned, **sums, differences=every)


def load(folder: Path) -> dict[str, LogResult]:
    """Return the results in a folder by log name; rows without a depth timestamp are left out."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    cameras = {one["log"]: one.get("calibration") for one in summary["logs"]}
    obstacles: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in pq.read_table(folder / "obstacles.parquet").to_pylist():
        obstacles.setdefault((row["log"], row["frame"]), []).append(row)
    found: dict[str, LogResult] = {}
    for row in pq.read_table(folder / "frames.parquet").to_pylist():
        stamp, log = row.get("depth_stamp_ns", row["stamp_ns"]), row["log"]
        if stamp is None or not cameras.get(log):
            continue
        result = found.setdefault(log, LogResult({}, cameras[log]))
        result.frames[stamp] = Frame(row, obstacles.get((log, row["frame"]), []))
    return found


def compare(
    old: LogResult, new: LogResult, tolerance_m: float, columns: Sequence[str]
) -> Comparison:
    """Compare the obstacles of a log.

    Args:
        old: Results of the earlier commit.
        new: Results of the later commit.
        tolerance_m: See :class:`Options`.
        columns: Columns that must be equal if depth is aligned to colour.
    """
    T = extrinsics_of(old.calibration)
    size = old.calibration["color"]
    shared = [stamp for stamp in old.frames if stamp in new.frames]
    same, differences = 0, []
    for stamp in shared:
        before, after = old.frames[stamp], new.frames[stamp]
        if T is None:
            count, parts = _exactly(stamp, before, after, columns)
        else:
            count, parts = _moved(
                stamp, before, after, T, (size["width"], size["height"]), tolerance_m
            )
        same += count
        differences += parts
    count = [sum(len(one.frames[stamp].obstacles) for stamp in shared) for one in (old, new)]
    rest = [len(one.frames) - len(shared) for one in (old, new)]
    return Comparison(
        T is None, len(shared), rest[0], rest[1], count[0], count[1], same, tuple(differences)
    )


def extrinsics_of(calibration: dict[str, Any]) -> np.ndarray | None:
    """Return ``T_color_depth`` ``(4, 4)``, None if depth is aligned to colour."""
    motion = calibration.get("color_from_depth")
    if motion is None:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.reshape(motion["rotation"], (3, 3)), motion["translation"]
    return T


def _exactly(
    stamp: int, before: Frame, after: Frame, columns: Sequence[str]
) -> tuple[int, list[Difference]]:
    """Return the number of obstacles with equal columns, in order, and the differences."""
    pairs = zip(before.obstacles, after.obstacles, strict=False)
    differences, same = [], 0
    for one, other in pairs:
        unequal = [name for name in columns if one[name] != other[name]]
        same += not unequal
        if unequal:
            text = ", ".join(f"{name} {one[name]} -> {other[name]}" for name in unequal)
            differences.append(Difference(stamp, "both", OTHER, text))
    common = min(len(before.obstacles), len(after.obstacles))
    for side, frame in (("old", before), ("new", after)):
        rest = frame.obstacles[common:]
        differences += [Difference(stamp, side, OTHER, _text(one)) for one in rest]
    return same, differences


class GroundObstacle(NamedTuple):
    """An obstacle in the ground frame of the depth camera."""

    row: dict[str, Any]
    contour: np.ndarray
    """Contour on the floor, ``(n, 2)``, right and forward [m]."""
    corners: np.ndarray
    """Corners of its rectangle on the floor, ``(4, 2)`` [m]."""

    def moved(self, turn: np.ndarray, shift: np.ndarray) -> "GroundObstacle":
        """Return the obstacle in the ground frame of another camera, see :func:`ground_motion`."""
        contour, corners = (a @ turn.T + shift for a in (self.contour, self.corners))
        return self._replace(contour=contour, corners=corners)

    def off_m(self, other: "GroundObstacle") -> dict[str, float]:
        """Return the differences between two obstacles by attribute [m]."""
        distances = [float(np.linalg.norm(one.contour, axis=1).min()) for one in (self, other)]
        heights = {
            name: abs(_number(self.row[name]) - _number(other.row[name]))
            for name in ("bottom_m", "top_m")
        }
        return {
            "distance": abs(distances[0] - distances[1]),
            **heights,
            "contour": hausdorff_m(self.contour, other.contour),
            "corners": hausdorff_m(self.corners, other.corners),
        }


def _number(value: float | None) -> float:
    return 0.0 if value is None else value


def hausdorff_m(one: np.ndarray, other: np.ndarray) -> float:
    """Return the Hausdorff distance: the maximum distance of a point of either set to the other.

    Example:
        >>> hausdorff_m(np.array([[0.0, 0.0]]), np.array([[0.0, 0.0], [3.0, 4.0]]))
        5.0
    """
    way = np.linalg.norm(one[:, None] - other[None], axis=-1)
    return float(max(way.min(axis=0).max(), way.min(axis=1).max()))


def _moved(
    stamp: int,
    before: Frame,
    after: Frame,
    T: np.ndarray,
    size: tuple[int, int],
    tolerance_m: float,
) -> tuple[int, list[Difference]]:
    """Compare obstacles within the tolerance, after the transform to the depth camera."""
    own = _plane(before.row)
    turn, shift = ground_motion(own[0], T)
    old = [one.moved(turn, shift) for one in ground_obstacles(before)]
    new = ground_obstacles(after)
    pairs = pair_up(old, new)
    floor = _floor_reason(before, after, T)
    same, differences = 0, []
    for i, j in pairs:
        one, other = old[i], new[j]
        parts = one.off_m(other)
        off = max(parts.values())
        if off <= tolerance_m:
            same += 1
            continue
        reason = _little(one, other, parts, tolerance_m) or floor or JOINED
        by = ", ".join(f"{name} {value:.3f}" for name, value in parts.items())
        text = f"{by} m: {_text(one.row)} -> {_text(other.row)}"
        differences.append(Difference(stamp, "both", reason, text))
    for side, mine, others, place in (("old", old, new, 0), ("new", new, old, 1)):
        taken = {pair[place] for pair in pairs}
        for number in sorted(set(range(len(mine))) - taken):
            one = mine[number]
            near = any(gap_m(one, other) < PAIRED_M for other in others)
            reason = _reason(one, size, floor, near=near)
            differences.append(Difference(stamp, side, reason, _text(one.row)))
    return same, differences


def _little(
    one: GroundObstacle, other: GroundObstacle, parts: dict[str, float], tolerance_m: float
) -> str | None:
    """Return the reason if only a part of the outlines of a pair differs; otherwise None."""
    if max(parts["distance"], parts["bottom_m"], parts["top_m"]) > tolerance_m:
        return None
    if parts["contour"] <= tolerance_m:
        return RECTANGLE
    way = np.linalg.norm(one.contour[:, None] - other.contour[None], axis=-1)
    off = [int((way.min(axis=axis) > tolerance_m).sum()) for axis in (0, 1)]
    return CELLS if max(off) <= max(2, FEW * max(way.shape)) else None


def _reason(one: GroundObstacle, size: tuple[int, int], floor: str, *, near: bool) -> str:
    """Return why an obstacle is in only one of the results; ``near``: others are close to it."""
    row = one.row
    if row["u_min"] is None:
        return OUTSIDE
    if _touches_edge(row, size) and not near:
        return CUT
    if near:
        return floor or JOINED
    return floor or (SMALL if _is_small(row) else OTHER)


def _touches_edge(row: dict[str, Any], size: tuple[int, int]) -> bool:
    width, height = size
    low, high = min(row["u_min"], row["v_min"]), (row["u_max"], row["v_max"])
    return low < EDGE_PX or high[0] >= width - EDGE_PX or high[1] >= height - EDGE_PX


def _is_small(row: dict[str, Any]) -> bool:
    corners = np.reshape(row["corners_ground"], (4, 2))
    wide = np.linalg.norm(np.ptp(corners, axis=0))
    return max(wide, (row["top_m"] or 0) - (row["bottom_m"] or 0)) < LEAST_M


def _floor_reason(before: Frame, after: Frame, T: np.ndarray) -> str:
    """Return the reason if the floors of a frame are different planes, else an empty text."""
    if before.row["camera_height_m"] is None or after.row["camera_height_m"] is None:
        return LEVEL
    (down, height), (found, found_height) = _plane(before.row), _plane(after.row)
    center = -T[:3, :3].T @ T[:3, 3]  # of the colour camera, in the depth camera
    moved = T[:3, :3].T @ down
    off = float(np.arccos(np.clip(moved @ found, -1, 1)))
    is_same = abs(height + moved @ center - found_height) <= FLOOR_M and off <= FLOOR_RAD
    return "" if is_same else FLOOR


def _plane(row: dict[str, Any]) -> tuple[np.ndarray, float]:
    """Return down in the camera, and its height above the floor; level if unknown."""
    pitch, roll = (np.array([row[f"camera_{name}_rad"] or 0.0]) for name in ("pitch", "roll"))
    return down_vector(pitch, roll)[0], row["camera_height_m"] or 0.0


def ground_motion(down: np.ndarray, T_color_depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion from the ground frame of the colour camera to that of the depth camera.

    Args:
        down: Down vector in the colour camera, ``(3,)``.
        T_color_depth: Extrinsics ``(4, 4)``.

    Returns:
        Rotation ``(2, 2)`` and shift ``(2,)`` [m].

    Example:
        >>> T = np.eye(4)
        >>> T[0, 3] = 0.015  # the depth camera is 15 mm to the right of the colour camera
        >>> ground_motion(np.array([0.0, 1.0, 0.0]), T)[1].tolist()
        [-0.015, 0.0]
    """
    R, t = T_color_depth[:3, :3], T_color_depth[:3, 3]
    axes = _axes(down)
    own = _axes(R.T @ down) @ R.T  # the depth camera's ground axes, in the colour camera
    return own @ axes.T, -own @ t


def _axes(down: np.ndarray) -> np.ndarray:
    forward = forward_vector(down[None])[0]
    return np.stack([np.cross(down, forward), forward])


def ground_obstacles(frame: Frame) -> list[GroundObstacle]:
    """Return the obstacles of a frame; the corners replace a missing contour."""
    found = []
    for row in frame.obstacles:
        corners = np.reshape(row["corners_ground"], (4, 2)).astype(float)
        line = np.reshape(row["contour"] or row["corners_ground"], (-1, 2)).astype(float)
        found.append(GroundObstacle(row, line, corners))
    return found


def gap_m(one: GroundObstacle, other: GroundObstacle) -> float:
    """Return the minimum distance between two contours [m]."""
    return float(np.linalg.norm(one.contour[:, None] - other.contour[None], axis=-1).min())


def pair_up(old: Sequence[GroundObstacle], new: Sequence[GroundObstacle]) -> list[tuple[int, int]]:
    """Match obstacles one to one, smallest difference first; return pairs of indices."""
    candidates = [
        (sum(one.off_m(other).values()), i, j)
        for i, one in enumerate(old)
        for j, other in enumerate(new)
        if gap_m(one, other) <= PAIRED_M
    ]
    pairs: list[tuple[int, int]] = []
    for _, i, j in sorted(candidates):
        if all(i != a and j != b for a, b in pairs):
            pairs.append((i, j))
    return pairs


def _text(row: dict[str, Any]) -> str:
    box = f"{row['u_min']}..{row['u_max']} x {row['v_min']}..{row['v_max']}"
    place = f"{row['x']:.2f} {row['y']:.2f} {row['z']:.2f}"
    return f"{row['num_points']} points at {place}, {row['z_min']:.3f} m deep, box {box}"
