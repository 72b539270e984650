"""align: examples by hand, and comparisons with librealsense and of kernel and reference."""

import cv2
import numpy as np
import pytest

from jaxdet import reference, stages
from jaxdet.errors import CalibrationError
from jaxdet.types import AlignedDepth, Calibration, Extrinsics, Intrinsics
from tests.goldens.make_rs_align import CASES, FILE
from tests.scenes import (
    D435,
    D435_COLOR,
    D435_MOTION,
    IDENTITY,
    LENSES,
    align_all,
    assert_equal,
    noise_depth,
    resized,
    rotation,
    small,
    smooth_depth,
    with_lens,
)

BACKENDS = pytest.mark.parametrize(
    "align", [reference.paper.align, align_all], ids=["reference", "stages"]
)
TURNED = Extrinsics(rotation(3, -5, 8), (-0.03, 0.01, 0.02))


# by hand


def still(shift_x: float) -> Calibration:
    camera = Intrinsics(6, 3, 2.0, 2.0, 2.5, 1.0)
    return Calibration(camera, camera, Extrinsics(IDENTITY, (shift_x, 0.0, 0.0)))


@BACKENDS
def test_the_identity_transform_keeps_every_pixel(align):
    depth = noise_depth(2, still(0).depth)
    aligned = align(depth, still(0))
    assert np.array_equal(aligned.depth, depth)
    assert np.array_equal(aligned.z, np.minimum(depth, 65534))


@BACKENDS
def test_a_colour_camera_to_the_side_shifts_near_pixels_more_and_the_nearest_wins(align):
    depth = np.zeros((1, 3, 6), np.uint16)
    depth[0, 1] = 1000, 1000, 500, 0, 0, 1000
    # For a focal length of 2 px and an offset of 0.5 m, the shift is 1 px at 1 m, 2 px at 0.5 m.
    aligned = np.asarray(align(depth, still(0.5)).depth)
    assert aligned[0, 1].tolist() == [0, 1000, 1000, 0, 500, 0]
    depth[0, 1, 3] = 2000
    assert np.asarray(align(depth, still(0.5)).depth)[0, 1, 4] == 500


@BACKENDS
def test_z_is_measured_in_the_frame_of_the_colour_camera(align):
    behind = Extrinsics(IDENTITY, (0.0, 0.0, 0.25))
    camera = still(0).color
    depth = np.full((1, 3, 6), 1000, np.uint16)
    aligned = align(depth, Calibration(camera, camera, behind))
    assert set(np.unique(aligned.depth).tolist()) <= {0, 1000}
    assert set(np.unique(aligned.z).tolist()) <= {0, 1250}


@BACKENDS
def test_a_point_behind_the_colour_camera_is_dropped(align):
    ahead = Extrinsics(IDENTITY, (0.0, 0.0, -2.0))
    depth = np.full((1, 3, 6), 1000, np.uint16)
    assert not np.asarray(align(depth, Calibration(still(0).depth, still(0).image, ahead)).z).any()


@BACKENDS
def test_aligned_depth_is_passed_through(align):
    depth = noise_depth(1, still(0).depth)
    aligned = align(depth, Calibration(still(0).depth))
    assert np.array_equal(aligned.depth, depth)
    assert np.array_equal(aligned.z, depth)


@BACKENDS
def test_missing_extrinsics_are_an_error_that_names_the_flag(align):
    with pytest.raises(CalibrationError, match=r"--log\.color-from-depth"):
        align(noise_depth(1, still(0).depth), still(0)._replace(color_from_depth=None))


# librealsense


@pytest.mark.parametrize("name", CASES)
@BACKENDS
def test_aligned_depth_equals_stored_results_of_rs_align(align, name):
    calibration, depth = CASES[name]
    want = np.load(FILE)[name]
    assert np.count_nonzero(want) > 1000
    assert np.array_equal(align(depth[None], calibration).depth[0], want)


LIVE = {
    "same_size": D435,
    "turned": D435._replace(color_from_depth=TURNED),
    "720p": D435._replace(
        color=resized(D435.color, 1280, 720), depth=resized(D435.depth, 848, 480)
    ),
    "coarse": D435._replace(color=resized(D435.depth, 320, 240)),
    "special_size": D435._replace(color=resized(D435.depth, 640, 360)),
    "depth_lens": D435._replace(depth=with_lens(D435.depth, "inverse")),
}


@pytest.mark.parametrize("name", LIVE)
@pytest.mark.parametrize("image", [noise_depth, smooth_depth])
def test_aligned_depth_equals_rs_align(name, image):
    pytest.importorskip("pyrealsense2", exc_type=ImportError)
    from tests.oracles import realsense

    calibration = LIVE[name]
    depth = image(1, calibration.depth)
    want = realsense.align(depth[0], calibration)
    assert np.array_equal(reference.paper.align(depth, calibration).depth[0], want)


def test_aligned_depth_of_a_recording_equals_rs_align(shared_data):
    pytest.importorskip("pyrealsense2", exc_type=ImportError)
    from tests.oracles import realsense

    depth = cv2.imread(str(shared_data / "realsense_d435_bag/depth.png"), cv2.IMREAD_UNCHANGED)
    aligned = reference.paper.align(depth[None], D435).depth[0]
    assert np.count_nonzero(aligned) > 200_000
    assert np.array_equal(aligned, realsense.align(depth, D435))


# lenses, against OpenCV


@pytest.mark.parametrize("lens", ["plumb_bob", "rational", "equidistant"])
def test_colour_lens_projects_as_opencv(lens):
    calibration = small()._replace(
        color=with_lens(small().color, lens), color_from_depth=Extrinsics(IDENTITY, (0, 0, 0))
    )
    color, depth_camera = calibration.color, calibration.depth
    v, u = 17, 23
    depth = np.zeros((1, 60, 80), np.uint16)
    depth[0, v, u] = 1500
    corners = np.array([[u - 0.5, v - 0.5], [u + 0.5, v + 0.5]])
    rays = np.column_stack([(corners - [depth_camera.cx, depth_camera.cy]) / depth_camera.fx])
    if lens == "equidistant":
        pixels = cv2.fisheye.distortPoints(rays[None], color.K, np.array(color.coefficients))[0]
    else:
        full = np.column_stack([rays, np.ones(2)])
        pixels = cv2.projectPoints(
            full, np.zeros(3), np.zeros(3), color.K, np.array(color.coefficients)
        )[0][:, 0]
    left, top, right, bottom = np.floor(pixels + 0.5).astype(int).ravel()
    want = np.zeros((60, 80), bool)
    want[top : bottom + 1, left : right + 1] = True
    assert np.array_equal(reference.paper.align(depth, calibration).depth[0] == 1500, want)


# twin


@pytest.mark.twin
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("image", [noise_depth, smooth_depth])
def test_aligned_depth_equals_the_reference_with_every_lens(device, lens, image):
    base = small(97, 61, 1.6)
    calibration = base._replace(color=with_lens(base.color, lens), color_from_depth=TURNED)
    depth = image(3, calibration.depth)
    assert_equal(align_all(depth, calibration), reference.paper.align(depth, calibration))


@pytest.mark.twin
@pytest.mark.parametrize(("batch", "size"), [(2, (640, 480)), (3, (848, 480))])
def test_aligned_depth_equals_the_reference_at_full_size(device, batch, size):
    depth_camera = resized(D435.depth, *size)
    calibration = Calibration(depth_camera, resized(D435_COLOR, 640, 480), D435_MOTION)
    depth = noise_depth(batch, depth_camera)
    assert_equal(align_all(depth, calibration), reference.paper.align(depth, calibration))


@pytest.mark.twin
@pytest.mark.parametrize(
    ("lens", "depth_size", "color_size"),
    [
        ("plumb_bob", (639, 481), (4096, 257)),
        ("rational", (1280, 721), (1281, 821)),
        ("equidistant", (1024, 1023), (1281, 719)),
        ("pinhole", (4096, 1031), (637, 479)),
        ("equidistant", (4095, 33), (65, 4096)),
    ],
)
def test_aligned_depth_equals_the_reference_with_large_and_odd_images(
    device, lens, depth_size, color_size
):
    color = with_lens(resized(D435.color, *color_size), lens)
    calibration = Calibration(resized(D435.depth, *depth_size), color, TURNED)
    depth = smooth_depth(1, calibration.depth)
    depth[0, ::7, ::5] = 0
    aligned = align_all(depth, calibration)
    assert np.count_nonzero(aligned.depth) > 1000
    assert_equal(aligned, reference.paper.align(depth, calibration))


@pytest.mark.twin
@pytest.mark.parametrize("lens", LENSES)
def test_aligned_depth_equals_the_reference_if_the_depth_camera_has_distortion(device, lens):
    base = small(97, 61, 0.7)
    calibration = base._replace(
        color=with_lens(base.color, lens), depth=with_lens(base.depth, lens)
    )
    depth = noise_depth(3, calibration.depth)
    assert_equal(align_all(depth, calibration), reference.paper.align(depth, calibration))


@pytest.mark.twin
@pytest.mark.parametrize("color_size", [(97, 61), (640, 480), (1921, 1083), (33, 20)])
@pytest.mark.parametrize("lens", LENSES)
def test_aligned_depth_equals_the_reference_at_a_few_requested_pixels(device, lens, color_size):
    """Depth pixels cover 1 to about 30 colour pixels each, and few pixels are requested."""
    base, (width, height) = small(97, 61), color_size
    color = with_lens(resized(base.color, *color_size), lens)
    calibration = base._replace(color=color, color_from_depth=TURNED)
    depth, rng = noise_depth(3, calibration.depth), np.random.default_rng(width)
    whole = reference.paper.align(depth, calibration)
    for points in (1, 7, 300):
        u, v = (rng.integers(0, n, (3, points)).astype(np.int32) for n in (width, height))
        u[0, 0], v[0, 0], u[-1, -1], v[-1, -1] = 0, 0, width - 1, height - 1
        want = AlignedDepth(*(image[np.arange(3)[:, None], v, u] for image in whole))
        assert_equal(stages.paper.align(depth, u, v, calibration), want)
    assert np.count_nonzero(want.z) > 100


@pytest.mark.twin
@pytest.mark.parametrize("lens", LENSES)
def test_no_tile_that_covers_a_requested_pixel_is_skipped(device, lens):
    """Surfaces are near and far, rotations and translations between the cameras small and large.

    Smooth depth makes the range of depths in a tile narrow, so that most tiles are skipped.
    """
    rng, hits = np.random.default_rng(7), 0
    for distance in (2, 20, 200, 2000, 20000):
        for spread in (0.1, 1.0):
            turn = rotation(*spread * rng.uniform(-40, 40, 3))
            motion = Extrinsics(turn, tuple(spread * rng.uniform(-0.3, 0.3, 3)))
            base = small(97, 61)
            color = with_lens(base.color, lens)
            calibration = base._replace(color=color, color_from_depth=motion)
            depth = smooth_depth(4, base.depth).astype(np.float64) / 1000 * distance
            depth = np.minimum(depth, 65535).astype(np.uint16)
            whole = reference.paper.align(depth, calibration)
            u, v = (rng.integers(0, n, (4, 9)).astype(np.int32) for n in (97, 61))
            want = AlignedDepth(*(image[np.arange(4)[:, None], v, u] for image in whole))
            assert_equal(stages.paper.align(depth, u, v, calibration), want)
            hits += np.count_nonzero(want.z)
    assert hits > 50


@pytest.mark.twin
def test_aligned_depth_equals_the_reference_without_measurements(device):
    depth = np.zeros((2, 60, 80), np.uint16)
    assert_equal(align_all(depth, small()), reference.paper.align(depth, small()))
    assert not np.asarray(align_all(depth, small()).depth).any()


# laws


def test_a_batch_is_a_stack_of_singles(device):
    depth = noise_depth(4, small().depth)
    whole = np.asarray(align_all(depth, small()).z)
    singles = [np.asarray(align_all(image[None], small()).z)[0] for image in depth]
    assert np.array_equal(whole, np.stack(singles))


def test_a_farther_point_never_hides_a_nearer_one(device):
    depth = noise_depth(1, small().depth)
    before = np.asarray(align_all(depth, small()).depth).astype(np.int64)
    more = np.where(depth == 0, np.uint16(9000), depth)
    after = np.asarray(align_all(more, small()).depth)
    assert np.array_equal(after[before > 0], before[before > 0])
