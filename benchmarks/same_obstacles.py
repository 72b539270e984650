"""``python -m benchmarks same OLD NEW``: the obstacles of two commits on the same logs.

Rows of ``OLD`` belong to colour images and their lengths refer to the colour camera; those of
``NEW`` belong to depth images and refer to the depth camera. A depth image's frame is found by its
stamp. Where depth is aligned to colour both cameras are one, and every column must be equal.
Elsewhere the old obstacles are moved to the depth camera by the log's extrinsics and paired one to
one with the new ones, the nearest first. Distance, lowest and highest point, contour and rectangle
are compared, which both commits measure on all cells of an obstacle; each that is not the same
within a tolerance is counted with a reason. Boxes and centroids are not: the old ones are of the
cells in the colour image alone.
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
"""Columns that must be equal where depth is aligned to colour."""
PAIRED_M = 0.05
"""Contours that lie farther apart than this are of different obstacles [m]."""
EDGE_PX = 12
"""A box this near to the edge of the colour image, a cell of the depth image or two, is cut by
it [pixel]."""
LEAST_M = 0.08
"""Obstacles of less width and height are near the least size, which is 5 cm [m]."""
FLOOR_M, FLOOR_RAD = 0.005, 0.005
"""Floors that differ by more are different ones [m, rad]."""
OUTSIDE = "outside of the colour image"
CUT = "cut by the edge of the colour image"
FLOOR = "another floor was found"
LEVEL = "no floor is known, and the depth camera is taken as level"
JOINED = "cells are joined otherwise"
SMALL = "near the least size"
OTHER = "none of these"
FEW = 0.1
"""Share of a contour's points that count as single cells; two always do."""
RECTANGLE = "the rectangle alone"
CELLS = "single cells of the contour"


@dataclass(frozen=True)
class Options:
    """Compares the obstacles of two results folders, log by log."""

    old: tyro.conf.Positional[Path]
    """Results of the earlier commit."""
    new: tyro.conf.Positional[Path]
    """Results of the later commit, on the same logs."""
    tolerance_m: float = 0.03
    """Obstacles are the same where lengths differ by no more [m]."""
    boxes: bool = True
    """Whether boxes in the image must be equal too, where depth is aligned to colour."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """Where to write the counts, with every difference."""


class Frame(NamedTuple):
    """A row of ``frames`` and its rows of ``obstacles``."""

    row: dict[str, Any]
    obstacles: list[dict[str, Any]]


class LogResult(NamedTuple):
    """The results of a log."""

    frames: dict[int, Frame]
    """By the stamp of the depth image."""
    calibration: dict[str, Any]
    """Of the summary."""


class Difference(NamedTuple):
    """An obstacle that is not the same in both."""

    stamp_ns: int
    side: str
    """``old``, ``new``, or ``both`` for one that changed."""
    reason: str
    text: str


class Comparison(NamedTuple):
    """The obstacles of a log in both results."""

    aligned: bool
    frames: int
    """In both."""
    only_old: int
    """Frames of the old results alone."""
    only_new: int
    """Frames of the new results alone."""
    old: int
    """Obstacles in the frames of both."""
    new: int
    same: int
    """Equal, or within the tolerance."""
    differences: tuple[Difference, ...]

    @property
    def reasons(self) -> Counter[str]:
        """How many obstacles differ, by side and reason."""
        return Counter(f"{one.side}: {one.reason}" for one in self.differences)


def main(options: Options) -> int:
    """Prints a line for each log; returns 1 where an aligned log differs at all."""
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
    """A row of the table."""
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
    """The results in a folder, by the log's name; rows without a depth stamp are left out."""
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
    """The obstacles of a log by both commits.

    Args:
        old: Of the earlier commit.
        new: Of the later one.
        tolerance_m: See :class:`Options`.
        columns: What must be equal where depth is aligned to colour.
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
    """``T_color_depth`` ``(4, 4)``, None where depth is aligned to colour."""
    motion = calibration.get("color_from_depth")
    if motion is None:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.reshape(motion["rotation"], (3, 3)), motion["translation"]
    return T


def _exactly(
    stamp: int, before: Frame, after: Frame, columns: Sequence[str]
) -> tuple[int, list[Difference]]:
    """Obstacles whose columns are equal, in order."""
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


class Thing(NamedTuple):
    """An obstacle, seen from the depth camera."""

    row: dict[str, Any]
    contour: np.ndarray
    """``(n, 2)``, on the floor, right and forward [m]."""
    corners: np.ndarray
    """``(4, 2)``, of its rectangle on the floor [m]."""

    def moved(self, turn: np.ndarray, shift: np.ndarray) -> "Thing":
        """The same seen from another camera, see :func:`ground_motion`."""
        contour, corners = (a @ turn.T + shift for a in (self.contour, self.corners))
        return self._replace(contour=contour, corners=corners)

    def off_m(self, other: "Thing") -> dict[str, float]:
        """How much two obstacles differ, by what is compared [m]."""
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
    """The largest distance of a point of either set to the other set.

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
    """Obstacles that are the same within the tolerance, after the move to the depth camera."""
    own = _plane(before.row)
    turn, shift = ground_motion(own[0], T)
    old = [one.moved(turn, shift) for one in things_of(before)]
    new = things_of(after)
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


def _little(one: Thing, other: Thing, parts: dict[str, float], tolerance_m: float) -> str | None:
    """The reason where a pair differs in a part of its outline alone, else None."""
    if max(parts["distance"], parts["bottom_m"], parts["top_m"]) > tolerance_m:
        return None
    if parts["contour"] <= tolerance_m:
        return RECTANGLE
    way = np.linalg.norm(one.contour[:, None] - other.contour[None], axis=-1)
    off = [int((way.min(axis=axis) > tolerance_m).sum()) for axis in (0, 1)]
    return CELLS if max(off) <= max(2, FEW * max(way.shape)) else None


def _reason(one: Thing, size: tuple[int, int], floor: str, *, near: bool) -> str:
    """Why an obstacle is in one of the results alone; ``near`` where others are close to it."""
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
    """The reason where the floors of a frame are not the same plane, else empty."""
    if before.row["camera_height_m"] is None or after.row["camera_height_m"] is None:
        return LEVEL
    (down, height), (found, found_height) = _plane(before.row), _plane(after.row)
    center = -T[:3, :3].T @ T[:3, 3]  # of the colour camera, in the depth camera
    moved = T[:3, :3].T @ down
    off = float(np.arccos(np.clip(moved @ found, -1, 1)))
    is_same = abs(height + moved @ center - found_height) <= FLOOR_M and off <= FLOOR_RAD
    return "" if is_same else FLOOR


def _plane(row: dict[str, Any]) -> tuple[np.ndarray, float]:
    """Down in the camera and its height above the floor; a level camera where it is not known."""
    pitch, roll = (np.array([row[f"camera_{name}_rad"] or 0.0]) for name in ("pitch", "roll"))
    return down_vector(pitch, roll)[0], row["camera_height_m"] or 0.0


def ground_motion(down: np.ndarray, T_color_depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The motion on the floor from the colour camera's ground frame to the depth camera's.

    Args:
        down: ``(3,)``, down in the colour camera.
        T_color_depth: ``(4, 4)``.

    Returns:
        ``(2, 2)`` rotation and ``(2,)`` shift [m].

    Example:
        >>> T = np.eye(4)
        >>> T[0, 3] = 0.015  # the depth camera stands 15 mm to the right of the colour camera
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


def things_of(frame: Frame) -> list[Thing]:
    """The obstacles of a frame; one without a contour has its corners."""
    found = []
    for row in frame.obstacles:
        corners = np.reshape(row["corners_ground"], (4, 2)).astype(float)
        line = np.reshape(row["contour"] or row["corners_ground"], (-1, 2)).astype(float)
        found.append(Thing(row, line, corners))
    return found


def gap_m(one: Thing, other: Thing) -> float:
    """Least distance of two contours [m]."""
    return float(np.linalg.norm(one.contour[:, None] - other.contour[None], axis=-1).min())


def pair_up(old: Sequence[Thing], new: Sequence[Thing]) -> list[tuple[int, int]]:
    """Pairs one to one, those that differ least first."""
    ways = [
        (sum(one.off_m(other).values()), i, j)
        for i, one in enumerate(old)
        for j, other in enumerate(new)
        if gap_m(one, other) <= PAIRED_M
    ]
    pairs: list[tuple[int, int]] = []
    for _, i, j in sorted(ways):
        if all(i != a and j != b for a, b in pairs):
            pairs.append((i, j))
    return pairs


def _text(row: dict[str, Any]) -> str:
    box = f"{row['u_min']}..{row['u_max']} x {row['v_min']}..{row['v_max']}"
    place = f"{row['x']:.2f} {row['y']:.2f} {row['z']:.2f}"
    return f"{row['num_points']} points at {place}, {row['z_min']:.3f} m deep, box {box}"
