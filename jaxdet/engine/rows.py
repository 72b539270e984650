"""From the detections of a batch to the rows of the two result tables."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.errors import FrameStatus
from jaxdet.metric import extents, rectangles, to_world
from jaxdet.types import Detections, Features, GroundPlane, Labels, Obstacles

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


def to_host(detections: Detections) -> Detections:
    """The detections as NumPy arrays; waits for the device."""
    return Detections(
        Features(*map(np.asarray, detections.features)),
        Labels(*map(np.asarray, detections.labels)),
        Obstacles(*map(np.asarray, detections.obstacles)),
        np.asarray(detections.has_depth),
    )


def batch_rows(
    log: str, batch: "Batch", plane: GroundPlane, detections: Detections, config: Config
) -> Rows:
    """The rows of a batch, in frame order.

    Args:
        log: The log's name.
        batch: What was read; its padding gives no rows.
        plane: The floor of each frame, ``(B,)``.
        detections: What was found.
        config: For the outlines.

    Returns:
        Columns for :meth:`jaxdet.io.results.ResultWriter.add`, and the arrays behind them.
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
    corners = rectangles(found.obstacles, frames.calibration.depth_unit, config.footprint)
    frame_columns = _frame_columns(log, batch, plane, found, good)
    frame_columns["status"] = np.array([str(s) for s in status.tolist()], object)
    return Rows(frame_columns, _obstacle_columns(log, batch, found, corners, good), found, corners)


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


def _obstacle_columns(
    log: str, batch: "Batch", found: Detections, corners: np.ndarray, good: np.ndarray
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
    for i, axis in enumerate("uv"):
        columns[f"{axis}_min"] = obstacles.uv_min[row, slot, i]
        columns[f"{axis}_max"] = obstacles.uv_max[row, slot, i]
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_min"] = box.minimum[row, slot, i]
        columns[f"{axis}_max"] = box.maximum[row, slot, i]
        columns[axis] = box.centroid[row, slot, i]
    return columns


def _world_corners(corners: np.ndarray, T_world_camera: np.ndarray | None) -> np.ndarray:
    if T_world_camera is None:
        return np.full(corners.shape, np.nan, np.float32)
    return to_world(corners, T_world_camera).astype(np.float32)
