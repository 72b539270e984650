"""Simulator: rays against equations, exact ground truth, reproducible bytes."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxdet.errors import ConfigError
from jaxdet.floor.plane import down_vector
from jaxdet.sim import (
    FAMILIES,
    DepthSensor,
    PixelKind,
    SimConfig,
    frame_truth,
    load_scene,
    sample_frames,
    simulate,
    to_camera,
)
from jaxdet.sim.config import calibration_of
from jaxdet.sim.frames import simulate_frame
from jaxdet.sim.render import render
from jaxdet.sim.robot import mount
from jaxdet.sim.scene import Box, Cylinder, Scene, Wall
from jaxdet.types import Intrinsics
from tests.sim_oracle import box_depth, cylinder_depth, floor_depth, rays_of

EXACT = DepthSensor(enabled=False)
SMALL = SimConfig(width=160, height=120, frames=3)
CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


def points_of(depth, camera):
    """Return the points of a depth image in the camera frame, ``(H, W, 3)``."""
    return rays_of(camera, np.eye(4)) * depth[..., None]


def test_the_face_of_a_box_has_its_exact_depth_and_pixels():
    config = SimConfig(scene="single_box", camera_pitch_rad=0, camera_roll_rad=0, sensor=EXACT)
    config = replace(config, depth_form="aligned", frames=1)
    frame = next(simulate(config))
    face = frame.truth.obstacle_id == 1
    assert (frame.aligned[face] == 1350).all()
    v, u = np.nonzero(face)
    calibration = calibration_of(config)
    assert np.ptp(u) == pytest.approx(0.40 / 1.35 * calibration.image.fx, abs=1.5)
    bottom = calibration.image.cy + 0.30 / 1.35 * calibration.image.fy
    top = calibration.image.cy - 0.10 / 1.35 * calibration.image.fy
    assert v.max() == pytest.approx(bottom, abs=1) and v.min() == pytest.approx(top, abs=1)


def test_cylinder_and_wall_agree_with_their_equations():
    post, wall = Cylinder((2.0, 0.1), 0.2, 3.0), Wall((3.0, -5.0), (3.0, 5.0), 4.0, 0.2)
    T = mount(0.5, 0, 0)
    view = render(Scene(cylinders=(post,), walls=(wall,)), CAMERA, T)
    want = cylinder_depth(T[:3, 3], rays_of(CAMERA, T), post.center, post.radius)
    on_post = view.obstacle_id == 1
    # 64 sides lie up to r (1 - cos(pi / 64)) = 0.24 mm inside the circle.
    radius = np.hypot(view.points[on_post, 0] - 2, view.points[on_post, 1] - 0.1)
    assert radius.min() > 0.2 - 0.00025 and radius.max() < 0.2 + 1e-9
    behind = np.minimum(2.9, floor_depth(T[:3, 3], rays_of(CAMERA, T)))
    assert np.mean(on_post == (want < behind)) > 0.998
    np.testing.assert_allclose(view.depth[view.obstacle_id == 2], 2.9)
    assert (view.kind[view.obstacle_id == 2] == PixelKind.WALL).all()
    floor = view.kind == PixelKind.FLOOR
    np.testing.assert_allclose(view.points[floor][:, 2], 0, atol=1e-9)
    assert (view.height[floor] == 0).all()
    np.testing.assert_allclose(view.height[on_post], view.points[on_post, 2], rtol=1e-6)


@settings(max_examples=30)
@given(
    st.floats(0.5, 4), st.floats(-1, 1), st.floats(-3.2, 3.2), st.floats(0.05, 1),
    st.floats(0.05, 1), st.floats(-0.6, 0.6), st.floats(0.2, 1.5),
)  # fmt: skip
def test_box_agrees_with_its_equation(x, y, yaw, size, tall, pitch, height):
    box = Box((x + size, y), (size, 0.7 * size, tall), yaw)
    T = mount(height, pitch, 0.1)
    camera = Intrinsics(48, 36, 40.0, 40.0, 24.0, 18.0)
    view = render(Scene(boxes=(box,)), camera, T, light=None)
    rays = rays_of(camera, T)
    floor = floor_depth(T[:3, 3], rays)
    want = np.minimum(box_depth(T[:3, 3], rays, box.center, box.size, yaw), floor)
    # A ray along an edge may hit or miss; the floor ends 60 m away.
    same = np.isclose(view.depth, want, rtol=1e-9) | (~np.isfinite(view.depth) & (want > 50))
    assert (~same).sum() <= 2


@pytest.mark.parametrize(("pitch", "roll"), [(0, 0), (0.3, 0), (0, 0.2), (0.4, -0.15)])
def test_floor_agrees_with_height_pitch_and_roll(pitch, roll):
    depth = render(Scene(), CAMERA, mount(0.6, pitch, roll)).depth
    seen = np.isfinite(depth)
    down = down_vector(np.array([pitch]), np.array([roll]))[0]
    np.testing.assert_allclose(points_of(depth, CAMERA)[seen] @ down, 0.6, atol=1e-9)


def test_both_cameras_see_the_same_world():
    config = replace(SimConfig(sensor=EXACT, frames=1), depth_form="both")
    frame, calibration = next(simulate(config)), calibration_of(config)
    points = points_of(frame.depth * 0.001, calibration.depth)[frame.depth > 0]
    T = calibration.color_from_depth.T
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    u = np.rint(x / z * calibration.image.fx + calibration.image.cx).astype(int)
    v = np.rint(y / z * calibration.image.fy + calibration.image.cy).astype(int)
    inside = (u >= 0) & (u < 640) & (v >= 0) & (v < 480) & (z < 4)
    there = frame.aligned[v[inside], u[inside]] * 0.001
    error = np.abs(z[inside] - there)
    # Half a pixel on the floor shifts z by z^2 / (2 f h); edges of objects differ more.
    assert (error < 0.002 + z[inside] ** 2 / (2 * calibration.image.fy * 0.3)).mean() > 0.98
    assert np.median(error) < 0.002


@pytest.mark.parametrize("family", FAMILIES)
def test_footprints_and_boxes_contain_their_points(family):
    for frame in sample_frames(family, 5, 2, slope_rad=0.05, width=160, height=120):
        truth = frame_truth(frame)
        T = truth.T_world_camera[0]
        assert truth.visible_pixels[0].sum() == (frame.truth.obstacle_id > 0).sum()
        for j in np.flatnonzero(truth.visible_pixels[0]):
            chosen = frame.truth.obstacle_id == j + 1
            points = frame.truth.points[chosen]
            outline = truth.footprint_world[0, j]
            outline = outline[~np.isnan(outline[:, 0])].astype(np.float64)
            above = points[:, 2] - (truth.box_world[0, j, 4, 2] - truth.height_m[0, j])
            step = 0.05 if truth.height_m[0, j] > 0.05 else -np.inf
            low = points[(above > step + 1e-3) & (above < 2.2)]
            edge = np.roll(outline, -1, axis=0) - outline
            to = low[:, None, :2] - outline
            side = (edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0]) / np.hypot(*edge.T)
            assert side.min(initial=0) > -1e-3
            box = truth.box_world[0, j].astype(np.float64)
            axes = box[[1, 3, 4]] - box[0]
            share = (points - box[0]) @ axes.T / (axes**2).sum(1)
            assert share.min() > -1e-3 and share.max() < 1 + 1e-3
            counts = frame.truth.height[chosen] > 0.05
            points = points[counts] if counts.any() else points
            assert (to_camera(T, points)[:, 2].min()) == pytest.approx(
                truth.nearest_m[0, j], rel=1e-6
            )


def digest(frame):
    arrays = (frame.color, frame.depth, frame.truth.obstacle_id, frame.T_world_color)
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()


def test_frames_depend_on_the_seed():
    first = [digest(f) for f in simulate(SMALL)]
    assert first == [digest(f) for f in simulate(replace(SMALL, frames=5))][:3]
    alone = simulate_frame(SMALL, load_scene("demo"), 2)
    assert digest(alone) == first[2] and len(set(first)) == 3
    assert first[0] != digest(next(simulate(replace(SMALL, seed=1))))


def test_samples_depend_only_on_seed_and_number():
    size = {"width": 96, "height": 72}
    some = [digest(f) for f in sample_frames("mixed", 3, 3, **size)]
    assert some == [digest(f) for f in sample_frames("mixed", 3, 3, **size)]
    assert some[:2] == [digest(f) for f in sample_frames("mixed", 3, 2, **size)]
    dark = list(sample_frames("mixed", 3, 3, light="dim", camera_pitch_rad=0.3, **size))
    light = list(sample_frames("mixed", 3, 3, **size))
    assert [f.scene for f in dark] == [f.scene for f in light]
    assert len({f.scene for f in light}) == 3 and [f.number for f in light] == [0, 1, 2]
    with pytest.raises(ConfigError, match="unknown family 'attic'"):
        next(sample_frames("attic", 0, 1))


def test_depth_is_exposed_later_than_colour():
    moving = replace(SMALL, sensor=EXACT, depth_delay_s=0.5)
    late = next(simulate(moving))
    assert late.depth_stamp_ns - late.stamp_ns == 500_000_000
    then = simulate_frame(replace(SMALL, sensor=EXACT, rate_hz=2), load_scene("demo"), 1)
    np.testing.assert_array_equal(late.depth, then.depth)


def test_values_out_of_range_are_errors():
    late = {"start_ns": (2**31 - 1) * 10**9}  # stamps of ROS 2 have seconds in int32
    for wrong in ({"rate_hz": 0}, {"frames": -1}, {"width": 3}, {"camera_height_m": 0}, late):
        with pytest.raises(ConfigError, match="out of range"):
            SimConfig(**wrong)
    with pytest.raises(ConfigError, match="256 objects, more than 255"):
        Scene(cylinders=(Cylinder((1, 0), 0.1, 1),) * 256)


def test_contours_are_at_edges_of_objects():
    frame = next(simulate(SimConfig(frames=1)))
    edges = cv2.Canny(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), 100, 200)
    near = cv2.dilate(edges, np.ones((5, 5), np.uint8)) > 0
    for number in range(1, 7):
        mask = (frame.truth.obstacle_id == number).astype(np.uint8)
        rim = mask - cv2.erode(mask, np.ones((3, 3), np.uint8)) > 0
        assert near[rim].mean() > 0.5, number
    assert near[frame.truth.obstacle_id == 0].mean() > 0.05
