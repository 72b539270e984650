"""Obstacles made of surfaces: the whole method for a batch of frames, step by step."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.plane import depth_range, floor_frame, quadratic_table, ramp_rise
from jaxdet.reference._align import align
from jaxdet.reference._cells import cell_ground, cells, margins, step_table
from jaxdet.reference._evidence import Pairs, pairs
from jaxdet.reference._features import features
from jaxdet.reference._floor import find_floor
from jaxdet.reference._footprint import footprint
from jaxdet.reference._free import FloorView, free_floor
from jaxdet.reference._ground import ground
from jaxdet.reference._obstacles import obstacles, whole_surfaces
from jaxdet.reference._outlines import contours, fitted_direction, fitted_span, inner
from jaxdet.reference._surfaces import surfaces, without_bent_floor
from jaxdet.reference._view import View
from jaxdet.types import (
    MAX_CONTOUR,
    Cells,
    Detections,
    Features,
    Frames,
    GroundPlane,
    Labels,
    Obstacles,
    Scene,
)

MAX_OBSTACLES = 128
"""``M``; more set the overflow flag."""
SAMPLE = 2
"""Of the cells, every second one of every second row is a feature."""


class Found(NamedTuple):
    """One frame's cells in surfaces or obstacles."""

    label: np.ndarray
    """``(R, C)`` int64, -1 = none."""
    keep: np.ndarray
    """``(R, C)`` bool, in range and above the floor."""
    free: np.ndarray
    """``(R, C)`` bool, measured to be free: floor, or beyond the range."""
    view: View
    low: np.ndarray
    """``(R, C)`` bool, measured and no higher than the step."""


def detect(frames: Frames, prior: GroundPlane, config: Config) -> Detections:
    """Finds floor, surfaces, obstacles, their outlines and the free floor of each frame.

    Args:
        frames: ``B`` of them; their ``plane`` is not used.
        prior: What is known of each frame's floor, from the user, TF or the log; corrected by
            the frame's own depth where that shows enough floor.
        config: The method; ``surface.cell_rad`` is above 0.

    Returns:
        Features are the corners, then every second cell of every second row; the obstacles are
        measured on all cells.
    """
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    grid = cells(frames.depth, calibration, config.surface)
    fit = find_floor(grid.x, grid.y, grid.z, prior, config.floor, unit)
    step = step_table(calibration, config)
    found = [_group(grid, b, fit.plane, step, unit, config) for b in range(len(grid.z))]

    corners = _corners(frames, fit.plane, config)
    points, labels = _with_cells(corners, grid, found, unit, config)
    outlines, shapes = _outlines(grid, found, fit.plane, unit, config)

    nearest, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    in_range = grid.in_view & (grid.z >= nearest) & (grid.z <= farthest)
    return Detections(
        points,
        labels,
        outlines,
        in_range.any(axis=(1, 2)),
        Scene(fit.plane, fit.own, fit.refused, *shapes, *_free(found, unit, config)),
    )


def surface_pairs(
    frames: Frames, prior: GroundPlane, config: Config
) -> Iterator[tuple[Cells, np.ndarray, Pairs]]:
    """What :func:`detect` judges the pairs of surfaces of each frame by, to learn from.

    Yields:
        For each frame its cells (a batch of one), ``(R, C)`` surfaces and their pairs.
    """
    unit = frames.calibration.depth_unit
    grid = cells(frames.depth, frames.calibration, config.surface)
    fit = find_floor(grid.x, grid.y, grid.z, prior, config.floor, unit)
    step = step_table(frames.calibration, config)
    for b in range(len(grid.z)):
        found = _surfaces(grid, b, fit.plane, step, unit, config)
        label = whole_surfaces(found.label, found.view, unit, config.obstacle)
        seen = pairs(label, found.free, found.view, unit, config.obstacle)
        yield Cells(*(a[b : b + 1] for a in grid)), label, seen


def _group(
    grid: Cells, b: int, plane: GroundPlane, step: np.ndarray, unit: float, config: Config
) -> Found:
    """Surfaces and obstacles of one frame."""
    found = _surfaces(grid, b, plane, step, unit, config)
    _, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    label = obstacles(found.label, found.free, found.view, farthest, unit, config.obstacle)
    return found._replace(label=label)


def _surfaces(
    grid: Cells, b: int, plane: GroundPlane, step: np.ndarray, unit: float, config: Config
) -> Found:
    """Surfaces of one frame; ``step`` is of :func:`step_table`."""
    ground_config, settings = config.ground, config.surface
    view = _view(grid, b, plane, unit)
    nearest, farthest = depth_range(ground_config.min_depth_m, ground_config.max_depth_m, unit)
    step = step[view.z]
    in_range = (view.z >= nearest) & (view.z <= round(farthest * settings.beyond))
    keep = in_range & (view.height > step)
    label, low = surfaces(view.z, keep, unit, settings), (view.z > 0) & (view.height <= step)
    straight = without_bent_floor(label, low, view.forward, view.height, unit, settings)
    keep &= (label < 0) | (straight >= 0)
    return Found(straight, keep, (view.z >= nearest) & ~keep, view, low)


def _view(grid: Cells, b: int, plane: GroundPlane, unit: float) -> View:
    """Where the cells of frame ``b`` are, in the camera and on the floor."""
    xyz = np.stack([grid.x[b], grid.y[b], grid.z[b]]).astype(np.int64)
    right, forward, height = floor_frame(plane, b, xyz, unit)
    height = height - ramp_rise(plane, b, forward, unit)
    x, y, z = xyz
    return View(x, y, z, right, forward, height, grid.in_view[b])


def _corners(frames: Frames, plane: GroundPlane, config: Config) -> Features:
    """The corners of each frame with their depths (Sections 3.1 to 3.3)."""
    calibration = frames.calibration
    config = replace(config, ground=cell_ground(calibration, config))
    keep = ground(align(frames.depth, calibration), plane, calibration, config)
    return features(frames.color, keep, calibration, replace(config.features, grid_columns=0))


def _with_cells(
    corners: Features, grid: Cells, found: list[Found], unit: float, config: Config
) -> tuple[Features, Labels]:
    """Corners and a sample of the cells as features, with their obstacles."""
    part = (slice(None), slice(SAMPLE // 2, None, SAMPLE), slice(SAMPLE // 2, None, SAMPLE))
    uv = (grid.uv_min + grid.uv_max) // 2
    label = np.stack([one.label for one in found])
    keep = np.stack([one.keep for one in found]) & grid.in_view
    columns = {"u": uv[..., 0], "v": uv[..., 1], "x": grid.x, "y": grid.y, "z": grid.z}
    columns |= {"valid": keep, "kept": keep}
    sampled = {k: a[part].reshape(len(a), -1) for k, a in columns.items()}
    of_cells = np.where(grid.in_view, label, -1)[part].reshape(len(label), -1)
    of_corners = np.stack(
        [_corner_labels(corners, b, grid, one, unit, config) for b, one in enumerate(label)]
    )
    count = label.max(axis=(1, 2), initial=-1) + 1
    points = Features(
        **{k: np.concatenate([getattr(corners, k), a], axis=1) for k, a in sampled.items()},
        overflow=corners.overflow | (count > MAX_OBSTACLES),
    )
    labels = np.concatenate([of_corners, of_cells], axis=1)
    labels = np.where(labels < MAX_OBSTACLES, labels, -1).astype(np.int32)
    return points, Labels(labels, np.minimum(count, MAX_OBSTACLES).astype(np.int32))


def _corner_labels(
    corners: Features, b: int, grid: Cells, label: np.ndarray, unit: float, config: Config
) -> np.ndarray:
    """The obstacle of each corner: that of the nearest cell whose box it lies in or beside.

    A corner of a contour lies beside it, so the boxes are a pixel larger. One whose depth is not
    that of the cell, within the gap of hidden surfaces, has none.

    Returns:
        ``(N,)`` int64, -1 = none.
    """
    own = (label >= 0) & grid.in_view[b]
    low, high = grid.uv_min[b][own] - 1, grid.uv_max[b][own] + 1
    z, number = grid.z[b][own], label[own]
    out = np.full(corners.u.shape[1], -1)
    gap = round(config.obstacle.depth_gap_m / unit)
    for n in np.flatnonzero(corners.kept[b]).tolist():
        place = np.array([corners.u[b, n], corners.v[b, n]])
        hit = np.flatnonzero(((low <= place) & (place <= high)).all(axis=1))
        near = hit[np.abs(z[hit] - corners.z[b, n]) <= gap]
        if len(near):
            out[n] = number[near[np.argmin(z[near])]]
    return out


def _outlines(
    grid: Cells,
    found: list[Found],
    plane: GroundPlane,
    unit: float,
    config: Config,
) -> tuple[Obstacles, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The obstacles, measured on their cells in the colour image, and outlined on all of them."""
    batch = len(found)
    flat = {k: getattr(grid, k).reshape(batch, -1) for k in "xyz"}
    seen, none = grid.in_view.reshape(batch, -1), np.zeros(batch, bool)
    every = Features(flat["x"], flat["y"], **flat, valid=seen, kept=seen, overflow=none)
    label = np.stack([one.label.ravel() for one in found])
    shown = np.where(seen, label, -1)
    count = np.minimum(label.max(axis=1, initial=-1) + 1, MAX_OBSTACLES).astype(np.int32)
    measured = footprint(every, Labels(shown, count), plane, unit, config, slots=MAX_OBSTACLES)
    lines, heights = [], np.zeros((batch, MAX_OBSTACLES, 2), np.int32)
    long, edge = round(config.footprint.long_m / unit), margins(grid.z.shape[2])
    for b, one in enumerate(found):
        lines.append(contours(one.label, one.view.right, one.view.forward, MAX_OBSTACLES))
        for number in range(int(count[b])):
            own = one.label == number
            inside = own & grid.in_view[b]
            measured.uv_min[b, number] = grid.uv_min[b][inside].min(axis=0)
            measured.uv_max[b, number] = grid.uv_max[b][inside].max(axis=0)
            line = lines[b][0][number, : lines[b][1][number]]
            direction = fitted_direction(line[inner(edge[own.any(axis=0)][:MAX_CONTOUR])])
            place = np.stack([one.view.right[own], one.view.forward[own]], axis=-1)
            measured.direction[b, number] = direction
            measured.span[b, number] = fitted_span(
                place, direction, long, inner(edge[np.nonzero(own)[1]])
            )
            heights[b, number] = one.view.height[own].min(), one.view.height[own].max()
    shape, used = (np.stack(part) for part in zip(*lines, strict=True))
    return measured, (shape, used, heights)


def _free(found: list[Found], unit: float, config: Config) -> tuple[np.ndarray, np.ndarray]:
    """The free floor of each frame."""
    parts = []
    far = round(config.ground.max_depth_m / unit)
    gap = round(config.floor.gap_m / unit)
    settings, step = config.floor, config.ground.step_height_m
    drops = quadratic_table(settings.drop_m, settings.noise_per_m, unit)
    bows = quadratic_table(step, settings.bow_per_m, unit)
    for one in found:
        cell = one.view
        floor = one.low & (cell.height >= -bows[cell.z]) & (cell.z <= far)
        place = cell.right, cell.forward, cell.height
        view = FloorView(one.label, one.low, floor, *place, drops[cell.z])
        parts.append(free_floor(view, far, gap))
    line, end = zip(*parts, strict=True)
    return np.stack(line), np.stack(end)
