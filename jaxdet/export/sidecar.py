"""What a file that is opened or played beside a log shows of each of its frames.

Messages have the header stamps of the log's depth images, and as log times the times at which
the log received them, so that both files have one timeline whatever clock stamped the images.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.export.grid import Grid, last_grid
from jaxdet.export.shapes import (
    FRAME_COLUMNS,
    Row,
    T_camera_floor,
    T_world_camera,
    camera_name,
    floor_name,
)
from jaxdet.io.writer import Transform
from jaxdet.results.reading import Frame, ResultLog, Results


class Moment(NamedTuple):
    """A frame in a sidecar."""

    frame: Frame
    """Its camera frame is ``CAMERA_FRAME_jaxdet`` where the transforms have its pose: a frame has
    one parent, and that of the log's own camera is in the log."""
    log_time_ns: int
    """Log time of its messages [ns]."""
    transforms: tuple[Transform, ...]
    """The floor frame, and where the log's own transforms lack it the camera in the world."""
    grid: Grid | None
    """The map in the world's frame, with the first frame of a log that has one."""


def sidecars(results: Results, folder: Path) -> Iterator[tuple[ResultLog, Path]]:
    """Makes the folder, and names the file of each log in it: ``LOG.jaxdet.mcap``."""
    folder.mkdir()
    for log in results.logs:
        yield log, folder / f"{log.file_name}.jaxdet.mcap"


def moments(results: Results, log: ResultLog, columns: tuple[str, ...] = ()) -> Iterator[Moment]:
    """The frames of a log, one by one, with further columns of theirs."""
    for number, frame in enumerate(results.frames(log, (*FRAME_COLUMNS, *columns))):
        grid = None if number else last_grid(results, log)
        named = frame.row["world_frame"] and not log.poses_from_tf
        T = T_world_camera(frame.row) if named else None
        if T is not None:
            row = frame.row | {"camera_frame": f"{camera_name(frame.row)}_jaxdet"}
            frame = frame._replace(row=row)
        yield Moment(frame, frame.row["log_time_ns"], tuple(_transforms(frame.row, T)), grid)


def _transforms(row: Row, T_world: np.ndarray | None) -> Iterator[Transform]:
    if row["camera_height_m"] is not None:
        yield Transform(camera_name(row), floor_name(row), T_camera_floor(row))
    if T_world is not None:
        yield Transform(row["world_frame"], camera_name(row), T_world)
