"""Simulated cameras: noise, holes, shadows, exposure, lights."""

import cv2
import numpy as np
import pytest

from jaxdet.sim import LIGHTS, ColorSensor, DepthSensor, sample_frames
from jaxdet.sim.exposure import expose, illuminate
from jaxdet.sim.sensor import Surface, fatten, is_shadowed, match_quality, measure_depth
from jaxdet.types import Intrinsics

EXACT = DepthSensor(enabled=False)
CAMERA = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)


def test_depth_noise_grows_with_z_squared():
    sensor = DepthSensor(dropout=0, speckle=0)
    for z in (0.5, 1.0, 2.0, 4.0):
        ideal = np.full((480, 640), z)
        depth = measure_depth(ideal, CAMERA, sensor, np.random.default_rng(1))
        got = depth[depth > 0] * 0.001
        noise = np.hypot(sensor.noise_px, sensor.step_px / np.sqrt(12))
        expected = np.hypot(z * z * noise / (384.5 * sensor.baseline_m), 0.001 / np.sqrt(12))
        assert got.std() == pytest.approx(expected, rel=0.1)
        assert got.mean() == pytest.approx(z, rel=2e-3)
    neighbours = np.corrcoef(depth[:, 100:-1].ravel(), depth[:, 101:].ravel())[0, 1]
    assert neighbours > 0.5


def test_depth_has_holes():
    sensor, rng = DepthSensor(), np.random.default_rng(0)
    lost = (measure_depth(np.full((480, 640), 2.0), CAMERA, sensor, rng)[:, 20:] == 0).mean()
    assert lost == pytest.approx(sensor.dropout + sensor.speckle, rel=0.3)
    for z in (0.15, 14.0, 80.0, np.inf):
        assert not measure_depth(np.full((60, 80), z), CAMERA, sensor, rng).any()
        exact = measure_depth(np.full((60, 80), z), CAMERA, EXACT, rng)
        assert (exact == (0 if z > 65.535 else round(z * 1000))).all()


def test_stereo_shadow_is_to_the_left_of_the_nearer_object():
    disparity = np.full((1, 100), 5.0)
    disparity[0, 50:60] = 20.0
    hidden = np.flatnonzero(is_shadowed(disparity)[0])
    # The object covers columns 30-39 of the right image, the positions of floor columns 35-44.
    assert hidden.tolist() == [*range(5), *range(36, 50)]


def test_nearer_objects_are_smeared():
    disparity = np.full((60, 80), 5.0)
    disparity[20:40, 30:50] = 20.0
    grown = fatten(disparity, 1.5, np.random.default_rng(0)) == 20
    assert grown[20:40, 30:50].all() and 20 * 20 + 60 < grown.sum() < 26 * 26
    assert fatten(disparity, 0.0, np.random.default_rng(0)) is disparity


def surface(other, reflectance, *, gloss=0.0, lux=500.0):
    shape = (60, 80)
    flat = np.full(shape, reflectance, np.float32)
    flat[:, 40:] = other
    return Surface(flat, np.full(shape, gloss, np.float32), np.ones(shape, np.float32), lux)


def holes(sight, z):
    depth = measure_depth(
        np.full((60, 80), z), CAMERA, DepthSensor(), np.random.default_rng(1), sight
    )
    return (depth[:, 20:35] == 0).mean()


def test_dark_shiny_and_bare_surfaces_have_holes():
    bright = surface(0.5, 0.5)
    assert holes(bright, 1.5) < 0.03
    assert holes(surface(0.5, 0.004), 3.0) > holes(surface(0.5, 0.05), 3.0) + 0.1
    assert holes(surface(0.5, 0.5, gloss=0.9), 2.0) > 0.5
    # In sunlight the pattern of the projector is invisible, and a bare wall has no texture.
    assert holes(surface(0.5, 0.5, lux=30_000.0), 3.0) > 0.5
    speckled = surface(0.5, 0.5, lux=30_000.0)
    speckled.reflectance[::2, ::2] *= 1.2
    assert holes(speckled, 3.0) < 0.03
    near, far = (match_quality(bright, np.full((60, 80), z)) for z in (1.0, 3.0))
    assert (near >= far).all()


def grey_plate(level, light, **changes):
    color = np.full((480, 640, 3), level, np.float32)
    shine = np.zeros_like(color)
    shine[..., 0] = 0.8
    return expose(
        (color, shine), CAMERA, LIGHTS[light], 0.8, ColorSensor(**changes), np.random.default_rng(0)
    )


def test_exposure_and_noise_follow_their_equations():
    linear = illuminate(np.full((1, 1, 3), 128.0), np.zeros((1, 1, 3)), LIGHTS["normal"], 0.8)
    assert linear[0, 0, 0] == pytest.approx(0.9 * 0.21586 * 250, rel=1e-3)
    plain = {"vignetting": 0.0, "blur_px": 0.01, "smooth_px": 0.0, "contrast": 1.0}
    for light in LIGHTS:
        shot = grey_plate(128, light, **plain).astype(float)
        # The mean is 0.18 of full well in sRGB if the exposure is sufficient.
        if light != "dim":
            assert shot.mean() == pytest.approx(117.5, abs=2 if light != "weaker" else 12)
        else:
            assert shot.mean() < 110
    # 500 lx: E_s = 500 x 0.194 / 16, t = 1/30 s; photons and read noise, then the slope of sRGB.
    electrons = 500 * 0.9 * 0.21586 / 16 * 4.1e15 * (3.15e-6) ** 2 * 0.3 / 30
    relative = np.hypot(np.sqrt(electrons), 6) / electrons
    level = 0.18
    slope = 255 * 1.055 / 2.4 * level ** (1 / 2.4)
    noise = grey_plate(128, "normal", **plain).astype(float).std()
    assert noise == pytest.approx(relative * slope, rel=0.15)


def test_rotation_of_the_camera_smears_the_image_sideways():
    color = np.full((480, 640, 3), 60.0, np.float32)
    color[:, 320:] = 200
    surface = color, np.zeros_like(color)

    def shoot(smear):
        rng = np.random.default_rng(0)
        return expose(surface, CAMERA, LIGHTS["dim"], 1.0, ColorSensor(), rng, smear)

    still, turned = shoot(0.0), shoot(8.0)
    steps = [np.abs(np.diff(i.mean((0, 2)))).max() for i in (still, turned)]
    assert steps[1] < 0.5 * steps[0]


def test_lights_are_ordered_by_brightness():
    brightness, edges = {}, {}
    for light in LIGHTS:
        shots = [f.color for f in sample_frames("mixed", 2, 2, light=light)]
        grey = [cv2.cvtColor(shot, cv2.COLOR_RGB2GRAY) for shot in shots]
        brightness[light] = np.mean(grey)
        edges[light] = np.mean([(cv2.Canny(g, 100, 200) > 0).mean() for g in grey])
    assert brightness["dim"] < 0.7 * brightness["weaker"] <= 1.1 * brightness["normal"]
    assert edges["dim"] < 0.6 * edges["weaker"] and edges["weaker"] < edges["normal"]
    assert edges["dim"] > 0
