"""floor: the estimated plane on made and recorded depth."""

import cv2
import numpy as np
import pytest

from jaxdet.config import GroundConfig
from jaxdet.floor import fit_floor
from jaxdet.plane import down_vector
from jaxdet.reference import align
from jaxdet.types import Calibration, Extrinsics, Intrinsics
from tests.scenes import D435, D435_COLOR, IDENTITY

CALIBRATION = Calibration(D435_COLOR)
CONFIG = GroundConfig()


def scene(
    height: float, pitch: float, roll: float, seed: int, wall: float = 3.0, box: bool = True
) -> np.ndarray:
    """Depth of a floor, a wall at ``wall`` metres and a box, noisy, with holes, ``(H, W)``."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:480, :640]
    x, y = (u - D435_COLOR.cx) / D435_COLOR.fx, (v - D435_COLOR.cy) / D435_COLOR.fy
    down = down_vector(np.array([pitch]), np.array([roll]))[0]
    slope = down[0] * x + down[1] * y + down[2]
    z = np.where(slope > 1e-3, height / np.maximum(slope, 1e-3), np.inf)
    z = np.minimum(z, wall * (1 + 0.3 * x))
    if box:
        left, top = rng.integers(50, 400), rng.integers(150, 300)
        z[top : top + 150, left : left + 160] = np.minimum(
            z[top : top + 150, left : left + 160], 0.9
        )
    z = z + rng.normal(0, 1, z.shape) * 0.002 * z * z
    z[rng.random(z.shape) < 0.2] = 0
    return np.clip(np.rint(1000 * z), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize(
    ("height", "pitch", "roll"),
    [(0.3, 10, 0), (0.62, 19, 10), (0.62, 19, -10), (1.2, 35, 3), (0.15, 5, -4), (0.8, 25, 12)],
)
def test_plane_is_found_beside_walls_and_boxes(height, pitch, roll):
    z = np.stack([scene(height, np.radians(pitch), np.radians(roll), s) for s in range(4)])
    found = fit_floor(z, CALIBRATION, CONFIG)
    assert found.plane.valid[0]
    assert abs(found.plane.height[0] - height) < 0.02
    assert abs(np.degrees(found.plane.pitch[0]) - pitch) < 1
    assert abs(np.degrees(found.plane.roll[0]) - roll) < 1
    assert found.frames_used == 4


def test_frames_without_floor_do_not_matter():
    seen = [scene(0.4, 0.2, 0.0, s) for s in range(3)]
    wall = np.full((480, 640), 900, np.uint16)
    found = fit_floor(np.stack([*seen, wall, 0 * wall, wall]), CALIBRATION, CONFIG)
    assert abs(found.plane.height[0] - 0.4) < 0.02
    assert found.frames_used == 3


@pytest.mark.parametrize("z", [0, 900, 65535])
def test_no_floor_is_said(z):
    found = fit_floor(np.full((3, 480, 640), z, np.uint16), CALIBRATION, CONFIG)
    assert not found.plane.valid[0]
    assert "no " in found.message


def test_same_frames_give_the_same_plane():
    z = np.stack([scene(0.4, 0.2, 0.0, s) for s in range(2)])
    first, again = (fit_floor(z, CALIBRATION, CONFIG).plane for _ in range(2))
    assert first.height[0] == again.height[0]
    assert first.pitch[0] == again.pitch[0]


def test_a_recorded_tilted_and_rolled_camera(shared_data):
    """README_DATA's RANSAC: 0.62-0.63 m, 19-20 degrees down, 9-11 degrees of roll."""
    motion = Extrinsics(IDENTITY, (0.0148, 0.0, 0.0))
    depth_camera = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)
    calibration = Calibration(Intrinsics(640, 480, 610, 610, 320, 240), depth_camera, motion)
    files = [
        shared_data / f"aims_slam/data/depth/{n}.png" for n in (8, 40, 100, 130, 144, 176, 190)
    ]
    depth = [cv2.imread(str(f), cv2.IMREAD_UNCHANGED) for f in files if f.exists()]
    found = fit_floor(align(np.stack(depth), calibration).z, calibration, CONFIG)
    assert abs(found.plane.height[0] - 0.625) < 0.03
    assert abs(np.degrees(found.plane.pitch[0]) - 19.5) < 2
    assert abs(np.degrees(found.plane.roll[0]) - 10) < 2.5
    assert found.height_spread_m < 0.02


def test_a_recorded_office_without_floor(shared_data):
    depth = cv2.imread(str(shared_data / "realsense_d435_bag/depth.png"), cv2.IMREAD_UNCHANGED)
    assert not fit_floor(align(depth[None], D435).z, D435, CONFIG).plane.valid[0]
