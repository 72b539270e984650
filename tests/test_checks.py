"""Checks of arguments before kernels read them: images, calibrations, planes, settings."""

import math
import random
import re
from dataclasses import replace

import numpy as np
import pytest

from jaxdet import detect, estimate_plane, find_floors, stages
from jaxdet.checks import check_calibration, check_frames
from jaxdet.config import (
    ClusterConfig,
    Config,
    FeaturesConfig,
    FloorConfig,
    FootprintConfig,
    GroundConfig,
    ObstacleConfig,
    SurfaceConfig,
)
from jaxdet.errors import CalibrationError, ConfigError, InputError, JaxdetError
from jaxdet.presets import preset
from jaxdet.results import metric
from jaxdet.types import Calibration, Distortion, Frames, Intrinsics, Labels
from tests.scenes import (
    LENSES,
    assert_equal,
    blocks,
    frames,
    level,
    points,
    small,
    smooth_depth,
)


def made(batch: int = 2) -> Frames:
    calibration = small(96, 60)
    depth = smooth_depth(batch, calibration.depth)
    return frames(calibration, blocks(batch, 60, 96), depth, plane=level(batch))


@pytest.mark.parametrize("backend", ["reference", "jax"])
def test_images_must_have_the_size_of_their_camera(backend):
    given = made()
    for part, size in (("color", (2, 30, 48, 3)), ("depth", (2, 61, 48))):
        kind = getattr(given, part).dtype
        wrong = given._replace(**{part: np.zeros(size, kind)})
        with pytest.raises(CalibrationError, match=rf"images have 48x{size[1]} .* calibration of"):
            detect(wrong, backend=backend)
    aligned = given._replace(calibration=Calibration(given.calibration.image))
    with pytest.raises(CalibrationError, match="depth images"):
        detect(aligned._replace(depth=given.depth[:, :30]), backend=backend)


@pytest.mark.parametrize("backend", ["reference", "jax"])
def test_arrays_of_a_batch_must_have_equal_length(backend):
    given = made(3)
    for wrong in (given._replace(depth=given.depth[:2]), given._replace(plane=level(1))):
        with pytest.raises(InputError, match="one entry per frame"):
            detect(wrong, backend=backend)


def test_stages_refuse_images_of_another_size():
    given = made()
    pixels = np.zeros((2, 2, 1), np.int32)
    with pytest.raises(CalibrationError, match="depth images have 96x20 pixels"):
        stages.paper.align(given.depth[:, :20], *pixels, given.calibration)
    for color, depth in ((given.color[:, :30], given.depth), (given.color, given.depth[:, :30])):
        with pytest.raises(CalibrationError, match="images have 96x30 pixels"):
            stages.paper.features(color, depth, given.calibration, FeaturesConfig())


@pytest.mark.parametrize(("width", "height"), [(4097, 3), (3, 4097), (2, 60), (60, 2)])
def test_images_smaller_or_larger_than_kernels_support_are_refused(width, height):
    focal = float(max(width, height))
    camera = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    z = np.zeros((1, height, width), np.uint16)
    color = np.zeros((*z.shape, 3), np.uint8)
    config = Config(cluster=ClusterConfig(points=True))
    message = rf"{width}x{height} pixels, but the kernels take from 3 to 4096 .*--backend reference"
    with pytest.raises(ConfigError, match=message):
        stages.paper.features(color, z, Calibration(camera), config.features)
    with pytest.raises(ConfigError, match=message):
        detect(frames(Calibration(camera), color, z, plane=level(1)), config)


def test_more_points_than_kernels_support_are_refused():
    many = points(np.zeros(8193, int), np.full(8193, 1000))
    with pytest.raises(ConfigError, match="8193 points"):
        stages.paper.cluster(many, 0.001, Config())
    labels = Labels(np.zeros((1, 8193), np.int32), np.ones(1, np.int32))
    with pytest.raises(ConfigError, match="8193 points"):
        stages.paper.footprint(many, labels, level(1), 0.001, Config())


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        (ClusterConfig, ("depth_gap_m", "lateral_gap_m", "robot_width_m", "min_points")),
        (FootprintConfig, ("vertex_threshold_m", "trim", "side_band_per_m", "near_band_per_m2")),
        (FootprintConfig, ("extension_m", "margin_m", "margin_per_m2")),
        (FeaturesConfig, ("min_distance",)),
    ],
)
def test_settings_that_overflow_integers_are_refused(settings, names):
    for name in names:
        for value in (1e10, float("inf"), float("nan"), -1):
            with pytest.raises(ConfigError, match=name.replace("_", "-")):
                settings(**{name: value})


@pytest.mark.parametrize(
    ("settings", "given"),
    [
        (GroundConfig, {"step_height_m": 30}),
        (FloorConfig, {"max_shift_m": 70, "drop_m": 50, "gap_m": 500}),
        (SurfaceConfig, {"step_m": 30, "crease_m": 10, "bent_m": 200}),
        (ObstacleConfig, {"lateral_gap_m": 1500, "forward_gap_m": 800, "depth_gap_m": 120}),
        (ObstacleConfig, {"contact_m": 100, "bend_m": 150, "side_m": 1000, "min_size_m": 50}),
        (ClusterConfig, {"depth_gap_m": 100, "lateral_gap_m": 400, "robot_width_m": 400}),
        (FootprintConfig, {"vertex_threshold_m": 30, "extension_m": 200}),
        (FootprintConfig, {"margin_m": 30, "long_m": 3000}),
    ],
)
def test_lengths_given_in_millimetres_are_refused(settings, given):
    """The default lengths in millimetres are outside of the ranges in metres."""
    for name, value in given.items():
        with pytest.raises(ConfigError, match=rf"{name.replace('_', '-')} must be .* m; see --"):
            settings(**{name: float(value)})


@pytest.mark.parametrize(
    ("settings", "name", "least", "largest"),
    [
        (FeaturesConfig, "max_corners", 1, 8192),
        (FeaturesConfig, "quality_level", 5e-324, 1.0),
        (FloorConfig, "max_turn_deg", 0.0, 10.0),
        (FloorConfig, "max_cells", 100, (1 << 63) - 1),
        (GroundConfig, "min_depth_m", 0.0, math.nextafter(4.0, 0)),
        (GroundConfig, "max_depth_m", math.nextafter(0.15, 1), 65.535),
        (GroundConfig, "max_height_m", math.nextafter(0.05, 1), 10.0),
        (GroundConfig, "noise_per_m", 0.0, math.nextafter(1.0, 0)),
        (GroundConfig, "sample_frames", 1, (1 << 63) - 1),
        (GroundConfig, "window_s", 0.0, 1e9),
        (SurfaceConfig, "beyond", 1.0, 4.0),
        (SurfaceConfig, "cell_rad", 1e-4, 0.1),
        (SurfaceConfig, "crease_cells", 1, 16),
        (SurfaceConfig, "crease_margin", 0, 16),
        (SurfaceConfig, "min_cells", 1, 8192),
        (ObstacleConfig, "min_cells", 1, 8192),
        (ClusterConfig, "min_points", 0, 8192),
        (FootprintConfig, "trim", 0, 8192),
        (FootprintConfig, "extension_m", 5e-324, 5.0),
    ],
)
def test_settings_are_accepted_up_to_their_bounds(settings, name, least, largest):
    for bound, side in ((least, -1), (largest, 1)):
        settings(**{name: bound})
        beyond = bound + side if isinstance(bound, int) else math.nextafter(bound, side * math.inf)
        with pytest.raises(ConfigError):
            settings(**{name: beyond})


@pytest.mark.parametrize(
    ("low", "high", "bounds"),
    [(50.0, 100.0, (50, 100)), (100.9, 50.9, (50, 100)), (-math.inf, math.inf, (-1, 2047))],
)
def test_bounds_of_canny_must_be_integers_in_order(low, high, bounds):
    assert FeaturesConfig(canny_low=low, canny_high=high).canny_bounds == bounds


def test_backends_agree_at_the_largest_accepted_settings():
    """Backends are compared for obstacles made of points and of surfaces."""
    config = Config(
        features=FeaturesConfig(min_distance=8192.0),
        cluster=ClusterConfig(True, 5.0, 10.0, 8192),
        footprint=FootprintConfig(1.0, 8192, 1.0, 1.0, 5.0, 1.0, 1.0, 65.535),
    )
    widest = SurfaceConfig(0.02, 1.0, 1.0, 16, 1.0, 1.0, 16, 8192, 512, 1.0, 4.0)
    surfaces = replace(config, cluster=ClusterConfig(), surface=widest)
    largest = ObstacleConfig("surfaces", 10.0, 10.0, 5.0, 1.0, 5.0, 10.0, 5.0, 8192)
    obstacles = replace(config, cluster=ClusterConfig(), obstacle=largest)
    for each in (config, surfaces, obstacles):
        assert_equal(detect(made(), each), detect(made(), each, backend="reference"))


BACKENDS = pytest.mark.parametrize("backend", ["jax", "reference"])


@BACKENDS
@pytest.mark.parametrize(
    ("size", "focal", "cell_rad", "error"),
    [
        ((600, 10), 300.0, 0.0033, "600x10 cells.*raise --surface.cell-rad"),
        ((64, 8), 2000.0, 0.0078, "cells of 16x16.*lower --surface.cell-rad"),
        ((300, 300), 1300.0, 0.1, "cells of 130x130.*lower --surface.cell-rad"),
        ((4097, 31), 4000.0, 0.0078, "maximum of 4096 columns"),
    ],
)
def test_more_cells_than_kernels_support_are_refused(backend, size, focal, cell_rad, error):
    width, height = size
    camera = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    color, depth = (
        np.zeros((1, height, width, 3), np.uint8),
        np.zeros((1, height, width), np.uint16),
    )
    given = frames(Calibration(camera), color, depth)
    config = Config(surface=SurfaceConfig(cell_rad=cell_rad))
    with pytest.raises(ConfigError, match=error):
        detect(given, config, backend=backend)
    with pytest.raises(ConfigError, match=error):
        find_floors(given, config, backend=backend)


@BACKENDS
def test_the_widest_depth_image_is_accepted(backend):
    camera = Intrinsics(4096, 33, 4000.0, 4000.0, 2048.0, 16.5)
    depth = np.full((1, 33, 4096), 2000, np.uint16)
    given = frames(Calibration(camera), np.zeros((1, 33, 4096, 3), np.uint8), depth)
    assert detect(given, backend=backend).scene.contour.shape == (1, 128, 132, 2)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_planes_that_are_not_finite_are_refused(value):
    plane = level(2)._replace(height=np.array([0.4, value]))
    with pytest.raises(InputError, match="is not finite"):
        detect(made()._replace(plane=plane))
    given = made()._replace(plane=plane._replace(valid=np.array([True, False])))
    found, want = (detect(given, backend=name) for name in ("jax", "reference"))
    assert_equal(found.obstacles, want.obstacles)
    assert np.array_equal(found.num_obstacles, want.num_obstacles)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        *((part, value) for part in ("pitch", "roll", "ramp_slope") for value in (np.nan, -np.inf)),
        ("ramp_start", np.nan),  # infinity: no ramp
    ],
)
def test_a_plane_with_one_value_that_is_not_finite_is_refused(part, value):
    given, plane = made(), level(2)
    wrong = plane._replace(**{part: np.array([0.0, value])})
    with pytest.raises(
        InputError, match="height, pitch, roll or ramp of a valid plane is not finite"
    ):
        check_frames(given._replace(plane=wrong), Config())
    check_frames(given._replace(plane=wrong._replace(valid=np.array([True, False]))), Config())
    check_frames(given._replace(plane=plane), Config())


def test_a_batch_has_at_most_65536_frames():
    one = made(1)

    def many(count: int) -> Frames:
        images = one.color, one.depth
        color, depth = (np.broadcast_to(a, (count, *a.shape[1:])) for a in images)
        return one._replace(color=color, depth=depth, valid=np.ones(count, bool), plane=None)

    check_frames(many(1 << 16), Config())
    with pytest.raises(InputError, match=r"at most 65536 frames, got 65537"):
        check_frames(many((1 << 16) + 1), Config())


ANY = math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-45, 1e39, 1e308, -1e9, 1e5, 3.0
"""Numbers that damaged calibrations contain."""


def mutated(calibration: Calibration, rng: random.Random) -> Calibration:
    """Return the calibration with one to three numbers changed, by much or by little."""

    def other(value: float) -> float:
        return rng.choice([rng.choice(ANY), value * rng.choice([-1, 0.1, 0.5, 2, 10]), value + 1])

    for _ in range(rng.choice([1, 1, 2, 3])):
        name = rng.choice(["color", "depth"])
        camera, motion = getattr(calibration, name), calibration.color_from_depth
        assert camera is not None and motion is not None
        part = rng.choice([*camera._fields[2:6], "lens", "translation", "rotation", "unit"])
        if part == "unit":
            unit = other(calibration.depth_unit)
            calibration = calibration._replace(depth_unit=unit)
        elif part in ("translation", "rotation"):
            values = list(getattr(motion, part))
            at = rng.randrange(len(values))
            values[at] = other(values[at])
            motion = motion._replace(**{part: tuple(values)})
            calibration = calibration._replace(color_from_depth=motion)
        elif part == "lens":
            model, lens = rng.choice(list(LENSES.values()))
            lens = tuple(other(k) if rng.random() < 0.4 else k for k in lens)
            camera = camera._replace(distortion=model, coefficients=lens)
            calibration = calibration._replace(**{name: camera})
        else:
            camera = camera._replace(**{part: other(getattr(camera, part))})
            calibration = calibration._replace(**{name: camera})
    return calibration


def test_randomly_damaged_calibrations_are_refused_or_give_equal_results():
    """Unchecked, such numbers would lead kernels to indices outside of their arrays."""
    rng, count = random.Random(1), {"refused": 0, "used": 0}
    given = made(1)
    for _ in range(150):
        damaged = given._replace(calibration=mutated(given.calibration, rng))
        try:
            with np.errstate(all="ignore"):
                want = detect(damaged, backend="reference")
        except JaxdetError as error:
            with pytest.raises(type(error), match=re.escape(str(error))):
                detect(damaged)
            count["refused"] += 1
            continue
        assert_equal(detect(damaged), want)
        count["used"] += 1
    assert min(count.values()) > 30


@pytest.mark.parametrize(
    ("part", "value", "error"),
    [
        ("fx", 1e-45, "not calibrated.*--log.color-intrinsics"),
        ("cy", math.nan, "optical centre.*--log.color-intrinsics"),
        ("cy", -1e4, "optical centre.*far outside of the colour.*--log.color-intrinsics"),
        ("fx", 1e5, "fx 100000 and fy .* a factor of 4; pass --log.color-intrinsics"),
        ("coefficients", (math.inf,), "are implausible"),
        ("coefficients", (0.0, -1e5), "coefficients 0 -100000 are implausible"),
        ("coefficients", (0.1,) * 9, "are implausible"),
        ("distortion", "thin_prism", "'thin_prism' is unknown; use one of"),
    ],
)
def test_implausible_intrinsics_are_refused(part, value, error):
    given = made(1)
    camera = given.calibration.color._replace(**{part: value})
    with pytest.raises(CalibrationError, match=error):
        detect(given._replace(calibration=given.calibration._replace(color=camera)))


@pytest.mark.parametrize(("focal", "view"), [(309_000.0, "0.0593"), (1.0, "179.")])
def test_impossible_fields_of_view_are_rejected(focal, view):
    """The focal length is in micrometres, or the camera matrix is the identity."""
    camera = Intrinsics(320, 240, focal, focal, 159.0, 123.0)
    error = f"is {view}.* 320x240 pixels.*1° to 179°; pass --log.depth-intrinsics fx fy cx cy"
    with pytest.raises(CalibrationError, match=error):
        check_calibration(Calibration(camera))


@pytest.mark.parametrize(
    "camera",
    [
        Intrinsics(640, 240, 613.0, 306.5, 320.0, 119.5),  # 640x480, rows binned
        Intrinsics(200, 480, 613.0, 613.0, -120.0, 240.0),  # right part of 640x480
        Intrinsics(4096, 33, 4000.0, 4000.0, 2048.0, 16.5),  # a few rows
        Intrinsics(640, 480, 200.0, 200.0, 320.0, 240.0, Distortion.EQUIDISTANT, (0.0,) * 4),
        Intrinsics(1920, 1200, 9000.0, 9000.0, 960.0, 600.0),  # a long lens
    ],
    ids=["binned", "part", "rows", "fisheye", "narrow"],
)
def test_unusual_cameras_are_accepted(camera):
    check_calibration(Calibration(camera))


@pytest.mark.parametrize("axis", ["cx", "cy"])
def test_optical_centres_may_lie_one_image_size_outside(axis):
    """A crop of the outer third of an image has such a centre; farther ones are refused."""
    camera = Intrinsics(200, 480, 613.0, 613.0, 100.0, 240.0)
    size = camera.width if axis == "cx" else camera.height
    for center, off in ((-size, -1), (2 * size, 1)):
        check_calibration(Calibration(camera._replace(**{axis: float(center)})))
        with pytest.raises(CalibrationError, match="far outside of the depth images of 200x480"):
            check_calibration(Calibration(camera._replace(**{axis: float(center + off)})))


def test_field_of_view_is_that_of_the_cropped_image():
    part = Intrinsics(100, 100, 1.0, 1.0, 200.0, 200.0)  # a crop at the edge of a view of 180°
    with pytest.raises(CalibrationError, match=r"is 0\.286°"):
        check_calibration(Calibration(part))
    check_calibration(Calibration(part._replace(cx=50.0)))
    squeezed = Intrinsics(640, 480, 600.0, 150.0, 320.0, 240.0)
    check_calibration(Calibration(squeezed))  # a factor of 4 is accepted: rows binned by 4
    with pytest.raises(CalibrationError, match="factor of 4"):
        check_calibration(Calibration(squeezed._replace(fy=149.0)))


def test_implausible_extrinsics_and_depth_units_are_refused():
    given = made(1)
    motion = given.calibration.color_from_depth
    assert motion is not None
    far = motion._replace(translation=(1e39, 0.0, 0.0))
    mirror = motion._replace(rotation=(-1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0))
    for part, value, error in (
        ("color_from_depth", far, "1e.39 m from the colour camera.*--log.color-from-depth"),
        (
            "color_from_depth",
            mirror,
            "rotation from depth to colour camera is not a rotation matrix",
        ),
        ("depth_unit", 1e-9, "got 1e-09 m.*--log.depth-unit-m"),
        ("depth_unit", math.nan, "--log.depth-unit-m"),
    ):
        wrong = given.calibration._replace(**{part: value})
        with pytest.raises(CalibrationError, match=error):
            detect(given._replace(calibration=wrong))
    apart = motion._replace(translation=(0.0, 0.66, 0.0))
    wrong = given.calibration._replace(color_from_depth=apart, depth_unit=1e-5)
    with pytest.raises(CalibrationError, match=r"maximum of 0\.65535 m with a depth"):
        detect(given._replace(calibration=wrong))
    for part, error in (
        ("color", "needs a colour camera"),
        ("color_from_depth", "transform from depth to colour camera is missing"),
    ):
        wrong = given.calibration._replace(**{part: None})
        with pytest.raises(CalibrationError, match=error):
            detect(given._replace(calibration=wrong, color=None))


@BACKENDS
def test_images_must_be_arrays_of_the_right_dtype(backend):
    given = made(1)
    for part, value, error in (
        (
            "color",
            given.color.astype(np.float32),
            r"expected colour images \(B, H, W, 3\) uint8, got float32",
        ),
        ("color", given.color[..., 0], r"got uint8 of shape \(1, 60, 96\)"),
        (
            "depth",
            given.depth.astype(np.int32),
            r"expected depth images \(B, H, W\) uint16, got int32",
        ),
        ("depth", given.depth.tolist(), "list"),
        ("depth", np.ma.masked_equal(given.depth, 0), r"masked.*pass images\.filled\(0\)"),
    ):
        wrong = given._replace(**{part: value})
        with pytest.raises(InputError, match=error):
            detect(wrong, backend=backend)
        if part == "depth":
            with pytest.raises(InputError, match=error):
                find_floors(wrong, backend=backend)
            with pytest.raises(InputError, match=error):
                estimate_plane(wrong, backend=backend)


def test_detect_refuses_objects_that_are_not_frames():
    for function in (detect, find_floors, estimate_plane):
        with pytest.raises(InputError, match="frames: expected Frames"):
            function("frames")


def test_footprints_are_computed_in_any_depth_unit():
    obstacles = detect(made(1)).obstacles
    assert np.isfinite(metric.rectangles(obstacles, 2**40, preset("wheeled").footprint)).all()


@BACKENDS
def test_preset_paper_requires_a_plane(backend):
    given = made(1)._replace(plane=None)
    with pytest.raises(InputError, match=r"needs a floor plane.*jaxdet\.estimate_plane"):
        detect(given, preset("paper"), backend=backend)
    plane = estimate_plane(given, preset("paper"), backend=backend).plane
    assert detect(given._replace(plane=plane), preset("paper"), backend=backend).points


@BACKENDS
def test_preset_paper_requires_colour(backend):
    given = made(1)._replace(color=None)
    assert detect(given, backend=backend).num_obstacles.shape == (1,)
    with pytest.raises(InputError, match="the preset paper needs colour images"):
        detect(given, preset("paper"), backend=backend)


def test_detect_refuses_transformations_of_jax():
    import jax

    given = made(2)

    def of(depth):
        return detect(given._replace(depth=depth)).has_depth

    for transformed in (jax.jit(of), jax.vmap(lambda depth: of(depth[None]))):
        with pytest.raises(InputError, match=r"call detect outside of jax\.jit"):
            transformed(given.depth)


@pytest.mark.parametrize("height", [1e4, 1e9])
def test_planes_of_any_height_are_accepted(height):
    given = made()._replace(plane=level(2, height))
    assert_equal(detect(given), detect(given, backend="reference"))


@BACKENDS
def test_with_source_none_no_floor_is_removed(backend):
    """Planes in the frames and in the configuration are ignored."""
    config = Config(GroundConfig(source="none", camera_height_m=0.5, camera_pitch_rad=0.0))
    given = made()._replace(plane=level(2))
    found = detect(given, config, backend=backend)
    fit = metric.floors(found.scene, 0.001)
    assert not fit.plane.valid.any() and not fit.own.any()
    shallow = given._replace(depth=np.ones_like(given.depth))
    assert find_floors(shallow, config, backend=backend).found[:, 6].tolist() == [0, 0]
