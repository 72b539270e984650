"""What arrays must be like before kernels read them: kernels look nothing up twice."""

import numpy as np

from jaxdet.camera import cell_side
from jaxdet.config import MAX_POINTS, SurfaceConfig
from jaxdet.errors import CalibrationError, ConfigError, InputError
from jaxdet.types import MAX_CONTOUR, Calibration, Frames, Intrinsics

MAX_CELL_SIDE = 128
"""Most pixels of a cell's side: sums of depths have 31 bits."""
MAX_DEPTH_COLUMNS = 4096
"""Most columns of a depth image in cells."""


def check_frames(frames: Frames) -> None:
    """Refuses images that are not of their cameras' sizes, and arrays of different lengths.

    Raises:
        CalibrationError: A camera of the calibration has another size than its images.
        InputError: There are not as many colour images, depth images and planes, or a plane is no
            number.
    """
    check_size("colour", frames.color.shape, frames.calibration.color)
    check_depth(frames.depth.shape, frames.calibration)
    rows = {"colour images": len(frames.color), "depth images": len(frames.depth)}
    if frames.plane is not None:
        rows["planes"] = len(frames.plane.height)
        if not np.isfinite(np.stack(frames.plane[:3])[:, np.asarray(frames.plane.valid)]).all():
            raise InputError(
                "a plane with a height, pitch or roll that is no number",
                remedy="set its valid to False where the floor is not known",
            )
    if len(set(rows.values())) > 1:
        counts = ", ".join(f"{count} {name}" for name, count in rows.items())
        raise InputError(f"a batch with {counts}", remedy="give one of each for every frame")


def check_depth(shape: tuple[int, ...], calibration: Calibration) -> None:
    """Refuses depth images ``(B, Hd, Wd)`` that are not of the camera they lie on.

    Raises:
        CalibrationError: They have another size.
    """
    check_size("depth", shape, calibration.depth or calibration.color)


def check_size(what: str, shape: tuple[int, ...], camera: Intrinsics) -> None:
    """Refuses images ``(B, H, W, ...)`` of another size than their camera's.

    Raises:
        CalibrationError: They have another size.
    """
    if tuple(shape[1:3]) != (camera.height, camera.width):
        found = "x".join(str(n) for n in shape[2:0:-1])
        raise CalibrationError(
            f"{what} images of {found} pixels, but the calibration has {camera.width}x"
            f"{camera.height}",
            remedy="give the calibration of these images",
        )


def check_cells(calibration: Calibration, config: SurfaceConfig) -> None:
    """Refuses depth images whose cells are none, or more than contours and kernels have room for.

    Raises:
        ConfigError: No cell fits, a side has more than ``MAX_CONTOUR`` of them, a cell has more
            than ``MAX_CELL_SIDE`` pixels a side, or images have more than ``MAX_DEPTH_COLUMNS``.
    """
    camera = calibration.depth or calibration.color
    side = cell_side(camera, config.cell_rad)
    rows, columns = camera.height // side, camera.width // side
    size = f"depth images of {camera.width}x{camera.height} pixels"
    if camera.width > MAX_DEPTH_COLUMNS:
        raise ConfigError(
            f"{size}, but at most {MAX_DEPTH_COLUMNS} columns are taken",
            remedy="record or scale them smaller",
        )
    if side > MAX_CELL_SIDE or not min(rows, columns):
        raise ConfigError(
            f"{size} in cells of {side}x{side}, but one must fit, and at most {MAX_CELL_SIDE} "
            "pixels a side are taken",
            remedy="lower --surface.cell-rad, the angle that a cell takes up",
        )
    if max(rows, columns) > MAX_CONTOUR:
        raise ConfigError(
            f"{size} in {columns}x{rows} cells, but at most {MAX_CONTOUR} a side are taken",
            remedy="raise --surface.cell-rad, the angle that a cell takes up",
        )


def check_points(points: int) -> None:
    """Refuses more points a frame than keys, sums and the kernels' memory hold.

    Raises:
        ConfigError: There are more than ``MAX_POINTS``.
    """
    if points > MAX_POINTS:
        raise ConfigError(
            f"{points} points a frame are more than {MAX_POINTS}",
            remedy="lower --features.max-corners",
        )
