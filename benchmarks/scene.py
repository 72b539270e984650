"""Inputs of the stage benchmarks: the simulator's demo room, seen by a D435-like camera."""

from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np
import warp as wp

from jaxdet import reference
from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import flat_plane, repeat_plane, step_height
from jaxdet.reference import FloorFit
from jaxdet.reference._detect import Found, _group, _surfaces
from jaxdet.sim.exposure import LIGHTS, ColorSensor, expose
from jaxdet.sim.render import render
from jaxdet.sim.scenes import load_scene
from jaxdet.sim.sensor import DepthSensor, measure_depth
from jaxdet.types import (
    Calibration,
    Cells,
    Distortion,
    Extrinsics,
    Frames,
    GroundPlane,
    Intrinsics,
)

RENDERER = "cuda" if wp.is_cuda_available() else "cpu"
"""Device on which the scene is rendered; the depth does not depend on it."""
BATCH = 8
HEIGHT_M = 0.35
PITCH_RAD = 0.15
BASELINE_M = 0.015
COS_LAMP = 0.82
"""Cosine of the angle of incidence of the room's lamp on the floor."""
CONFIG = Config()
KINECT = (0.51, -2.69, 0.0007, 0.0001, 1.55, 0.39, -2.50, 1.47)
"""Coefficients of a rational distortion model, similar to an Azure Kinect's."""
CALIBRATIONS = {
    "640x480": Calibration(
        Intrinsics(640, 480, 380.0, 380.0, 319.5, 239.5),
        Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5),
        Extrinsics((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (BASELINE_M, 0.0, 0.0)),
    ),
    "848x480-1280x720": Calibration(
        Intrinsics(848, 480, 422.0, 422.0, 423.5, 239.5),
        Intrinsics(1280, 720, 915.0, 915.0, 639.5, 359.5),
        Extrinsics((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (BASELINE_M, 0.0, 0.0)),
    ),
    "1280x720": Calibration(
        Intrinsics(1280, 720, 640.0, 640.0, 639.5, 359.5),
        Intrinsics(1280, 720, 915.0, 915.0, 639.5, 359.5),
        Extrinsics((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (BASELINE_M, 0.0, 0.0)),
    ),
    "1080p": Calibration(
        Intrinsics(1280, 720, 640.0, 640.0, 639.5, 359.5),
        Intrinsics(1920, 1080, 1372.0, 1372.0, 959.5, 539.5),
        Extrinsics((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (BASELINE_M, 0.0, 0.0)),
    ),
    "lens": Calibration(
        Intrinsics(640, 576, 504.0, 504.0, 319.5, 287.5, Distortion.RATIONAL, KINECT),
        Intrinsics(1280, 720, 608.0, 608.0, 639.5, 364.5, Distortion.RATIONAL, KINECT),
        Extrinsics((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (BASELINE_M, 0.0, 0.0)),
    ),
}
"""Calibrations by the size of both images, or of the depth image and the colour image; ``1080p``
has colour images of 1920x1080, ``lens`` is an Azure Kinect's. Scenes are rendered without
distortion, which affects the content of the image margins but not the computation."""


class Inputs(NamedTuple):
    """Inputs of the stages on pixels."""

    calibration: Calibration
    color: np.ndarray
    depth: np.ndarray
    plane: GroundPlane


class OnCells(NamedTuple):
    """Inputs of the stages on cells, computed by the reference."""

    cells: Cells
    fit: FloorFit
    floor: np.ndarray
    """Floor frames ``(B, 13)`` int32, see :func:`jaxdet.floor.frame.floor_frames`."""
    surfaces: list[Found]
    obstacles: list[Found]

    def of(self, name: str, found: list[Found]) -> np.ndarray:
        """Return a field of :class:`Found` or its view for all frames, ``(B, R, C)``."""
        every = [
            getattr(one, name) if hasattr(one, name) else getattr(one.view, name) for one in found
        ]
        stacked = np.stack(every)
        return stacked if stacked.dtype == bool else stacked.astype(np.int32)

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return right, forward and height of the cells on the floor, each ``(B, R, C)`` int32."""
        right, forward, height = (self.of(k, self.surfaces) for k in ("right", "forward", "height"))
        return right, forward, height


def _pose(x: float, right: float) -> np.ndarray:
    """Return ``T_world_camera`` ``(4, 4)`` of a camera that looks along x, slightly down."""
    sin, cos = np.sin(PITCH_RAD), np.cos(PITCH_RAD)
    T = np.eye(4)
    T[:3, :3] = [[0.0, -sin, cos], [-1.0, 0.0, 0.0], [0.0, -cos, -sin]]
    T[:3, 3] = x, -right, HEIGHT_M
    return T


@cache
def inputs(size: str) -> Inputs:
    """Return the inputs of all stages for ``BATCH`` frames, a few centimetres apart.

    Args:
        size: A key of ``CALIBRATIONS``.

    Returns:
        NumPy arrays; the same on every machine and for every call.
    """
    calibration = CALIBRATIONS[size]
    assert calibration.color is not None
    room, rng = load_scene("demo"), np.random.default_rng(0)
    color, depth = [], []
    for frame in range(BATCH):
        # T_color_depth shifts points to the right, so the colour camera sits to the left.
        left = _pose(0.05 * frame, -BASELINE_M)
        ideal = render(room, calibration.color, left, device=RENDERER)
        shot = (ideal.color, ideal.light), calibration.color, LIGHTS["normal"]
        color.append(expose(*shot, COS_LAMP, ColorSensor(), rng))
        here = _pose(0.05 * frame, 0.0)
        z = render(room, calibration.depth, here, device=RENDERER).depth
        depth.append(measure_depth(z, calibration.depth, DepthSensor(), rng))
    one = flat_plane(*(np.array([a]) for a in (HEIGHT_M, PITCH_RAD, 0.0)))
    plane = repeat_plane(one, BATCH)
    colors, depths = np.stack(color), np.stack(depth)
    return Inputs(calibration, colors, depths, plane)


@cache
def on_cells(size: str) -> OnCells:
    """Return the inputs of the stages on cells, for the same frames.

    Args:
        size: A key of ``CALIBRATIONS``.
    """
    given = inputs(size)
    unit, step = given.calibration.depth_unit, step_height(given.calibration, CONFIG)
    grid = reference.cells(given.depth, given.calibration, CONFIG.surface)
    fit = reference.find_floor(grid.x, grid.y, grid.z, given.plane, CONFIG.floor, unit)
    floor = floor_frames(fit.plane, unit)
    surfaces = [_surfaces(grid, b, floor[b], step, unit, CONFIG) for b in range(BATCH)]
    obstacles = [_group(grid, b, floor[b], step, unit, CONFIG) for b in range(BATCH)]
    return OnCells(grid, fit, floor, surfaces, obstacles)


def repeated(tree: Any, batch: int) -> Any:
    """Repeat arrays of ``BATCH`` frames cyclically to ``batch`` frames."""
    turns = np.arange(batch) % BATCH
    return jax.tree.map(lambda a: a[turns], tree)


def frames_of(size: str, batch: int, *, color: bool = False) -> Frames:
    """Return ``batch`` frames in host memory: the scene's, repeated cyclically, with their floor.

    Images are aligned to cache lines, like those read from a log.

    Args:
        size: A key of ``CALIBRATIONS``.
        batch: Number of frames.
        color: Whether the frames have colour images, which the preset ``paper`` reads.
    """
    given = inputs(size)
    number, valid = np.arange(batch, dtype=np.int64), np.ones(batch, bool)
    depth, plane = repeated((given.depth, given.plane), batch)
    frames = Frames(_on_lines(depth), given.calibration, number, number, valid, plane=plane)
    if not color:
        return frames
    colors = _on_lines(repeated(given.color, batch))
    return frames._replace(color=colors, color_stamp_ns=number)


def _on_lines(images: np.ndarray) -> np.ndarray:
    """Return a copy aligned to 64 bytes; XLA copies arrays with another alignment at each call."""
    memory = np.empty(images.nbytes + 64, np.uint8)
    start = -memory.ctypes.data % 64
    copy = memory[start : start + images.nbytes].view(images.dtype).reshape(images.shape)
    copy[:] = images
    return copy


def pin(images: np.ndarray) -> np.ndarray:
    """Copy images into page-locked memory, for transfers at the full rate of the bus.

    Args:
        images: uint8 or uint16.
    """
    kind: Any = {np.uint8: wp.uint8, np.uint16: wp.uint16}[images.dtype.type]
    copy = wp.empty(images.shape, dtype=kind, device="cpu", pinned=True).numpy()
    copy[...] = images
    return copy
