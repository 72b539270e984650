"""ramp: the floor's limit on hinged planes, and ramps found in made depth images."""

from dataclasses import replace

import numpy as np
import pytest

from jaxdet import open_log, reference, stages
from jaxdet.cli.report import ground_text
from jaxdet.config import Config, GroundConfig
from jaxdet.engine.planes import decide_planes
from jaxdet.errors import InputError
from jaxdet.floor import fit_floor, fit_ramp
from jaxdet.pipeline import estimate_ramp
from jaxdet.plane import (
    down_vector,
    flat_plane,
    floor_limits,
    forward_vector,
    unknown_plane,
)
from jaxdet.ramp import Floor
from jaxdet.sim import SimConfig, write_log
from jaxdet.stages._ground import tables
from jaxdet.types import Calibration, Frames, GroundPlane, Intrinsics
from tests.scenes import D435_COLOR, aligned, assert_equal, level, noise_depth, resized, small

CAMERA = Intrinsics(24, 32, 22.0, 22.0, 11.5, 10.0)
CALIBRATION = Calibration(D435_COLOR)
WINDOWS = GroundConfig(window_s=0.1)


def ramped(plane: GroundPlane, start: float, slope: float) -> GroundPlane:
    full = np.full(plane.height.shape, 1.0)
    return plane._replace(ramp_start=start * full, ramp_slope=slope * full)


def rays(camera: Intrinsics) -> np.ndarray:
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1)


# by hand


@pytest.mark.parametrize("slope", [-0.3, -0.07, 0.05, 0.2])
@pytest.mark.parametrize("start", [0.3, 0.9, 2.5])
@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (0.2, 0.1), (-0.1, 0.0), (0.8, -0.2)])
def test_limit_is_before_the_first_depth_on_the_floor(slope, start, pitch, roll):
    """At every pixel all depths up to 6 m are put beside the floor's height where they are."""
    plane = ramped(level(1, 0.35, pitch, roll), start, slope)
    [limit], _ = floor_limits(CAMERA, plane, GroundConfig(), 0.001)
    down = down_vector(plane.pitch, plane.roll)
    along = rays(CAMERA)
    z = np.arange(1, 6001) * 0.001
    fall, ahead = along @ down[0], along @ forward_vector(down)[0]
    floor = slope * np.maximum(ahead[..., None] * z - start, 0.0)
    over = 0.35 - fall[..., None] * z - floor - (0.05 + 0.003 * z)
    first = np.where((over < 0).any(axis=-1), (over < 0).argmax(axis=-1) + 1, 65536)
    flat, _ = floor_limits(CAMERA, level(1, 0.35, pitch, roll), GroundConfig(), 0.001)
    never = fall + 0.003 + slope * ahead <= 0  # falls less than the ramp
    judged = np.abs(over).min(axis=-1) > 1e-9  # no tie, which rounding decides
    judged &= ~never if slope < 0 else True
    np.testing.assert_array_equal(*(np.minimum(a[judged], 6000) for a in (limit, first - 1)))
    if slope < 0:
        before = 0.35 * ahead <= start * fall
        np.testing.assert_array_equal(limit[never & before], flat[0][never & before])
        assert (limit[never & ~before] == 65535).all()
    assert (limit <= flat[0]).all() if slope > 0 else (limit >= flat[0]).all()


def scene(
    pitch: float, roll: float, seed: int, start: float = np.inf, slope: float = 0.0
) -> np.ndarray:
    """Depth of a floor with a ramp, a wall and a box, noisy, with holes, ``(1, H, W)``."""
    rng = np.random.default_rng(seed)
    along = rays(D435_COLOR)
    down = down_vector(np.array([pitch]), np.array([roll]))
    fall, ahead = along @ down[0], along @ forward_vector(down)[0]

    def meets(height: float, s: np.ndarray) -> np.ndarray:
        return np.where(s > 1e-3, height / np.maximum(s, 1e-3), np.inf)

    z = meets(0.4, fall)
    if np.isfinite(start):
        ramp = meets(0.4 + slope * start, fall + slope * ahead)
        z = np.minimum(z, ramp) if slope > 0 else np.maximum(z, ramp)
    z = np.minimum(z, 3.8 * (1 + 0.2 * along[..., 0]))
    left, top = rng.integers(50, 400), rng.integers(20, 100)
    box = z[top : top + 200, left : left + 120]
    box[...] = np.minimum(box, 1.1)
    z = z + rng.normal(0, 1, z.shape) * 0.002 * z * z
    z[rng.random(z.shape) < 0.2] = 0
    return np.clip(np.rint(1000 * z), 0, 65535).astype(np.uint16)[None]


RAMPS = pytest.mark.parametrize("degrees", [-6, -3, 3, 8])
MOUNTS = pytest.mark.parametrize(("pitch", "roll"), [(0.15, 0.0), (0.35, 0.15)])


@RAMPS
@MOUNTS
def test_a_ramp_before_a_known_mount_is_found(pitch, roll, degrees):
    slope, known = np.tan(np.radians(degrees)), level(1, 0.4, pitch, roll)
    found = fit_ramp(
        scene(pitch, roll, degrees + 9, 1.0, slope), known, CALIBRATION, GroundConfig()
    )
    assert abs(np.degrees(np.arctan(found.ramp_slope[0])) - degrees) < 0.5
    assert abs(found.ramp_start[0] - 1.0) < 0.12
    assert_equal(found._replace(ramp_start=known.ramp_start, ramp_slope=known.ramp_slope), known)


@RAMPS
@MOUNTS
def test_a_ramp_is_found_with_the_plane(pitch, roll, degrees):
    """From the depth alone, the plane may be the ramp's where little is seen before it."""
    slope = np.tan(np.radians(degrees))
    z = scene(pitch, roll, degrees + 9, 1.0, slope)
    plane = fit_floor(z, CALIBRATION, WINDOWS).plane
    found = Floor(
        down_vector(plane.pitch, plane.roll)[0],
        *(float(a[0]) for a in (plane.height, plane.ramp_start, plane.ramp_slope)),
    )
    known = Floor(down_vector(*np.array([[pitch], [roll]]))[0], 0.4, 1.0, slope)
    points = (rays(D435_COLOR) * (z[0, ..., None] * 0.001))[z[0] > 0]
    floor = points[(np.abs(known.below(points)) < 0.02) & (points[:, 2] < 3)]
    assert len(floor) > 20_000
    assert np.quantile(np.abs(found.below(floor) - known.below(floor)), 0.99) < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_no_ramp_is_found_on_a_level_floor(seed):
    z = scene(0.2, 0.05, seed)
    for found in (
        fit_ramp(z, level(1, 0.4, 0.2, 0.05), CALIBRATION, GroundConfig()),
        fit_floor(z, CALIBRATION, WINDOWS).plane,
    ):
        assert found.ramp_start.tolist() == [np.inf] and found.ramp_slope.tolist() == [0.0]


def test_one_plane_for_a_log_has_no_ramp():
    z = scene(0.35, 0.15, 0, 1.0, 0.1)
    assert fit_floor(z, CALIBRATION, GroundConfig()).plane.ramp_start.tolist() == [np.inf]
    assert fit_floor(z, CALIBRATION, WINDOWS).plane.ramp_start.tolist() != [np.inf]


@pytest.mark.parametrize("z", [0, 900])
def test_nothing_to_see_is_no_ramp(z):
    depth = np.full((2, 480, 640), z, np.uint16)
    for given in (depth, depth[:0]):
        for plane in (level(1, 0.4, 0.2), unknown_plane(1)):
            assert_equal(fit_ramp(given, plane, CALIBRATION, GroundConfig()), plane)


@pytest.mark.parametrize("seed", range(3))
def test_what_hides_the_floor_is_no_ramp(seed):
    """A box near by, and behind it a wide one whose front a ramp from the first would cut."""
    z = scene(0.25, 0.0, seed).astype(np.float64) / 1000
    along = rays(D435_COLOR)
    down = down_vector(np.array([0.25]), np.array([0.0]))
    fall, ahead = along @ down[0], along @ forward_vector(down)[0]
    for distance, low, high in ((1.14, -0.3, 0.3), (2.9, -0.9, 0.9)):
        at = distance / np.maximum(ahead, 1e-3)
        box = (at * along[..., 0] > low) & (at * along[..., 0] < high)
        box &= (at * fall < 0.4) & (at * fall > 0.05)
        z = np.where(box & (z > 0), np.minimum(z, at), z)
    depth = np.rint(1000 * z).astype(np.uint16)
    plain = level(1, 0.4, 0.25)
    assert_equal(fit_ramp(depth, plain, CALIBRATION, GroundConfig()), plain)
    found = fit_floor(depth, CALIBRATION, WINDOWS).plane
    assert found.ramp_start.tolist() == [np.inf] and abs(found.height[0] - 0.4) < 0.02


def test_a_ramp_is_looked_for_on_a_plane():
    z = scene(0.2, 0.05, 0)
    zero, one = np.zeros(1, np.int64), np.ones(1, bool)
    frames = Frames(np.zeros((1, 480, 640, 3), np.uint8), z, CALIBRATION, zero, zero, zero, one)
    with pytest.raises(InputError, match="without a plane"):
        estimate_ramp(frames, backend="reference")
    with pytest.raises(InputError, match="1 depth images, 2 planes"):
        estimate_ramp(frames._replace(plane=level(2)), backend="reference")
    plane = level(1, 0.4, 0.2, 0.05)
    assert_equal(estimate_ramp(frames._replace(plane=plane), backend="reference"), plane)


def test_a_run_in_time_windows_finds_the_ramp_before_a_robot_whose_mount_is_known(tmp_path):
    path = tmp_path / "ramp.mcap"
    sim = SimConfig(scene="mixed", seed=3, frames=4, width=320, height=240, slope_rad=0.07)
    write_log(path, sim)
    plain = Config()
    uneven = replace(plain, ground=replace(plain.ground, window_s=0.05, sample_frames=1))
    with open_log(str(path)) as log:
        mount, looked = (decide_planes(log, config, "reference") for config in (plain, uneven))
        planes = looked.of(log.stamps_ns)
        assert_equal(planes, looked.of(log.stamps_ns))  # of the stamps alone
    assert len(mount.records) == 1 and mount.records[0].ramp_start_m is None
    assert "ramp" not in ground_text(mount.records)
    assert {record.source for record in looked.records} == {"tf"}
    assert f"{len(looked.records)} a ramp ahead" in ground_text(looked.records)
    np.testing.assert_allclose(np.arctan(planes.ramp_slope), 0.07, atol=0.01)
    flat = mount.of(np.zeros(4, np.int64))
    assert_equal(planes._replace(ramp_start=flat.ramp_start, ramp_slope=flat.ramp_slope), flat)


# twin


@pytest.mark.parametrize("slope", [-0.1, 0.1])
def test_twin(device, slope):
    camera = resized(small().color, 97, 61)
    z = noise_depth(3, camera)
    plane = ramped(level(3, 0.5, 0.2, -0.1), 0.8, slope)
    plane.ramp_start[-1], plane.height[0] = np.inf, 0.6
    given = aligned(z), plane, Calibration(camera), Config()
    assert_equal(stages.ground(*given), reference.ground(*given))
    assert floor_limits(camera, plane, Config().ground, 0.001)[0].shape[0] == 3
    assert tables(*given[1:])[0].shape[0] == 4
    flat = flat_plane(plane.height, plane.pitch, plane.roll)
    changed = reference.ground(*given).mask != reference.ground(given[0], flat, *given[2:]).mask
    assert changed[:2].any(axis=(1, 2)).all() and not changed[2].any()
