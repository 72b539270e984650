"""What arrays must be like before kernels read them: kernels look nothing up twice."""

from jaxdet.config import MAX_POINTS
from jaxdet.errors import CalibrationError, ConfigError, InputError
from jaxdet.types import MAX_CONTOUR, Calibration, Frames, Intrinsics


def check_frames(frames: Frames) -> None:
    """Refuses images that are not of their cameras' sizes, and arrays of different lengths.

    Raises:
        CalibrationError: A camera of the calibration has another size than its images.
        InputError: There are not as many colour images, depth images and planes.
    """
    check_size("colour", frames.color.shape, frames.calibration.color)
    check_depth(frames.depth.shape, frames.calibration)
    rows = {"colour images": len(frames.color), "depth images": len(frames.depth)}
    if frames.plane is not None:
        rows["planes"] = len(frames.plane.height)
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


def check_grid(rows: int, columns: int) -> None:
    """Refuses more cells than contours and the kernels' memory hold.

    Raises:
        ConfigError: A side has more than ``MAX_CONTOUR`` cells.
    """
    if max(rows, columns) > MAX_CONTOUR:
        raise ConfigError(
            f"{columns}x{rows} cells, but at most {MAX_CONTOUR} a side",
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
