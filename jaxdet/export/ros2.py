"""ROS 2 messages: detections, points, free floor, map and TF in an MCAP file per log.

The file can be played together with the recording, see :mod:`jaxdet.export.sidecar`.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxdet.export.recordings import look_again
from jaxdet.export.scan import SCAN_COLUMNS, local_grid, scan, scan_message
from jaxdet.export.shapes import (
    FRAME_COLUMNS,
    Row,
    T_camera_floor,
    box,
    camera_name,
    contour,
    corners,
    floor_name,
    heights,
    topic,
)
from jaxdet.export.sidecar import sidecar_frames, sidecars
from jaxdet.io import LogFiles
from jaxdet.io.writer import Ros2LogWriter
from jaxdet.io.writer_cdr import header, pose_of, xyz
from jaxdet.results.map_file import Grid
from jaxdet.results.masks import obstacle_points
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.tables import Frame

DETECTIONS, POINTS, MAP, SCAN, LOCAL = "detections", "points", "map", "scan", "local_map"
"""Topics, see :func:`jaxdet.export.shapes.topic`."""
MESSAGES = {
    SCAN: "sensor_msgs/LaserScan",
    LOCAL: "nav_msgs/OccupancyGrid",
    DETECTIONS: "vision_msgs/Detection3DArray",
}
"""Type of the messages of each frame, by topic; see :func:`frame_messages`."""

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("obstacle", "<u4")])
"""Point of the cloud in the camera optical frame [m], with the label of its obstacle."""
_DATATYPES = {"<f4": 7, "<u4": 6}
"""Data types of ``sensor_msgs/PointField``."""


def export(results: Results, output: Path, recordings: Mapping[str, LogFiles]) -> None:
    """Write ``LOG.jaxdet.mcap`` of each log into a folder.

    Args:
        results: Results of a run.
        output: Folder.
        recordings: Logs of the results by name; their point clouds are the points of obstacles. The
            point clouds of other logs are the contours at the bottom and the top of obstacles.
    """
    for log, path in sidecars(results, output):
        with Ros2LogWriter(path) as writer:
            files = recordings.get(log.name)
            clouds = _own_points(results, log, files) if files else _contours(results, log)
            _write_log(writer, results, log, clouds)


def _write_log(
    writer: Ros2LogWriter, results: Results, log: ResultLog, clouds: Iterator[np.ndarray]
) -> None:
    range_m = results.method.ground.max_depth_m
    for entry, cloud in zip(sidecar_frames(results, log, SCAN_COLUMNS), clouds, strict=True):
        row, at = entry.frame.row, entry.log_time_ns
        if entry.grid is not None:
            message, map_topic = grid_message(entry.grid, row), topic(log, MAP)
            writer.write(map_topic, at, "nav_msgs/OccupancyGrid", message, latched=True)
        writer.write_transforms(row["stamp_ns"], entry.transforms, log_ns=at)
        for name, message in frame_messages(entry.frame, range_m):
            writer.write(topic(log, name), at, MESSAGES[name], message)
        points = cloud_message(row, cloud)
        writer.write(topic(log, POINTS), at, "sensor_msgs/PointCloud2", points)


def frame_messages(frame: Frame, range_m: float) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the messages of a frame, each with its key in :data:`MESSAGES`.

    If the floor is unknown, there are only detections.

    Args:
        frame: Frame with :data:`jaxdet.export.scan.SCAN_COLUMNS`.
        range_m: Maximum depth [m], which limits scan and grid.
    """
    row = frame.row
    if (own := scan(row)) is not None:
        yield SCAN, scan_message(own, header(row["stamp_ns"], floor_name(row)), range_m)
    if (around := local_grid(frame, range_m)) is not None:
        yield LOCAL, grid_message(around, row, floor_name(row))
    yield DETECTIONS, detections(frame)


def detections(frame: Frame) -> dict[str, Any]:
    """Return a ``vision_msgs/Detection3DArray``: outlines from bottom to top, in the camera frame.

    ``id`` is the obstacle's track, empty without one; if the log was not tracked, its label.
    """
    row = frame.row
    head, T = header(row["stamp_ns"], camera_name(row)), T_camera_floor(row)
    messages = []
    for obstacle in frame.obstacles:
        T_floor_box, size = box(obstacle, *heights(row, obstacle))
        center = pose_of(T @ T_floor_box)
        result = {
            "hypothesis": {"class_id": "obstacle", "score": 1.0},
            "pose": {"pose": center, "covariance": (0.0,) * 36},
        }
        bounds = {"center": center, "size": xyz(size)}
        name = obstacle["track"] if "track" in obstacle else obstacle["obstacle"]
        name = "" if name is None else str(name)
        messages.append({"header": head, "results": [result], "bbox": bounds, "id": name})
    return {"header": head, "detections": messages}


def _contours(results: Results, log: ResultLog) -> Iterator[np.ndarray]:
    """Yield the cloud of each frame: contours, else outlines, at bottom and top of obstacles."""
    for row, obstacles in results.frames(log, FRAME_COLUMNS):
        T, parts = T_camera_floor(row), [np.zeros(0, POINT)]
        for obstacle in obstacles:
            edge = contour(obstacle)
            edge = edge if len(edge) else corners(obstacle)
            for height in heights(row, obstacle):
                points = np.insert(edge, 2, height, axis=1) @ T[:3, :3].T + T[:3, 3]
                parts.append(_cloud(points, np.full(len(edge), obstacle["obstacle"])))
        yield np.concatenate(parts)


def _own_points(results: Results, log: ResultLog, files: LogFiles) -> Iterator[np.ndarray]:
    """Yield the points of all obstacles of each frame."""
    for batch, found, chunk in look_again(results, log, files, with_cells=True):
        unit = batch.frames.calibration.depth_unit
        for i, count in enumerate(chunk.frames["num_obstacles"].to_pylist()):
            yield _cloud(*obstacle_points(found, i, unit)) if count else np.zeros(0, POINT)


def _cloud(points: np.ndarray, labels: np.ndarray) -> np.ndarray:
    cloud = np.empty(len(points), POINT)
    cloud["x"], cloud["y"], cloud["z"] = points.T
    cloud["obstacle"] = labels
    return cloud


def cloud_message(row: Row, cloud: np.ndarray) -> dict[str, Any]:
    """Return a ``sensor_msgs/PointCloud2`` with points of type :data:`POINT`."""
    offsets = zip(POINT.names or (), POINT.descr, strict=True)
    fields = [
        {"name": name, "offset": 4 * i, "datatype": _DATATYPES[kind[1]], "count": 1}
        for i, (name, kind) in enumerate(offsets)
    ]
    return {
        "header": header(row["stamp_ns"], camera_name(row)),
        "height": 1,
        "width": len(cloud),
        "fields": fields,
        "is_bigendian": False,
        "point_step": POINT.itemsize,
        "row_step": cloud.nbytes,
        "data": cloud.tobytes(),
        "is_dense": True,
    }


def grid_message(grid: Grid, row: Row, frame_id: str | None = None) -> dict[str, Any]:
    """Return a ``nav_msgs/OccupancyGrid``; its cells are 100 (occupied), 0 (free), -1 (unknown).

    Args:
        grid: Grid.
        row: Row of the frame that has the timestamp.
        frame_id: TF frame of the grid; by default the world frame.
    """
    head = header(row["stamp_ns"], frame_id or row["world_frame"] or "")
    rows, columns = grid.states.shape
    origin = np.eye(4)
    origin[:2, 3] = grid.origin
    info = {
        "map_load_time": head["stamp"],
        "resolution": grid.cell_m,
        "width": columns,
        "height": rows,
        "origin": pose_of(origin),
    }
    return {"header": head, "info": info, "data": grid.states.tobytes()}
