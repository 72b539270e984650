"""camera: lens models and rays compared with OpenCV, and errors for invalid calibrations."""

import cv2
import numpy as np
import pytest

from jaxdet.camera import (
    cell_rays,
    corner_rays,
    fixed_rays,
    pixel_rays,
    splat_parameters,
    undistort,
)
from jaxdet.errors import CalibrationError
from jaxdet.types import Calibration, Distortion, Intrinsics
from tests.scenes import D435, D435_COLOR, LENSES, with_lens


@pytest.mark.parametrize("lens", ["plumb_bob", "rational", "equidistant"])
def test_rays_project_back_to_their_pixels_by_opencv(lens):
    camera = with_lens(D435_COLOR, lens)
    x, y = (a[::40, ::40].ravel() for a in pixel_rays(camera))
    v, u = (a[::40, ::40].ravel() for a in np.mgrid[: camera.height, : camera.width])
    rays, k = np.stack([x, y], axis=1), np.array(camera.coefficients)
    if lens == "equidistant":
        pixels = cv2.fisheye.distortPoints(rays[None], camera.K, k)[0]
    else:
        full = np.column_stack([rays, np.ones(len(rays))])
        pixels = cv2.projectPoints(full, np.zeros(3), np.zeros(3), camera.K, k)[0][:, 0]
    assert np.abs(pixels - np.stack([u, v], axis=1)).max() < 1e-6


def test_the_inverse_brown_conrady_model_equals_its_formula():
    camera = with_lens(D435_COLOR, "inverse")
    x, y = undistort(np.array([0.2]), np.array([-0.1]), camera)
    k1, k2, p1, p2, k3 = camera.coefficients
    r2 = 0.05
    f = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    assert np.isclose(x[0], 0.2 * f + 2 * p1 * 0.2 * -0.1 + p2 * (r2 + 2 * 0.04))
    assert np.isclose(y[0], -0.1 * f + 2 * p2 * 0.2 * -0.1 + p1 * (r2 + 2 * 0.01))


@pytest.mark.parametrize("lens", LENSES)
def test_corners_lie_between_pixel_centres(lens):
    camera = with_lens(D435_COLOR, lens)
    corner, center = corner_rays(camera)[0], pixel_rays(camera)[0]
    assert corner.dtype == np.float32
    assert corner.shape == (481, 641)
    assert np.all(corner[:-1, :-1] < center)
    assert np.all(corner[1:, 1:] > center)


@pytest.mark.parametrize("lens", LENSES)
def test_corners_are_half_a_pixel_from_the_centres(lens):
    camera = with_lens(D435_COLOR, lens)
    v, u = np.mgrid[: camera.height + 1, : camera.width + 1] - 0.5
    want = undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, camera)
    assert max(np.abs(a - b).max() for a, b in zip(corner_rays(camera), want, strict=True)) < 1e-6


def test_the_ray_of_a_cell_goes_through_its_centre():
    """The centre of 4 x 4 pixels is between the second and the third."""
    camera = Intrinsics(9, 8, 64.0, 32.0, 4.0, 4.0)
    rays = cell_rays(camera, 4)
    assert rays.shape == (2, 2, 2)
    assert (rays[0, 0] / 2**20 * 64).tolist() == [-2.5, 1.5]
    assert (rays[1, :, 0] / 2**20 * 32).tolist() == [-2.5, 1.5]


@pytest.mark.parametrize(
    ("depth", "color", "fills"),
    [
        ((640, 480, 400.0, 400.0), (640, 480, 400.0, 400.0), False),
        ((640, 480, 400.0, 400.0), (1280, 960, 800.0, 800.0), True),
        ((640, 480, 400.0, 400.0), (640, 480, 350.0, 500.0), True),  # finer only in rows
        ((640, 480, 800.0, 800.0), (320, 240, 200.0, 200.0), False),
        ((640, 480, 800.0, 800.0), (640, 360, 300.0, 300.0), True),  # librealsense's exceptions
        ((640, 240, 800.0, 800.0), (320, 180, 150.0, 150.0), True),
    ],
)
def test_depth_pixels_fill_the_colour_pixels_between_their_corners_if_coarser(depth, color, fills):
    cameras = [Intrinsics(w, h, fx, fy, w / 2, h / 2) for w, h, fx, fy in (depth, color)]
    calibration = Calibration(*cameras, D435.color_from_depth)
    assert splat_parameters(calibration).fills_corners is fills


def test_fixed_point_rays_are_rounded():
    x, y = fixed_rays(D435_COLOR)
    assert x.dtype == y.dtype == np.int32
    assert np.abs(x / 2**20 - pixel_rays(D435_COLOR)[0]).max() <= 2**-21


def test_tables_of_rays_are_cached_and_read_only():
    x, _ = pixel_rays(D435_COLOR)
    assert pixel_rays(D435_COLOR._replace())[0] is x
    with pytest.raises(ValueError, match="read-only"):
        x[0, 0] = 1


def test_rays_beyond_the_fold_of_a_lens_are_not_projected():
    narrow = D435_COLOR._replace(
        distortion=Distortion.PLUMB_BOB, coefficients=(-0.28, 0.05, 0.0, 0.0, 0.0)
    )
    assert splat_parameters(D435).max_r2 > 1e30
    assert splat_parameters(D435._replace(color=narrow)).max_r2 < 1.5


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (
            D435_COLOR._replace(distortion=Distortion.PLUMB_BOB, coefficients=(9.0,) * 9),
            "maximum of 8",
        ),
        (
            D435_COLOR._replace(distortion=Distortion.PLUMB_BOB, coefficients=(-5.0, 0, 0, 0, 0)),
            "can't be inverted",
        ),
        (Intrinsics(640, 480, 20.0, 20.0, 320.0, 240.0), "too wide"),
    ],
)
def test_invalid_calibrations_are_errors(camera, message):
    with pytest.raises(CalibrationError, match=message):
        fixed_rays(camera)


def test_missing_depth_camera_is_an_error():
    with pytest.raises(CalibrationError, match=r"--log\.color-from-depth"):
        splat_parameters(Calibration(D435_COLOR))
