"""Rotation of images from a camera mounted upside down or on its side."""

import math

import numpy as np

from jaxdet.floor.plane import flat_plane
from jaxdet.types import Frames, GroundPlane, Intrinsics

QUARTER = math.pi / 2


def turned_frames(frames: Frames, quarters: int) -> Frames:
    """Rotate depth images and their camera counterclockwise by quarters of a turn.

    Tangential distortion is not rotated; it affects pixels, but hardly the floor.

    Args:
        frames: ``B`` frames; colour and floor planes are dropped.
        quarters: 1, 2 or 3.
    """
    depth = np.ascontiguousarray(np.rot90(np.asarray(frames.depth), quarters, axes=(1, 2)))
    camera = frames.calibration.depth
    for _ in range(quarters):
        camera = _turned_camera(camera)
    calibration = frames.calibration._replace(depth=camera, color=None, color_from_depth=None)
    return frames._replace(depth=depth, calibration=calibration, color=None, plane=None)


def turned_back(plane: GroundPlane, quarters: int) -> GroundPlane:
    """Convert the floors of rotated images to the frame of the original camera."""
    roll = np.asarray(plane.roll) - quarters * QUARTER
    roll = np.where(roll < -math.pi, roll + 2 * math.pi, roll)
    return flat_plane(plane.height, plane.pitch, roll, np.asarray(plane.valid, bool))


def _turned_camera(camera: Intrinsics) -> Intrinsics:
    """Rotate a camera counterclockwise by a quarter of a turn: columns become rows."""
    return camera._replace(
        width=camera.height,
        height=camera.width,
        fx=camera.fy,
        fy=camera.fx,
        cx=camera.cy,
        cy=camera.width - 1 - camera.cx,
    )
