"""Errors of regions of a depth image: bowing, margins, patches, reflections."""

import cv2
import numpy as np
import pytest

from jaxdet.sim import D435_LIKE, DepthSensor, SimConfig
from jaxdet.sim.appearance import BRICK_WALL, CLEAR_GLASS, EPOXY, Texture
from jaxdet.sim.frames import simulate_frame
from jaxdet.sim.lens import bend
from jaxdet.sim.patches import chosen, patches
from jaxdet.sim.render import render
from jaxdet.sim.robot import mount
from jaxdet.sim.scene import Box, Path, Scene, Wall
from jaxdet.sim.sensor import Surface, measure_depth
from jaxdet.types import Intrinsics

CAMERA = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)
CONSTANT = 384.5 * 0.05
QUIET = {"dropout": 0.0, "speckle": 0.0, "noise_px": 0.0}


def errors_at(z, sensor, specimen=0, seed=0):
    """Return measured minus true depth [m], NaN in holes."""
    rng = np.random.default_rng(seed)
    depth = measure_depth(np.full((480, 640), z), CAMERA, sensor, rng, specimen=specimen)
    return np.where(depth > 0, depth * 0.001 - z, np.nan)


def test_a_bow_is_smooth_and_grows_with_z_squared():
    sensor = DepthSensor(**QUIET, bow=0.05)
    far, near = errors_at(4.0, sensor), errors_at(1.5, sensor)
    assert 0.02 < np.nanmax(np.abs(far)) / 4 < 0.07
    core = slice(40, -40), slice(40, -40)
    ratio = np.nanstd(far[core]) / np.nanstd(near[core])
    assert ratio == pytest.approx((4 / 1.5) ** 2, rel=0.15)
    # Neighbours agree within a step of the disparity, which is 2.6 cm at 4 m.
    assert np.nanmax(np.abs(np.diff(far[core], axis=1))) < 0.03
    np.testing.assert_array_equal(far, errors_at(4.0, sensor, seed=5))
    assert np.nanstd(far - errors_at(4.0, sensor, specimen=1)) > 0.01


def test_image_margins_have_holes_and_depth_distortion():
    sensor = DepthSensor(**QUIET, margin=0.1, margin_bend_px=4.0, margin_dropout=0.5)
    rng = np.random.default_rng(0)
    error, torn = bend((480, 640), CONSTANT, sensor, rng, 3)
    assert np.max(np.abs(error[:, 64:-64])) == 0 and not torn[:, 64:-64].any()
    for outer in (error[:, 0], error[:, -1]):
        assert -0.3 * 4 <= outer[0] <= 4 and np.ptp(outer) == 0
    outer = np.hstack([torn[:, :30], torn[:, -30:]])
    assert outer.mean() == pytest.approx(0.5, abs=0.1)
    # The error grows outwards in a margin.
    assert (np.diff(np.abs(error[0, -64:])) >= 0).all()
    assert not np.any(bend((480, 640), CONSTANT, DepthSensor(), rng, 3))


def test_patches_have_the_given_fraction_and_size():
    for size in (6, 20):
        values = patches((480, 640), size, np.random.default_rng(1))
        for share in (0.1, 0.5):
            spots = chosen(share, values)
            assert spots.mean() == pytest.approx(share, abs=0.05)
        count, _ = cv2.connectedComponents(chosen(0.1, values).astype(np.uint8))
        assert count > (150 if size == 6 else 15) and (size == 6 or count < 100)


def test_depth_errors_scale_with_the_parameter_of_the_sensor():
    assert DepthSensor().with_errors(0.0) == DepthSensor()
    assert DepthSensor().with_errors(1.0) == D435_LIKE
    for scale in (1.0, 2.0, 4.0):
        worse = DepthSensor().with_errors(scale)
        assert worse.noise_px == pytest.approx(0.08 * (1 + scale / 2))
        lost = np.isnan(errors_at(2.0, worse)[:, 100:-100]).mean()
        assert lost == pytest.approx(worse.dropout + worse.speckle, rel=0.35)


def room(*things, floor):
    wall = Wall((3.05, -20.0), (3.05, 20.0), 4.0, texture=BRICK_WALL)
    return Scene(boxes=things, walls=(wall,), floor=floor, path=Path(length=0.0))


def test_a_glossy_floor_mirrors_objects_on_it():
    T = mount(0.5, 0.3, 0.0)
    scene = room(floor=EPOXY)
    view = render(scene, CAMERA, T, light=None)
    floor = view.obstacle_id == 0
    assert view.mirrored is not None and (np.isnan(view.mirrored) == ~floor).all()
    # The mirror image of the wall continues below the floor, at x = 3 on the ray of the camera.
    v, u = np.nonzero(floor & np.isfinite(view.mirrored))
    x = T[0, 1] * (v - CAMERA.cy) / CAMERA.fy + T[0, 2] + T[0, 0] * (u - CAMERA.cx) / CAMERA.fx
    np.testing.assert_allclose(view.mirrored[v, u] * x, 3.0, rtol=1e-6)
    assert (view.mirrored[floor] > view.depth[floor]).all()
    matt = render(room(floor=Texture("plain")), CAMERA, T, light=None)
    assert matt.mirrored is None and matt.behind is None


def measured(scene, sensor, seed=2):
    config = SimConfig(frames=1, sensor=sensor, seed=seed, depth_form="aligned")
    frame = simulate_frame(config, scene, 0)
    return frame, frame.aligned * 0.001


def test_reflections_are_ghosts_below_the_floor():
    scene = room(floor=EPOXY)
    quiet = DepthSensor(**QUIET, reflection=1.0)
    frame, depth = measured(scene, quiet)
    floor = (frame.truth.obstacle_id == 0) & (depth > 0)
    ghost = floor & (depth > 1.1 * frame.truth.depth)
    assert 0.03 < ghost.sum() / floor.sum() < 0.5
    assert frame.truth.mirrored is not None
    near = np.abs(depth - frame.truth.mirrored) < 0.1 * depth
    assert near[ghost].mean() > 0.8
    frame, depth = measured(scene, DepthSensor(**QUIET))
    floor = (frame.truth.obstacle_id == 0) & (depth > 0)
    assert (np.abs(depth - frame.truth.depth)[floor] < 0.1 * depth[floor]).all()


def test_glass_panes_show_the_background():
    pane = Box((1.5, 0.0), (0.02, 3.0, 3.0), texture=CLEAR_GLASS, name="pane")
    floor = Texture("asphalt")
    frame, depth = measured(room(pane, floor=floor), DepthSensor(**QUIET, pane_holes=0.4))
    on = frame.truth.obstacle_id == 1
    above = on & (frame.truth.points[..., 2] > 0.4)
    np.testing.assert_allclose(frame.truth.points[on][:, 0], 1.49, atol=1e-6)
    seen = above & (depth > 0)
    assert (~seen)[above].mean() == pytest.approx(0.4, abs=0.15)
    behind = frame.truth.behind
    assert behind is not None
    assert (np.abs(depth - behind)[seen] < 0.12).all() and behind[seen].min() > 2.5
    # The colour image is mostly that of the background.
    bare, _ = measured(room(floor=floor), DepthSensor(**QUIET))
    solid = Box((1.5, 0.0), (0.02, 3.0, 3.0), name="board")
    board, _ = measured(room(solid, floor=floor), DepthSensor(**QUIET))
    clear, wall, plain = (f.color[above].std(0).mean() for f in (frame, bare, board))
    assert clear == pytest.approx(0.85 * wall, rel=0.25) and plain < 0.4 * wall


def test_plain_surfaces_have_more_holes():
    z, shape = np.full((480, 640), 3.0), (480, 640)
    rng = np.random.default_rng(0)
    grain = rng.normal(0, 1, shape).astype(np.float32)
    lost = []
    for spread in (0.1, 0.001):
        rho = np.clip(0.3 * (1 + spread * grain), 0.01, 1)
        sight = Surface(rho, np.zeros(shape, np.float32), np.full(shape, 0.15, np.float32), 500.0)
        depth = measure_depth(z, CAMERA, D435_LIKE, np.random.default_rng(1), sight)
        lost.append((depth[:, 100:-100] == 0).mean())
    assert lost[1] > 1.5 * lost[0]
