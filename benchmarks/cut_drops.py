"""Evaluate free floor and floor fit on drops inserted into real depth images.

A correct result ends the free floor at the edge of the drop and keeps the plane of the floor.

    python -m benchmarks.cut_drops ../shared/data/labelled/wheelchair.mcap ...

In each frame with a visible floor, the floor beyond a straight edge ahead is lowered: its pixels
are moved along their rays to a parallel plane, keeping their noise. Each frame is then processed
with a mount (the original plane of the frame) and without one.
"""

import sys
from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

import jaxdet
from jaxdet.camera import pixel_rays
from jaxdet.config import Config
from jaxdet.floor.plane import down_vector, floor_prior, unknown_plane
from jaxdet.floor.units import FloorFit
from jaxdet.results.free_floor import ray_bearings
from jaxdet.results.metric import floors
from jaxdet.types import Frames, FreeEnd, GroundPlane

EDGES_M = (2.0, 2.3)
DROPS_M = (0.08, 0.15, 0.3, 1.0)
ON_FLOOR_M, ON_FLOOR_PER_M = 0.03, 0.015
"""Pixels within this distance of the plane are floor [m]; it grows with depth [m/m]."""
LEAST_SHARE = 0.04
"""Minimum share of pixels that a drop must move."""
TURN_DEG = 1.5
"""Maximum angle between a correct plane and the original one [degree]."""
PAST_M = 0.15
"""A ray passes an edge if the ray ends more than this beyond the edge [m]."""


class Cut(NamedTuple):
    """Result of one cut."""

    is_own: bool
    """Whether the floor is fitted to the frame's own depth."""
    turn_deg: float
    """Angle between the planes before and after the cut [degree]."""
    ahead: int
    """Number of rays that passed the edge before the cut."""
    passing: int
    """Number of rays of ``ahead`` that still pass the edge after the cut."""
    as_drop: int
    """Number of rays of ``ahead`` that end at a drop after the cut."""

    @property
    def is_right(self) -> bool:
        """Whether the plane equals the one before the cut, within ``TURN_DEG``."""
        return self.is_own and self.turn_deg <= TURN_DEG


def lowered(
    depth: np.ndarray, frames: Frames, plane: GroundPlane, edge_m: float, drop_m: float
) -> np.ndarray:
    """Return a depth image with the floor beyond an edge lowered.

    Args:
        depth: Depth image ``(Hd, Wd)`` uint16 [depth units].
        frames: Frames with the calibration of the image.
        plane: Floor of the image, ``B = 1``.
        edge_m: Distance forward at which the floor ends [m].
        drop_m: Height of the drop [m].
    """
    unit, height = frames.calibration.depth_unit, float(plane.height[0])
    down = down_vector(plane.pitch, plane.roll)[0]
    x, y = np.broadcast_arrays(*pixel_rays(frames.calibration.depth))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    z = depth * unit
    level = np.array([0.0, 0.0, 1.0]) - down[2] * down
    ahead, below = rays @ (level / np.linalg.norm(level)) * z, rays @ down * z
    on_floor = np.abs(height - below) < ON_FLOOR_M + ON_FLOOR_PER_M * z
    moved = np.where((z > 0) & on_floor & (ahead > edge_m), z * (height + drop_m) / height, z)
    found = np.rint(moved / unit)
    return np.where(found < 65536, found, 0).astype(np.uint16)


def cuts(frames: Frames, config: Config, edge_m: float, drop_m: float) -> list[Cut]:
    """Cut a drop into each frame of a batch.

    Returns:
        Two results for each frame that shows its floor beyond the edge: with a mount, and without.
    """
    out, bearing = [], ray_bearings()[0]
    for b in range(len(frames.depth)):
        one = frames._replace(
            depth=frames.depth[b : b + 1], number=frames.number[b : b + 1], color=None,
            stamp_ns=frames.stamp_ns[b : b + 1], valid=frames.valid[b : b + 1], plane=None,
            color_stamp_ns=None, T_world_camera=None,
        )  # fmt: skip
        before, start = _searched(one, config, floor_prior(one, config))
        if not before.own[0]:
            continue
        image = lowered(np.asarray(one.depth[0]), frames, before.plane, edge_m, drop_m)
        if (image != one.depth[0]).mean() < LEAST_SHARE:
            continue
        reach = start[0][:, 1] * np.cos(bearing)
        beyond = reach > edge_m + PAST_M
        for prior in (before.plane, unknown_plane(1)):
            fit, (free, end) = _searched(one._replace(depth=image[None]), config, prior)
            passes = beyond & (free[:, 1] * np.cos(bearing) > edge_m + PAST_M)
            drops = beyond & ~passes & (end == FreeEnd.DROP)
            turn = _turn_deg(before.plane, fit.plane)
            numbers = (int(part.sum()) for part in (beyond, passes, drops))
            out.append(Cut(bool(fit.own[0]), turn, *numbers))
    return out


def _searched(
    frames: Frames, config: Config, prior: GroundPlane
) -> tuple[FloorFit, tuple[np.ndarray, np.ndarray]]:
    """Return the floor of a frame, and range and end of its rays [m]."""
    unit = frames.calibration.depth_unit
    scene = jaxdet.detect(frames._replace(plane=prior), config).scene
    assert scene
    return floors(scene, unit), (np.asarray(scene.free[0]) * unit, np.asarray(scene.free_end[0]))


def _turn_deg(one: GroundPlane, other: GroundPlane) -> float:
    a, b = (down_vector(plane.pitch, plane.roll)[0] for plane in (one, other))
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


def of_log(path: str, config: Config) -> Iterator[tuple[float, list[Cut]]]:
    """Yield the depth of each drop and its results in each frame of a log."""
    with jaxdet.open_log(path) as log:
        for batch in log.batches(1):
            for drop_m, edge_m in product(DROPS_M, EDGES_M):
                yield drop_m, cuts(batch.frames, config, edge_m, drop_m)


def main(paths: list[str]) -> None:
    """Print a row for each drop, with a mount and without."""
    found: dict[tuple[float, bool], list[Cut]] = {}
    for path in paths:
        for drop_m, both in of_log(path, Config()):
            for k, cut in enumerate(both):
                found.setdefault((drop_m, k % 2 == 0), []).append(cut)
    print("drop [m] | mount | cuts | plane right | no floor | rays ahead, past the edge, at a drop")
    for (drop_m, mount), every in sorted(found.items()):
        right, none = sum(cut.is_right for cut in every), sum(not cut.is_own for cut in every)
        counts = [(cut.ahead, cut.passing, cut.as_drop) for cut in every]
        rays = [sum(column) for column in zip(*counts, strict=True)]
        print(f"{drop_m:g} | {'yes' if mount else 'no'} | {len(every)} | {right} | {none} |", *rays)


if __name__ == "__main__":
    main(sys.argv[1:])
