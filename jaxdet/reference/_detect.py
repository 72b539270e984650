"""Complete method for a batch of frames, step by step."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import Config
from jaxdet.floor.frame import DOWN, IS_KNOWN, UNKNOWN_HEIGHT, floor_frames, on_floor
from jaxdet.floor.plane import StepHeight, depth_range, max_height, quadratic_table, step_height
from jaxdet.floor.rays import NOTCH_M, half_turn
from jaxdet.reference import paper
from jaxdet.reference._cells import cell_boxes, cells, margins, nearest_depths
from jaxdet.reference._evidence import Pairs, pairs
from jaxdet.reference._floor import FloorFit, find_floor, floor_of_cells, used_cells
from jaxdet.reference._floor_noise import noise_slope
from jaxdet.reference._free import FloorView, floor_ahead, is_upside_down
from jaxdet.reference._lower_parts import with_lower_parts
from jaxdet.reference._measures import footprint_on_floor
from jaxdet.reference._notches import notches, with_notches
from jaxdet.reference._obstacles import obstacles, whole_surfaces
from jaxdet.reference._outlines import contours, fitted_direction, fitted_span, inner
from jaxdet.reference._rays import Standing, blocks, rays
from jaxdet.reference._surfaces import surfaces, without_bent_floor
from jaxdet.reference._view import View
from jaxdet.types import (
    MAX_LATERAL,
    MAX_OBSTACLES,
    MAX_SURFACES,
    Calibration,
    CellLabels,
    Cells,
    Detections,
    Features,
    Frames,
    GroundPlane,
    Labels,
    Obstacles,
    Scene,
)


class Found(NamedTuple):
    """Cells of one frame, labelled with surfaces or obstacles."""

    label: np.ndarray  # (R, C) int64, -1 = none
    keep: np.ndarray  # (R, C) bool, in range and above the floor
    free: np.ndarray  # (R, C) bool, known to be free: floor, or beyond the range
    view: View
    low: np.ndarray  # (R, C) bool, measured, not above the step height
    half: np.ndarray  # (R, C) bool, measured, above half of the step height
    overflow: bool  # whether there are more surfaces than MAX_SURFACES


class FreeFloor(NamedTuple):
    """Free floor of ``B`` frames, and their obstacles with those in notches of the free floor."""

    found: list[Found]
    first_notch: np.ndarray  # (B,) int32, number of the first obstacle found in a notch
    free: np.ndarray  # (B, RAYS, 2) int32, start and end of the free floor on each ray
    end: np.ndarray  # (B, RAYS) int32, kind of that end (:class:`jaxdet.types.FreeEnd`)


def detect(
    frames: Frames, plane: GroundPlane, config: Config, with_cells: bool = False
) -> Detections:
    """Find floor, surfaces, obstacles, their outlines and the free floor of each frame.

    Only depth is read; the preset ``paper`` (``cluster.points``,
    :func:`jaxdet.reference.paper.detect`) reads colour too.

    Args:
        frames: ``B`` frames; their ``plane`` is not used.
        plane: Prior of the floor in each frame, from the user, TF or the log; corrected by the
            frame's own depth if that shows enough floor.
        config: Configuration of the method.
        with_cells: Whether to return the labels of cells as well.

    Returns:
        Detections of the ``B`` frames, with at most ``MAX_OBSTACLES`` obstacles each.
    """
    if config.cluster.points:
        return paper.detect(frames, plane, config)
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    grid = cells(frames.depth, calibration, config.surface)
    fit = find_floor(grid.x, grid.y, grid.z, plane, config.floor, unit)
    floors, step = floor_frames(fit.plane, unit), step_height(calibration, config)
    found = [_group(grid, b, floor, step, unit, config) for b, floor in enumerate(floors)]
    pixels = nearest_depths(frames.depth, cell_side(calibration.depth, config.surface.cell_rad))
    found, first_notch, free, end = _free(found, floors, pixels, calibration, config)

    count = np.array([one.label.max(initial=-1) + 1 for one in found])
    kept = np.minimum(count, MAX_OBSTACLES).astype(np.int32)
    outlines, shapes = _outlines(grid, found, kept, calibration, config)
    nearest, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    return Detections(
        kept,
        (count > MAX_OBSTACLES) | [one.overflow for one in found],
        ((grid.z >= nearest) & (grid.z <= farthest)).any(axis=(1, 2)),
        outlines,
        Scene(fit.found, plane, *shapes, free, end, first_notch),
        _cell_labels(grid, found) if with_cells else None,
    )


def _cell_labels(grid: Cells, found: list[Found]) -> CellLabels:
    label = np.stack([one.label for one in found])
    keep = np.stack([one.keep for one in found])
    return CellLabels(np.where(label < MAX_OBSTACLES, label, -1).astype(np.int32), keep, grid)


def find_floors(frames: Frames, prior: GroundPlane, config: Config) -> FloorFit:
    """Find only the floor of each frame, see :func:`jaxdet.reference.find_floor`."""
    calibration = frames.calibration
    side = cell_side(calibration.depth, config.surface.cell_rad)
    height, width = frames.depth.shape[1:]
    part = used_cells((height // side, width // side), config.floor)
    grid = cells(frames.depth, calibration, config.surface, part)
    return floor_of_cells(*grid, prior, config.floor, calibration.depth_unit)


def surface_pairs(
    frames: Frames, prior: GroundPlane, config: Config
) -> Iterator[tuple[Cells, np.ndarray, Pairs]]:
    """Return the pairs of surfaces that :func:`detect` classifies, as training data.

    Yields:
        For each frame its cells (a batch of one), surfaces ``(R, C)`` and their pairs.
    """
    unit = frames.calibration.depth_unit
    grid = cells(frames.depth, frames.calibration, config.surface)
    fit = find_floor(grid.x, grid.y, grid.z, prior, config.floor, unit)
    step = step_height(frames.calibration, config)
    for b, floor in enumerate(floor_frames(fit.plane, unit)):
        found = _surfaces(grid, b, floor, step, unit, config)
        label = whole_surfaces(found.label, found.view, unit, config.obstacle)
        found_pairs = pairs(label, found.free, found.view, unit, config.obstacle)
        yield Cells(*(a[b : b + 1] for a in grid)), label, found_pairs


def _group(
    grid: Cells, b: int, floor: np.ndarray, step: StepHeight, unit: float, config: Config
) -> Found:
    """Segment the surfaces of one frame and group them into obstacles."""
    found = _surfaces(grid, b, floor, step, unit, config)
    _, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    label = obstacles(found.label, found.free, found.view, farthest, unit, config.obstacle)
    return found._replace(label=with_lower_parts(label, found.half, found.view, floor))


def _surfaces(
    grid: Cells, b: int, floor: np.ndarray, step: StepHeight, unit: float, config: Config
) -> Found:
    """Segment the surfaces of one frame."""
    ground_config, settings = config.ground, config.surface
    view = _view(grid, b, floor)
    nearest, farthest = depth_range(ground_config.min_depth_m, ground_config.max_depth_m, unit)
    beyond = round(farthest * settings.beyond)
    noise = noise_slope(view, step, floor, nearest, beyond)
    rise = step.at(view.z, noise)
    in_range = (view.z >= nearest) & (view.z <= beyond)
    below = (view.height <= max_height(ground_config, unit)) | (floor[IS_KNOWN] == 0)
    keep = in_range & (view.height > rise) & below
    measured = view.z > 0
    low, half = measured & (view.height <= rise), measured & (2 * view.height > rise)
    label = surfaces(view.z, keep, unit, settings)
    straight = without_bent_floor(label, low, view.forward, view.height, unit, settings)
    keep &= (label < 0) | (straight >= 0)
    overflow = bool(straight.max(initial=-1) >= MAX_SURFACES)
    straight = np.where(straight < MAX_SURFACES, straight, -1)
    free = (view.z >= nearest) & ~keep
    return Found(straight, keep, free, view, low, half, overflow)


def _view(grid: Cells, b: int, floor: np.ndarray) -> View:
    """Return the positions of the cells of frame ``b``, in the camera and on the floor."""
    xyz = np.stack([grid.x[b], grid.y[b], grid.z[b]]).astype(np.int64)
    x, y, z = xyz
    return View(x, y, z, *on_floor(floor, xyz))


def _outlines(
    grid: Cells, found: list[Found], count: np.ndarray, calibration: Calibration, config: Config
) -> tuple[Obstacles, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Measure obstacles from their cells and compute their outlines.

    Args:
        grid: Cells of ``B`` frames.
        found: Labelled cells of each frame.
        count: Number of obstacles of each frame, ``(B,)``.
        calibration: Calibration of the log.
        config: Configuration of the method.

    Returns:
        Obstacles; and for the scene their contours, the number of points of each contour, and the
        lowest and the highest cell of each obstacle.
    """
    batch, unit, settings = len(found), calibration.depth_unit, config.footprint
    flat = [axis.reshape(batch, -1) for axis in grid]
    every = np.ones(flat[0].shape, bool)
    points = Features(*flat[:2], *flat, valid=every, kept=every, overflow=every[:, 0])
    label = np.stack([one.label.ravel() for one in found])
    floor = [np.stack([one.view.right, one.view.forward], axis=-1) for one in found]
    floor = np.clip(np.stack(floor).reshape(batch, -1, 2), -MAX_LATERAL, MAX_LATERAL)
    measured = footprint_on_floor(
        points, Labels(label, count), floor, unit, settings, slots=MAX_OBSTACLES
    )
    side = cell_side(calibration.depth, config.surface.cell_rad)
    first, last, inside = cell_boxes(grid.z, calibration, side)
    lines, heights = [], np.zeros((batch, MAX_OBSTACLES, 2), np.int32)
    long, edge = round(settings.long_m / unit), margins(grid.z.shape[2])
    for b, one in enumerate(found):
        lines.append(contours(one.label, one.view.right, one.view.forward, MAX_OBSTACLES))
        for number in range(int(count[b])):
            own = one.label == number
            shown = own & inside[b]
            measured.uv_min[b, number] = first[b][shown].min(axis=0) if shown.any() else 0
            measured.uv_max[b, number] = last[b][shown].max(axis=0) if shown.any() else -1
            line = lines[b][0][number, : lines[b][1][number]]
            direction = fitted_direction(line[inner(edge[own.any(axis=0)])])
            place = np.stack([one.view.right[own], one.view.forward[own]], axis=-1)
            measured.direction[b, number] = direction
            measured.span[b, number] = fitted_span(
                place, direction, long, inner(edge[np.nonzero(own)[1]])
            )
            heights[b, number] = one.view.height[own].min(), one.view.height[own].max()
    shape, used = (np.stack(part) for part in zip(*lines, strict=True))
    return measured, (shape, used, heights)


def _free(
    found: list[Found],
    floors: np.ndarray,
    pixels: np.ndarray,
    calibration: Calibration,
    config: Config,
) -> FreeFloor:
    """Compute the free floor of each frame, and add the obstacles in its notches.

    Args:
        found: Obstacles of ``B`` frames.
        floors: Floor frames ``(B, 13)``, from :func:`jaxdet.floor.frame.floor_frames`.
        pixels: Nearest depths ``(B, R, C)``, from :func:`jaxdet.reference._cells.nearest_depths`.
        calibration: Calibration of the log.
        config: Configuration of the method.
    """
    unit, side = calibration.depth_unit, cell_side(calibration.depth, config.surface.cell_rad)
    cells, half = cell_rays(calibration.depth, side), half_turn(calibration.depth, side)
    parts, every, first = [], [], [one.label.max(initial=-1) + 1 for one in found]
    for one, frame, near in zip(found, floors, pixels, strict=True):
        with_low = _with_notches(one, frame, calibration, config)
        columns = _columns(with_low, frame, calibration, config)
        above = (_in_range(one, frame, config, unit) & ~one.low) | (with_low.label >= 0)
        standing = Standing(near, one.view.z, above)
        parts.append(rays(*columns, blocks(standing, frame, cells, config.ground, unit), half))
        every.append(with_low)
    free, end = zip(*parts, strict=True)
    return FreeFloor(every, np.array(first, np.int32), np.stack(free), np.stack(end))


def _columns(
    one: Found, frame: np.ndarray, calibration: Calibration, config: Config
) -> tuple[np.ndarray, np.ndarray]:
    """Return the free floor per column, see :func:`jaxdet.reference._free.free_floor`."""
    settings, cell, unit = config.floor, one.view, calibration.depth_unit
    near, far = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    gap = round(settings.gap_m / unit)
    drops = quadratic_table(settings.drop_m, settings.noise_per_m, unit)
    bows = quadratic_table(config.ground.step_height_m, settings.bow_per_m, unit)
    floor = one.low & (cell.height >= -bows[cell.z]) & (cell.z >= near) & (cell.z <= far)
    place = cell.right, cell.forward, cell.height
    view = FloorView(one.label, one.low, floor, *place, drops[cell.z])
    return floor_ahead(view, frame[DOWN], far, gap)


def _with_notches(one: Found, frame: np.ndarray, calibration: Calibration, config: Config) -> Found:
    """Add the obstacles in notches of the free floor to those of a frame."""
    unit, cell = calibration.depth_unit, one.view
    line, end = _columns(one, frame, calibration, config)
    length, ahead = round(NOTCH_M / unit), line[:, 1, 1].astype(np.int64)
    high = _in_range(one, frame, config, unit) & one.half
    notch, least = notches(end, ahead, length), config.obstacle.min_cells
    if is_upside_down(frame[DOWN]):
        notch, ahead = notch[::-1], ahead[::-1]  # to columns of the image
    return one._replace(
        label=with_notches(one.label, notch, ahead, cell.forward, high, length, least)
    )


def _in_range(one: Found, frame: np.ndarray, config: Config, unit: float) -> np.ndarray:
    """Return whether each cell is within the depth range and not above the maximum height."""
    view, ground = one.view, config.ground
    nearest, farthest = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    highest = max_height(ground, unit) if frame[IS_KNOWN] else UNKNOWN_HEIGHT
    in_range = (view.z >= nearest) & (view.z <= farthest)
    return in_range & (view.height <= highest)
