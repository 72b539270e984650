"""From the detections of a batch to the rows of the two result tables."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.errors import FrameStatus
from jaxdet.floor.units import FloorFit
from jaxdet.results.free_floor import FreeFloor, free_columns, free_floor, no_free_columns
from jaxdet.results.metric import distances, extents, floors, rectangles, to_world
from jaxdet.types import Detections, GroundPlane, Refusal

if TYPE_CHECKING:
    from jaxdet.io import Batch


class Rows(NamedTuple):
    """A batch's results on the host."""

    frames: dict[str, Any]
    """Columns of ``frames.parquet``."""
    obstacles: dict[str, Any]
    """Columns of ``obstacles.parquet``."""
    detections: Detections
    """NumPy arrays."""
    corners: np.ndarray
    """``(B, M, 4, 2)`` float64, ground frame [m]."""
    plane: GroundPlane
    """The floor of each frame."""
    free_world: np.ndarray | None
    """``(n, C - 1, 4, 2)`` float64, the free floor between neighbouring columns of cells of each
    frame that is not padding, world X and Y [m]; NaN where there is none or no pose."""


def to_host(detections: Detections) -> Detections:
    """The detections as NumPy arrays; waits for the device."""
    return _to_host(detections)


def _to_host(part: Any) -> Any:
    if part is None:
        return None
    if isinstance(part, tuple):
        return type(part)(*map(_to_host, part))
    return np.asarray(part)


def batch_rows(
    log: str,
    batch: "Batch",
    plane: GroundPlane,
    sources: Sequence[str],
    detections: Detections,
    config: Config,
) -> Rows:
    """The rows of a batch, in frame order.

    Args:
        log: The log's name.
        batch: What was read; its padding gives no rows.
        plane: The floor given to each frame, ``(B,)``; with a scene its own is used.
        sources: Where that comes from, ``B`` words, see :meth:`jaxdet.engine.Planes.sources`.
        detections: What was found.
        config: For the outlines.

    Returns:
        Columns for :meth:`jaxdet.results.writer.ResultWriter.add`, and the arrays behind them.
    """
    found = to_host(detections)
    frames = batch.frames
    count = len(batch.status)
    status = np.array(
        [
            FrameStatus.NO_DEPTH if s is FrameStatus.OK and not has else s
            for s, has in zip(batch.status, found.has_depth[:count].tolist(), strict=True)
        ],
        object,
    )
    good = status == FrameStatus.OK
    unit = frames.calibration.depth_unit
    fit = None if found.scene is None else floors(found.scene, unit)
    plane = plane if fit is None else fit.plane
    free = None if found.scene is None else free_floor(found.scene, unit)
    corners = rectangles(found.obstacles, unit, config.footprint)
    frame_columns = _frame_columns(log, batch, plane, found, good)
    frame_columns["status"] = np.array([str(s) for s in status.tolist()], object)
    frame_columns |= _floor_columns(fit, sources[:count], good, config)
    frame_columns |= free_columns(free, good) if free else no_free_columns(count)
    obstacle_columns = _obstacle_columns(log, batch, found, plane, corners, good)
    world = _free_world(free, good, frames.T_world_camera)
    return Rows(frame_columns, obstacle_columns, found, corners, plane, world)


def _frame_columns(
    log: str, batch: "Batch", plane: GroundPlane, found: Detections, good: np.ndarray
) -> dict[str, Any]:
    n = good.size
    frames = batch.frames

    def counted(values: np.ndarray) -> np.ndarray:
        return np.where(good, values[:n], 0).astype(np.int32)

    def angle(values: np.ndarray) -> np.ndarray:
        return np.where(plane.valid, values, np.nan)[:n].astype(np.float32)

    return {
        "log": np.full(n, log, object),
        "frame": frames.number[:n],
        "stamp_ns": frames.stamp_ns[:n],
        "depth_stamp_ns": np.ma.masked_less(frames.depth_stamp_ns[:n], 0),
        "num_features": counted(found.features.valid.sum(axis=1)),
        "num_kept": counted(found.features.kept.sum(axis=1)),
        "num_obstacles": counted(found.labels.num_obstacles),
        "overflow": found.features.overflow[:n] & good,
        "camera_height_m": angle(plane.height),
        "camera_pitch_rad": angle(plane.pitch),
        "camera_roll_rad": angle(plane.roll),
    }


def _floor_columns(
    fit: FloorFit | None, sources: Sequence[str], good: np.ndarray, config: Config
) -> dict[str, Any]:
    """Where each frame's floor comes from, and why not from its own depth."""
    own, refused = np.zeros_like(good), np.zeros(good.size, int)
    if fit is not None and config.ground.source != "none":
        own, refused = good & fit.own[: good.size], fit.refused[: good.size]
    names = np.array([Refusal(number).name.lower() for number in refused.tolist()], object)
    return {
        "floor_source": np.where(own, "frame", np.array(sources, object)),
        "floor_refused": np.ma.array(names, mask=~good | (refused == Refusal.NONE)),
    }


def _free_world(
    free: FreeFloor | None, good: np.ndarray, T_world_camera: np.ndarray | None
) -> np.ndarray | None:
    if free is None or T_world_camera is None:
        return None
    fans = to_world(free.fans()[: good.size], T_world_camera[: good.size])
    return np.where(good[:, None, None, None], fans, np.nan)


def _obstacle_columns(
    log: str,
    batch: "Batch",
    found: Detections,
    plane: GroundPlane,
    corners: np.ndarray,
    good: np.ndarray,
) -> dict[str, Any]:
    frames, obstacles = batch.frames, found.obstacles
    slots = np.arange(obstacles.num_points.shape[1], dtype=np.int32)
    used = good[:, None] & (slots < found.labels.num_obstacles[: good.size, None])
    row, slot = np.nonzero(used)
    box = extents(obstacles, frames.calibration.depth_unit)
    columns: dict[str, Any] = {
        "log": np.full(row.size, log, object),
        "frame": frames.number[row],
        "stamp_ns": frames.stamp_ns[row],
        "obstacle": slot.astype(np.int32),
        "num_points": obstacles.num_points[row, slot],
        "vertices": obstacles.has_vertex[row, slot].astype(np.int8),
        "corners_ground": corners[row, slot].reshape(-1, 8).astype(np.float32),
        "corners_world": _world_corners(corners, frames.T_world_camera)[row, slot].reshape(-1, 8),
    }
    columns |= _shape_columns(found, plane, row, slot, frames.calibration.depth_unit)
    for i, axis in enumerate("uv"):
        columns[f"{axis}_min"] = obstacles.uv_min[row, slot, i]
        columns[f"{axis}_max"] = obstacles.uv_max[row, slot, i]
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_min"] = box.minimum[row, slot, i]
        columns[f"{axis}_max"] = box.maximum[row, slot, i]
        columns[axis] = box.centroid[row, slot, i]
    return columns


def _shape_columns(
    found: Detections, plane: GroundPlane, row: np.ndarray, slot: np.ndarray, unit: float
) -> dict[str, Any]:
    """Distances, and of obstacles made of surfaces contours and heights above the floor."""
    columns: dict[str, Any] = {"distance_m": (distances(found) * unit)[row, slot]}
    if found.scene is None:
        nothing = np.full(row.size, np.nan)
        columns |= {"bottom_m": nothing, "top_m": nothing, "contour": [None] * row.size}
    else:
        scene = found.scene
        height = scene.bottom_top[row, slot] * unit
        height = np.where(plane.valid[row, None], height, np.nan)
        used = scene.contour_points[row, slot].tolist()
        points = (scene.contour[row, slot] * unit).astype(np.float32)
        lines = [line[:count].ravel() for line, count in zip(points, used, strict=True)]
        columns |= {"bottom_m": height[:, 0], "top_m": height[:, 1], "contour": lines}
    floats = ("distance_m", "bottom_m", "top_m")
    return columns | {name: columns[name].astype(np.float32) for name in floats}


def _world_corners(corners: np.ndarray, T_world_camera: np.ndarray | None) -> np.ndarray:
    if T_world_camera is None:
        return np.full(corners.shape, np.nan, np.float32)
    return to_world(corners, T_world_camera).astype(np.float32)
