"""Frames of cells with obstacles, for tests of the steps after the obstacles."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.labelled import RECORDINGS
from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import step_height, unknown_plane
from jaxdet.io import open_log
from jaxdet.presets import preset
from jaxdet.reference import cells
from jaxdet.reference._detect import Found, _group
from jaxdet.reference._floor import find_floor
from jaxdet.reference._view import View
from jaxdet.sim import HARD_FAMILIES, sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.types import Calibration, Cells, GroundPlane, Intrinsics
from tests.scenes import D435_MOTION

SURFACES = Config()


class Batch(NamedTuple):
    """Frames and the results of the steps up to obstacles."""

    grid: Cells
    found: list[Found]
    calibration: Calibration

    @property
    def unit(self) -> float:
        """Depth unit [m]."""
        return self.calibration.depth_unit

    @property
    def label(self) -> np.ndarray:
        """Obstacle of each cell, ``(B, R, C)`` int32."""
        return np.stack([one.label for one in self.found]).astype(np.int32)

    @property
    def low(self) -> np.ndarray:
        """Mask of cells below the step height, ``(B, R, C)`` bool."""
        return np.stack([one.low for one in self.found])

    @property
    def half(self) -> np.ndarray:
        """Mask of cells above half of the step height, ``(B, R, C)`` bool."""
        return np.stack([one.half for one in self.found])

    @property
    def floor(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Right, forward and height of cells, each ``(B, R, C)`` int32."""
        names = ("right", "forward", "height")
        parts = ([getattr(one.view, name) for one in self.found] for name in names)
        right, forward, height = (np.stack(part).astype(np.int32) for part in parts)
        return right, forward, height


def batch_of(depth: np.ndarray, calibration: Calibration, plane: GroundPlane, config: Config):
    """Return the obstacles found by the reference."""
    unit, grid = calibration.depth_unit, cells(depth, calibration, config.surface)
    fit = find_floor(grid.x, grid.y, grid.z, plane, config.floor, unit)
    floors, step = floor_frames(fit.plane, unit), step_height(calibration, config)
    found = [_group(grid, b, floor, step, unit, config) for b, floor in enumerate(floors)]
    return Batch(grid, found, calibration)


@lru_cache(maxsize=16)
def simulated(family: str, width: int = 320, seed: int = 700) -> Batch:
    """Return a frame of a family; hard families have the depth of a stereo camera."""
    changes = {"depth_error": 1.0} if family in HARD_FAMILIES else {}
    size = {"width": width, "height": width * 3 // 4}
    (frame,) = sample_frames(family, seed, 1, **size, **changes)
    assert frame.depth is not None
    return batch_of(frame.depth[None], calibration_of(frame.config), frame.plane, SURFACES)


@lru_cache(maxsize=4)
def recorded(shared_data: Path, name: str, frames: int) -> list[Batch]:
    """Return the first frames of a labelled recording, none if it is missing."""
    recording = next(r for r in RECORDINGS if r.name == name)
    path, batches = shared_data / recording.place, []
    if not path.is_file():
        return []
    with open_log(str(path)) as log:
        for batch, _ in zip(log.batches(1), range(frames), strict=False):
            given = batch.frames
            config = recorded_config(name)
            batches.append(batch_of(given.depth, given.calibration, unknown_plane(1), config))
    return batches


def recorded_config(name: str) -> Config:
    """Return the configuration of a recording."""
    return preset("tabletop" if name == "mosd" else "wheeled")


def grid_calibration(rows: int, columns: int) -> Calibration:
    """Return a depth camera with this grid of cells, and a colour camera that sees a part of it."""
    side, focal = 3, 3 / SURFACES.surface.cell_rad
    width, height = columns * side, rows * side
    depth = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    color = Intrinsics(width, height, 2 * focal, 2 * focal, width / 2, height / 2)
    return Calibration(depth, color, D435_MOTION)


def drawn(
    shape: tuple[int, int, int], obstacles: int, seed: int, reach: int = 300000, block: int = 2
) -> Batch:
    """Return random frames whose obstacles are made of square blocks.

    Args:
        shape: Numbers of frames, rows and columns, ``(B, R, C)``.
        obstacles: Maximum number of obstacles per frame.
        seed: Seed of labels and positions.
        reach: Maximum coordinate [depth units].
        block: Side of a block [cell].
    """
    rng = np.random.default_rng(seed)
    batch, rows, columns = shape
    label = rng.integers(
        -obstacles // 3 - 1, obstacles, (batch, rows // block + 1, columns // block + 1)
    )
    label = label.repeat(block, axis=1).repeat(block, axis=2)[:, :rows, :columns].clip(-1)
    x, y, right, forward, height = rng.integers(-reach, reach + 1, (5, *shape))
    z = rng.integers(0, 65536, shape)
    for b in range(batch):
        _, inverse = np.unique(np.append(label[b].ravel(), -1), return_inverse=True)
        label[b] = inverse[:-1].reshape(rows, columns) - 1
    xyz = np.stack([x, y, z]).astype(np.int32)
    low = (label < 0) & (rng.random(shape) < 0.8)
    places = (right, forward, height)
    views = [View(x[b], y[b], z[b], *(a[b] for a in places)) for b in range(batch)]
    half = (label >= 0) | (rng.random(shape) < 0.5)
    masks = [(label[b] >= 0, low[b], views[b], low[b], half[b]) for b in range(batch)]
    found = [Found(label[b], *masks[b], False) for b in range(batch)]
    return Batch(Cells(*xyz), found, grid_calibration(rows, columns))


def with_floor(batch: Batch, seed: int, far: int, step: int) -> Batch:
    """Return the batch with cells on a floor that steps down with distance.

    Args:
        batch: Frames.
        seed: Seed of heights.
        far: Distance of the top row [depth units].
        step: Height of the steps [depth units].
    """
    rng, found = np.random.default_rng(seed), []
    for one in batch.found:
        rows, columns = one.label.shape
        ahead = np.linspace(far, 300, rows).astype(np.int64)[:, None]
        forward = ahead + rng.integers(-20, 21, (rows, columns))
        falls = np.cumsum((rng.random((rows, columns)) < 3 / rows)[::-1], axis=0)[::-1]
        height = rng.integers(-10, 11, (rows, columns)) - step * falls
        z = np.where(one.low, np.abs(forward), 0)
        right = forward * (np.arange(columns) - columns // 2) * 8 // 1000
        view = one.view._replace(right=right, forward=forward, height=height, z=z)
        found.append(one._replace(view=view))
    z = np.stack([one.view.z for one in found]).astype(np.int32)
    return batch._replace(grid=batch.grid._replace(z=z), found=found)


def changed(**footprint: float) -> Config:
    """Return the default configuration with other parameters of footprints."""
    return replace(SURFACES, footprint=replace(SURFACES.footprint, **footprint))
