"""Sidecar files, opened or played together with a log.

Messages have the header timestamps and the log times of the log's depth images, so that both files
share a timeline regardless of the camera's clock.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.export.grid import last_grid
from jaxdet.export.shapes import (
    FRAME_COLUMNS,
    Row,
    T_camera_floor,
    T_world_camera,
    camera_name,
    floor_name,
)
from jaxdet.io.writer import Transform
from jaxdet.results.map_file import Grid
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.tables import Frame


class SidecarFrame(NamedTuple):
    """A frame in a sidecar."""

    frame: Frame
    """Rows of the frame. If ``transforms`` has the pose of the camera, the camera's TF frame is
    renamed to ``CAMERA_FRAME_jaxdet``: a TF frame can have only one parent, and the frame of the
    original name has one in the log."""
    log_time_ns: int
    """Log time of its messages [ns]."""
    transforms: tuple[Transform, ...]
    """Floor frame, and pose of the camera in the world if the log's TF lacks it."""
    grid: Grid | None
    """Map in the world frame; only in the first frame, and only if the log has one."""


def sidecars(results: Results, folder: Path) -> Iterator[tuple[ResultLog, Path]]:
    """Create the folder, and yield the path of each log's file in it: ``LOG.jaxdet.mcap``."""
    folder.mkdir()
    for log in results.logs:
        yield log, folder / f"{log.file_name}.jaxdet.mcap"


def sidecar_frames(
    results: Results, log: ResultLog, columns: tuple[str, ...] = ()
) -> Iterator[SidecarFrame]:
    """Yield the frames of a log, with these additional columns of the frame table."""
    for number, frame in enumerate(results.frames(log, (*FRAME_COLUMNS, *columns))):
        grid = None if number else last_grid(results, log)
        named = frame.row["world_frame"] and not log.poses_from_tf
        T = T_world_camera(frame.row) if named else None
        if T is not None:
            row = frame.row | {"camera_frame": f"{camera_name(frame.row)}_jaxdet"}
            frame = frame._replace(row=row)
        transforms = tuple(_transforms(frame.row, T))
        yield SidecarFrame(frame, frame.row["log_time_ns"], transforms, grid)


def floor_transform(row: Row) -> Transform | None:
    """Return the transform of the floor frame in the camera frame; None if the floor is unknown."""
    if row["camera_height_m"] is None:
        return None
    return Transform(camera_name(row), floor_name(row), T_camera_floor(row))


def _transforms(row: Row, T_world: np.ndarray | None) -> Iterator[Transform]:
    if (floor := floor_transform(row)) is not None:
        yield floor
    if T_world is not None:
        yield Transform(row["world_frame"], camera_name(row), T_world)
