"""Parts of a robot in view of its own camera: near, above the floor, of constant depth."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import cv2
import numpy as np

from jaxdet.camera import pixel_rays
from jaxdet.config import Config
from jaxdet.engine.floors import Planes, evenly
from jaxdet.errors import InputError, JaxdetError, printable
from jaxdet.floor.plane import down_vector, unknown_plane
from jaxdet.floor.sampled import sampled_floor
from jaxdet.pipeline import find_floors
from jaxdet.types import Frames, GroundPlane

if TYPE_CHECKING:
    from jaxdet.io import Log
    from jaxdet.results.tables import Tables

_FRAMES, _FEWEST = 32, 8
"""Maximum number of frames in a sample, and minimum number of them that must be readable."""
_MAX_BYTES = 128 << 20
"""Maximum size of the depth images in memory [byte]."""
NEAR_M, ABOVE_M = 1.0, 0.04
"""Maximum depth of the body, and its minimum height above the floor [m]."""
_SHARE = 0.9
"""Minimum fraction of the sampled frames in which a pixel of the body has the same depth."""
_BAND_M, _BAND = 0.012, 0.04
"""Tolerance for equal depths [m], and as a fraction of the depth; the larger one is used."""
_MOVING = 0.25
"""Minimum fraction of the other pixels above the floor whose depth changes if the camera moves."""
_SMALLEST, _MARGIN = 0.001, 0.008
"""Minimum fraction of the pixels in a part, and its margin as a fraction of the image width."""


def find_own_body(log: "Log", config: Config, planes: Planes) -> np.ndarray:
    """Return the pixels of a log's depth images that show the robot itself.

    Parts of the robot have the same depth in all frames of a sample. So do floors, ceilings and
    walls if the robot drives straight; only near pixels above the floor count.

    Args:
        log: An open log of a camera that moves.
        config: Configuration with which the floor is found.
        planes: Priors of the log's floors.

    Returns:
        Mask ``(H, W)`` bool; all False if no part of the robot was found.

    Raises:
        InputError: Too few frames can be read, the floor is unknown, or the camera does not move.
    """
    most = max(_FEWEST, _MAX_BYTES // (2 * log.depth_shape[0] * log.depth_shape[1]))
    frames = log.read(evenly(np.array(log.frames), min(_FRAMES, most)).tolist()).frames
    depth = frames.depth[frames.valid]
    if len(depth) < _FEWEST:
        raise _not_found(log, f"{len(depth)} frames are too few", "use a longer log")
    plane = _floor(frames, config, planes)
    if not plane.valid[0]:
        remedy = "pass --ground.camera-height-m and --ground.camera-pitch"
        raise _not_found(log, "the floor is unknown", remedy)
    unit = log.calibration.depth_unit
    typical, same = _steady(depth, unit)
    x, y = pixel_rays(log.calibration.depth)
    down = down_vector(plane.pitch, plane.roll)[0]
    above = plane.height[0] - typical * unit * (down[0] * x + down[1] * y + down[2]) > ABOVE_M
    body = same & above & (typical * unit < NEAR_M)
    others = above & (typical > 0) & ~body
    if np.count_nonzero(others & same) >= (1 - _MOVING) * np.count_nonzero(others):
        problem = "the camera does not move, or sees nothing else than the floor"
        raise _not_found(log, problem, "use a log in which the robot turns")
    return _whole_parts(body)


def own_body_note(
    log: "Log", config: Config, planes: Planes, results: Iterable["Tables"], path: str
) -> str:
    """Return a note on parts of the robot in the images, with the commands that mask them.

    The note is empty if no parts are visible. The images are examined only if nearly all frames
    have a near obstacle.

    Args:
        log: An open log.
        config: Configuration of the run.
        planes: Priors of the log's floors.
        results: Frames of the log with their obstacles, in parts.
        path: Path of the log for the command.
    """
    near = frames = 0
    for part in results:
        frames += part.frames.num_rows
        depth = part.obstacles["z_min"].to_numpy()
        near += len(np.unique(part.obstacles["frame"].to_numpy()[depth < NEAR_M]))
    if near < _SHARE * frames:
        return ""
    try:
        share = find_own_body(log, config, planes).mean()
    except JaxdetError:  # for example because the camera does not move
        return ""
    camera = f" --camera {log.camera}" if log.label != log.name else ""
    command = printable(f"jaxdet info {path}{camera} --suggest-mask mask.png")
    text = f"{100 * share:.1f} % of the depth image may show the robot itself"
    return f"{text}: {command} suggests a mask for --log.mask" if share else ""


def _floor(frames: Frames, config: Config, planes: Planes) -> GroundPlane:
    """Return the floor of a log, ``B = 1``: from flags or a sample, else from these frames.

    TF alone is not trusted: if the frames don't show the floor of a mount, it may be wrong.
    """
    priors = planes.of(frames.stamp_ns)
    for row, source in enumerate(planes.sources(frames.stamp_ns)):
        if source not in ("tf", "none"):
            return GroundPlane(*(part[row : row + 1] for part in priors))
    fit = find_floors(frames._replace(plane=unknown_plane(len(frames.valid))), config)
    return sampled_floor(fit.plane, fit.own & frames.valid).plane


def _steady(depth: np.ndarray, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the median depth of each pixel and whether its depth is constant.

    The median is 0 if the pixel has no depth in half of the frames or more.

    Args:
        depth: Depth images ``(n, H, W)`` uint16 [depth units], 0 = no measurement.
        unit: Metres in a depth unit.

    Returns:
        Median depths ``(H, W)`` float64 [depth units], and a mask ``(H, W)`` bool.
    """
    typical = np.zeros(depth.shape[1:])
    same = np.zeros(depth.shape[1:], bool)
    for row, values in enumerate(np.moveaxis(depth, 1, 0)):
        frames, ordered = len(values), np.sort(values, axis=0).astype(np.float64)
        count = np.count_nonzero(values, axis=0)
        middles = frames - count + np.stack([np.maximum(count, 1) - 1, count]) // 2
        low, high = np.take_along_axis(ordered, np.minimum(middles, frames - 1), axis=0)
        typical[row] = np.where(2 * count > frames, (low + high) / 2, 0)
        band = np.maximum(_BAND_M / unit, _BAND * typical[row])
        near = (values > 0) & (abs(values - typical[row]) <= band)
        same[row] = near.mean(axis=0) >= _SHARE
    return typical, same & (typical > 0)


def _whole_parts(body: np.ndarray) -> np.ndarray:
    """Remove small parts, close holes, and add a margin for mixed pixels at the edges."""
    width = 2 * round(_MARGIN * body.shape[1]) + 3
    square = np.ones((width, width), np.uint8)
    closed = cv2.morphologyEx(body.astype(np.uint8), cv2.MORPH_CLOSE, square)
    _, labels, about, _ = cv2.connectedComponentsWithStats(closed)
    large = about[:, cv2.CC_STAT_AREA] >= _SMALLEST * body.size
    large[0] = False  # the background
    return cv2.dilate(large[np.asarray(labels, np.int32)].astype(np.uint8), square) > 0


def _not_found(log: "Log", problem: str, remedy: str) -> InputError:
    text = f"no mask can be suggested: {problem}"
    return InputError(text, path=log.label, remedy=f"{remedy}, or draw it yourself")
