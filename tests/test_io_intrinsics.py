"""Calibration messages: lens models, and incomplete or contradictory values."""

import re

import numpy as np
import pytest

from jaxdet.errors import CalibrationError, ConfigError
from jaxdet.io.intrinsics import CameraSource, find_intrinsics
from jaxdet.io.messages import CameraInfoMessage
from jaxdet.io.options import LogOptions
from jaxdet.io.streams import ImageSize
from jaxdet.io.topics import is_rectified
from jaxdet.types import Distortion

K = (600.0, 0.0, 320.0, 0.0, 601.0, 240.0, 0.0, 0.0, 1.0)
P = (500.0, 0.0, 310.0, 0.0, 0.0, 501.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0)
INFO = CameraInfoMessage(0, "f", 640, 480, "plumb_bob", (0.1, 0.2, 0.0, 0.0, 0.3), K, P)
SOURCE = CameraSource("color", "/info", INFO, ImageSize(640, 480), False, None, None, "x.mcap")


def found(lens_model="plumb_bob", D=INFO.D, **source):
    info = INFO._replace(model=lens_model, D=D)
    return find_intrinsics(SOURCE._replace(info=info, **source))


@pytest.mark.parametrize(
    ("model", "D", "expected", "count"),
    [
        ("plumb_bob", (0.1, 0.2, 0, 0, 0.3), Distortion.PLUMB_BOB, 5),
        ("plumb_bob", (0.1, 0.2, 0, 0), Distortion.PLUMB_BOB, 5),
        ("plumb_bob", (0.0,) * 5, Distortion.NONE, 0),
        ("plumb_bob", (), Distortion.NONE, 0),
        ("rational_polynomial", (0.1,) * 8, Distortion.RATIONAL, 8),
        ("rational_polynomial", (*(0.1,) * 8, 0.0, 0.0, 0.0, 0.0), Distortion.RATIONAL, 8),
        ("equidistant", (0.1,) * 4, Distortion.EQUIDISTANT, 4),
        ("equidistant", (0.0,) * 4, Distortion.EQUIDISTANT, 4),
        ("kannala_brandt", (0.1,) * 4, Distortion.EQUIDISTANT, 4),
        ("no_such_model", (0.0,) * 5, Distortion.NONE, 0),
    ],
)
def test_lens_models_of_messages_are_read(model, D, expected, count):
    lens = found(model, D).intrinsics
    assert lens.distortion is expected and len(lens.coefficients) == count


@pytest.mark.parametrize(
    ("shares", "doubts"), [((0.5, 0.5), 0), ((0.25, 0.25), 1), ((0.65, 0.4), 0)]
)
def test_a_camera_matrix_of_smaller_images_causes_a_warning(shares, doubts):
    matrix = (600.0, 600.0, 640 * shares[0], 480 * shares[1])
    warnings = found(matrix=matrix).warnings
    assert len(warnings) == doubts and all("another image size" in text for text in warnings)


def test_plumb_bob_with_eight_coefficients_is_rational_with_a_warning():
    result = found("plumb_bob", (0.1,) * 8)
    assert result.intrinsics.distortion is Distortion.RATIONAL
    assert "eight coefficients" in result.warnings[0]


@pytest.mark.parametrize(
    ("model", "D"),
    [
        ("no_such_model", (0.1,)),
        ("fisheye62", (0.1,) * 6),
        ("rational_polynomial", (0.1,) * 5),
        ("equidistant", (0.1,) * 5),
        ("plumb_bob", (0.1, np.nan, 0, 0, 0)),
    ],
)
def test_unknown_distortion_is_an_error_that_names_the_flag(model, D):
    with pytest.raises(CalibrationError, match=r"/info.*--log\.color-distortion"):
        found(model, D)


@pytest.mark.parametrize("matrix", [(0.0, *K[1:]), (np.nan, *K[1:]), K[:4]])
def test_an_invalid_camera_matrix_is_an_error_that_names_the_flag(matrix):
    info = INFO._replace(K=matrix)
    with pytest.raises(CalibrationError, match=r"--log\.color-intrinsics"):
        find_intrinsics(SOURCE._replace(info=info))


def test_calibration_and_images_must_have_equal_sizes():
    with pytest.raises(CalibrationError, match=r"320x240.*640x480"):
        found(size=ImageSize(320, 240))
    assert found(size=ImageSize(320, 240), matrix=(1.0, 1.0, 2.0, 2.0)).intrinsics.width == 320
    with pytest.raises(CalibrationError, match=r"--log\.max-pixels"):
        found(max_pixels=1000)
    zero = find_intrinsics(SOURCE._replace(info=INFO._replace(width=0, height=0)))
    assert zero.intrinsics.height == 480 and zero.warnings


def test_flags_override_the_message():
    result = found(matrix=(1.0, 2.0, 3.0, 4.0), model="none")
    assert result.intrinsics[2:6] == (1.0, 2.0, 3.0, 4.0)
    several = tuple(f"/{letter}/camera_info" for letter in "abcdefghijklmn")
    named = (
        r"-info \(/a/camera_info, .*, /l/camera_info, and 2 more\) or pass --log\.color-intrinsics"
    )
    with pytest.raises(CalibrationError, match=named):
        find_intrinsics(SOURCE._replace(info=None, known=several))
    with pytest.raises(CalibrationError, match=r"colour camera; pass --log\.color-intrinsics"):
        find_intrinsics(SOURCE._replace(info=None))
    bare = find_intrinsics(SOURCE._replace(info=None, matrix=(1.0, 2.0, 3.0, 4.0)))
    assert bare.intrinsics.distortion is Distortion.NONE


NONE = (0.0,) * 5
SMALLER = (250.0, 0.0, 155.0, 0.0, 0.0, 250.0, 115.0, 0.0, 0.0, 0.0, 1.0, 0.0)
"""P of images of 320x240."""
IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("rectified", "D", "camera", "projection", "expected"),
    [
        (True, INFO.D, K, P, "P, since the images are rectified$"),
        (False, INFO.D, K, P, "K"),
        (True, NONE, K, P, r"P, since .* rectified \(K is 600 601 320 240; --log.color-intrinsics"),
        (False, NONE, K, P, r"K \(P is 500 501 310 230; --log.color-intrinsics overrides both\)"),
        (True, NONE, K, (*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0), "P$"),
        (True, (), K, P, "P, since"),
        *((True, NONE, K, other, "K, since P") for other in ((0.0,) * 12, (), IDENTITY, SMALLER)),
        *((True, INFO.D, K, other, "K, since P") for other in ((0.0,) * 12, IDENTITY, SMALLER)),
        *((False, NONE, K, other, "K") for other in ((0.0,) * 12, (), IDENTITY, SMALLER)),
        *((rectified, NONE, (0.0,) * 9, P, "P, since") for rectified in (False, True)),
        (False, NONE, (*K[:2], 32.0, *K[3:]), P, "P, since K doesn't fit the images$"),
    ],
)
def test_rectified_images_use_the_projection_matrix(rectified, D, camera, projection, expected):
    """The other matrix is used if it is the only one of these images."""
    info = INFO._replace(D=D, K=camera, P=projection)
    found = find_intrinsics(SOURCE._replace(info=info, rectified=rectified))
    name, lens = expected[0], found.intrinsics
    matrix = (camera[0], camera[4], camera[2], camera[5])
    if name == "P":
        matrix = (projection[0], projection[5], projection[2], projection[6])
    assert lens[2:6] == matrix and not found.warnings
    assert (lens.distortion is Distortion.NONE) == (name == "P" or not any(D))
    origin = found.origin if ", " in found.origin else found.origin.replace("info", f"info, {name}")
    assert re.match(f"topic /info, {expected}", origin)


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/camera/depth/image_rect_raw", True),
        ("/stereo/left/image_rect", True),
        ("/camera/depth/image_rectified", True),
        ("/zed/zed_node/rgb/color/rect/image", True),
        ("/camera/depth/image_raw", False),
        ("/direct/depth", False),
        ("/corrected/depth", False),
    ],
)
def test_names_of_topics_tell_whether_images_are_rectified(topic, rectified):
    assert is_rectified(topic) == rectified


@pytest.mark.parametrize(
    "bad",
    [
        {"pair_tolerance_s": -1.0},
        {"depth_unit_m": 0.0},
        {"color_from_depth": (0.0,) * 7},
        {"color_intrinsics": (0.0, 1.0, 1.0, 1.0)},
        {"max_chunk_mib": 0},
    ],
)
def test_options_out_of_range_are_errors(bad):
    with pytest.raises(ConfigError, match=r"--log\."):
        LogOptions(**bad)
