"""Check how often free-floor rays extend beyond obstacles, and how much floor they keep.

    python -m benchmarks.free_rays ../shared/data/labelled/wheelchair.mcap ...

A ray is too long if it ends more than 15 cm behind a point on it: a point of an obstacle's contour,
or a measured pixel above the step height of a single pixel. The free floor of a column of cells, at
the bearing of its end, is correct up to the nearest such point, and it is kept where the ray is
free.
"""

import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import jaxdet
from jaxdet.camera import cell_side, pixel_rays
from jaxdet.config import Config
from jaxdet.floor.frame import CAMERA_HEIGHT, UNKNOWN_HEIGHT, floor_frames, on_floor
from jaxdet.floor.plane import depth_range, max_height, step_height, unknown_plane
from jaxdet.floor.rays import block_settings
from jaxdet.presets import preset
from jaxdet.reference import cells, find_floor
from jaxdet.reference._cells import nearest_depths
from jaxdet.reference._detect import _columns, _free, _group
from jaxdet.reference._outlines import contours
from jaxdet.types import MAX_OBSTACLES, RAYS, Frames

INSIDE_M = 0.15
STEP_M = 0.02
"""Spacing of the points of a column at which its free floor is compared [m]."""


class Figures(NamedTuple):
    """Results for one or more frames; results of several frames are added."""

    frames: int
    rays: int
    """Number of rays with free floor."""
    past_contour: int
    past_pixel: int
    right_m: float
    """Length of the correct free floor of columns [m]."""
    kept_m: float
    """Length of the part of ``right_m`` in which the ray is free [m]."""


def figures(frames: Frames, config: Config) -> Figures:
    """Compute the results of a batch; each frame is processed alone and without a mount."""
    total = np.zeros(len(Figures._fields))
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    grid = cells(frames.depth, calibration, config.surface)
    plane = unknown_plane(len(frames.depth))
    fit = find_floor(grid.x, grid.y, grid.z, plane, config.floor, unit)
    floors, step = floor_frames(fit.plane, unit), step_height(calibration, config)
    found = [_group(grid, b, floor, step, unit, config) for b, floor in enumerate(floors)]
    side = cell_side(calibration.depth, config.surface.cell_rad)
    pixels = nearest_depths(frames.depth, side)
    found, _, free, _ = _free(found, floors, pixels, calibration, config)
    for b, one in enumerate(found):
        start, stop = free[b].T
        is_free = start < stop
        place, used = contours(one.label, one.view.right, one.view.forward, MAX_OBSTACLES)
        outline = np.concatenate([line[:n] for line, n in zip(place, used, strict=True)])
        contour = _nearest(*outline.T)
        pixel = _nearest(*_pixels_above(np.asarray(frames.depth[b]), floors[b], frames, config))
        inside = round(INSIDE_M / unit)
        past = [(is_free & (least < stop - inside) & (least >= start)).sum()
                for least in (contour, pixel)]  # fmt: skip
        line, _ = _columns(one, floors[b], calibration, config)
        ray, length = _points(line, round(STEP_M / unit))
        right = length < np.minimum(contour, pixel)[ray]
        kept = right & (length >= start[ray]) & (length <= stop[ray])
        total += 1, is_free.sum(), *past, right.sum() * STEP_M, kept.sum() * STEP_M
    return Figures(*total[:4].astype(int).tolist(), *total[4:].tolist())


def rays_of(right: ArrayLike, forward: ArrayLike) -> np.ndarray:
    """Return the number of the ray through each point."""
    turn = np.arctan2(right, forward) * RAYS / (2 * np.pi) + RAYS // 2
    return np.rint(turn).astype(np.int64) % RAYS


def _nearest(right: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Return the minimum range of the points on each ray, ``(RAYS,)``; inf without points."""
    least = np.full(RAYS, np.inf)
    np.minimum.at(least, rays_of(right, forward), np.hypot(right, forward))
    return least


def _pixels_above(
    depth: np.ndarray, floor: np.ndarray, frames: Frames, config: Config
) -> tuple[np.ndarray, np.ndarray]:
    """Return right and forward of the pixels above the step; empty without a floor."""
    unit, ground = frames.calibration.depth_unit, config.ground
    z = depth.astype(np.float64)
    xyz = np.stack([ray * z for ray in pixel_rays(frames.calibration.depth)] + [z])
    right, forward, height = on_floor(floor, np.rint(xyz).astype(np.int64))
    near, far = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    step, growth, noise = block_settings(ground, unit).astype(np.float64)
    rise = np.maximum(step + growth * z, noise * max(floor[CAMERA_HEIGHT], 0) * z)
    above = (z >= near) & (z <= far) & (height > rise) & (height <= max_height(ground, unit))
    above &= height < UNKNOWN_HEIGHT
    return right[above], forward[above]


def _points(line: np.ndarray, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ray and range of points on columns, ``step`` apart, at the bearings of their ends."""
    rays, lengths = [], []
    for near, far in line.astype(np.float64):
        start, stop = np.hypot(*near) * (near @ far > 0), np.hypot(*far)
        length = np.arange(start + step / 2, stop, step)
        rays.append(np.full(len(length), rays_of(*far)))
        lengths.append(length)
    return np.concatenate(rays), np.concatenate(lengths)


def of_log(path: str, config: Config) -> Figures:
    """Sum the results of the frames of a log."""
    every = []
    with jaxdet.open_log(path) as log:
        for batch in log.batches(1):
            every.append(figures(batch.frames, config))
    return Figures(*(sum(column) for column in zip(*every, strict=True)))


def main(paths: list[str]) -> None:
    """Print the results of logs."""
    total = []
    for path in paths:
        config = preset("tabletop" if "mosd" in path else "wheeled")
        total.append(of_log(path, config))
        _print_row(path, total[-1])
    _print_row("all", Figures(*(sum(column) for column in zip(*total, strict=True))))


def _print_row(name: str, found: Figures) -> None:
    kept = 100 * found.kept_m / found.right_m if found.right_m else 100.0
    print(
        f"{name}: {found.frames} frames, {found.rays} rays, {found.past_contour} past a contour, "
        f"{found.past_pixel} past a pixel; {kept:.1f} % of {found.right_m:.0f} m kept"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
