"""The simulator: geometry by hand, the sensor's statistics, exact truth, the same bytes again."""

import hashlib
import json
from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.errors import ConfigError, InputError
from jaxdet.plane import down_vector
from jaxdet.sim import SCENES, DepthSensor, SimConfig, load_scene, simulate
from jaxdet.sim.config import calibration_of
from jaxdet.sim.frames import simulate_frame
from jaxdet.sim.raycast import camera_rays, cast
from jaxdet.sim.render import render
from jaxdet.sim.robot import drifted, ground_frame, mount, pose_at, velocity_at
from jaxdet.sim.scene import Box, Cylinder, Path, Scene, Wall, footprint
from jaxdet.sim.sensor import is_shadowed, measure_depth
from jaxdet.types import Intrinsics

EXACT = DepthSensor(enabled=False)
SMALL = SimConfig(width=160, height=120, frames=3)
CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


def points_of(depth, camera):
    """Camera points ``(H, W, 3)``."""
    rays = camera_rays(camera).reshape(3, camera.height, camera.width)
    return np.moveaxis(rays * depth, 0, -1)


def test_box_face_is_where_it_should_be():
    config = SimConfig(scene="single_box", camera_pitch_rad=0, camera_roll_rad=0, sensor=EXACT)
    config = replace(config, depth_form="aligned", frames=1)
    frame = next(simulate(config))
    face = frame.truth.obstacle_id == 1
    assert (frame.aligned[face] == 1350).all()
    v, u = np.nonzero(face)
    calibration = calibration_of(config)
    assert np.ptp(u) == pytest.approx(0.40 / 1.35 * calibration.color.fx, abs=1.5)
    bottom = calibration.color.cy + 0.30 / 1.35 * calibration.color.fy
    top = calibration.color.cy - 0.10 / 1.35 * calibration.color.fy
    assert v.max() == pytest.approx(bottom, abs=1) and v.min() == pytest.approx(top, abs=1)


def test_cylinder_and_wall():
    post, wall = Cylinder((2.0, 0.1), 0.2, 3.0), Wall((3.0, -5.0), (3.0, 5.0), 4.0, 0.2)
    view = cast(Scene(cylinders=(post,), walls=(wall,)), CAMERA, mount(0.5, 0, 0))
    points = np.moveaxis(view.rays * view.depth, 0, -1) + [0, 0, 0.5]
    on_post = points[view.obstacle_id == 1]
    np.testing.assert_allclose(np.hypot(on_post[:, 0] - 2, on_post[:, 1] - 0.1), 0.2, atol=1e-9)
    assert (on_post[:, 0] < 2).all()
    np.testing.assert_allclose(view.depth[view.obstacle_id == 2], 2.9)
    np.testing.assert_allclose(points[view.obstacle_id == 0][:, 2], 0, atol=1e-9)


@given(
    st.floats(0.5, 4), st.floats(-1, 1), st.floats(-3.2, 3.2), st.floats(0.05, 1),
    st.floats(0.05, 1), st.floats(-0.6, 0.6), st.floats(0.2, 1.5),
)  # fmt: skip
def test_box_hits_lie_on_the_box(x, y, yaw, size, tall, pitch, height):
    box = Box((x + size, y), (size, 0.7 * size, tall), yaw, base=0.02)
    T = mount(height, pitch, 0.1)
    camera = Intrinsics(48, 36, 40.0, 40.0, 24.0, 18.0)
    view = cast(Scene(boxes=(box,)), camera, T)
    hit = view.obstacle_id == 1
    points = (view.rays[:, hit] * view.depth[hit]).T + T[:3, 3]
    c, s = np.cos(yaw), np.sin(yaw)
    local = (points - [*box.center, 0.02 + tall / 2]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    excess = np.abs(local) - np.array(box.size) / 2
    np.testing.assert_allclose(excess.max(1, initial=-9), 0, atol=1e-9)


@pytest.mark.parametrize(("pitch", "roll"), [(0, 0), (0.3, 0), (0, 0.2), (0.4, -0.15)])
def test_floor_lies_where_height_pitch_and_roll_say(pitch, roll):
    depth = cast(Scene(), CAMERA, mount(0.6, pitch, roll)).depth
    seen = np.isfinite(depth)
    down = down_vector(np.array([pitch]), np.array([roll]))[0]
    np.testing.assert_allclose(points_of(depth, CAMERA)[seen] @ down, 0.6, atol=1e-9)


def test_both_cameras_see_the_same_world():
    config = replace(SimConfig(sensor=EXACT, frames=1), depth_form="both")
    frame, calibration = next(simulate(config)), calibration_of(config)
    points = points_of(frame.depth * 0.001, calibration.depth)[frame.depth > 0]
    T = calibration.color_from_depth.T
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    u = np.rint(x / z * calibration.color.fx + calibration.color.cx).astype(int)
    v = np.rint(y / z * calibration.color.fy + calibration.color.cy).astype(int)
    inside = (u >= 0) & (u < 640) & (v >= 0) & (v < 480) & (z < 4)
    there = frame.aligned[v[inside], u[inside]] * 0.001
    error = np.abs(z[inside] - there)
    # Half a pixel on the floor shifts z by z^2 / (2 f h); beside objects another one is seen.
    assert (error < 0.002 + z[inside] ** 2 / (2 * calibration.color.fy * 0.3)).mean() > 0.98
    assert np.median(error) < 0.002


def test_depth_noise_grows_with_z_squared():
    sensor = DepthSensor(dropout=0, speckle=0)
    camera = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)
    for z in (0.5, 1.0, 2.0, 4.0):
        ideal = np.full((480, 640), z)
        depth = measure_depth(ideal, camera, sensor, np.random.default_rng(1))
        got = depth[depth > 0] * 0.001
        expected = np.hypot(sensor.deviation_m(np.float64(z), 384.5), 0.001 / np.sqrt(12))
        assert got.std() == pytest.approx(expected, rel=0.1)
        assert got.mean() == pytest.approx(z, rel=2e-3)
    neighbours = np.corrcoef(depth[:, 100:-1].ravel(), depth[:, 101:].ravel())[0, 1]
    assert neighbours > 0.5


def test_depth_holes():
    camera = Intrinsics(640, 480, 384.5, 384.5, 321.7, 236.8)
    sensor, rng = DepthSensor(), np.random.default_rng(0)
    lost = (measure_depth(np.full((480, 640), 2.0), camera, sensor, rng)[:, 20:] == 0).mean()
    assert lost == pytest.approx(sensor.dropout + sensor.speckle, rel=0.3)
    for z in (0.15, 12.0, 80.0, np.inf):
        assert not measure_depth(np.full((60, 80), z), camera, sensor, rng).any()
        exact = measure_depth(np.full((60, 80), z), camera, EXACT, rng)
        assert (exact == (0 if z > 65.535 else round(z * 1000))).all()


def test_shadow_is_left_of_the_nearer_thing():
    disparity = np.full((1, 100), 5.0)
    disparity[0, 50:60] = 20.0
    hidden = np.flatnonzero(is_shadowed(disparity)[0])
    # The thing covers columns 30-39 of the right picture, where the floor's 35-44 would land.
    assert hidden.tolist() == [*range(5), *range(36, 50)]


def test_contours_are_edges():
    frame = next(simulate(SimConfig(frames=1)))
    edges = cv2.Canny(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), 100, 200)
    near = cv2.dilate(edges, np.ones((5, 5), np.uint8)) > 0
    for number in range(1, 7):
        mask = (frame.truth.obstacle_id == number).astype(np.uint8)
        rim = mask - cv2.erode(mask, np.ones((3, 3), np.uint8)) > 0
        assert near[rim].mean() > 0.6, number
    assert near[frame.truth.obstacle_id == 0].mean() > 0.05


def digest(frame):
    arrays = (frame.color, frame.depth, frame.truth.obstacle_id, frame.T_world_color)
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()


def test_seed_decides():
    first = [digest(f) for f in simulate(SMALL)]
    assert first == [digest(f) for f in simulate(replace(SMALL, frames=5))][:3]
    alone = simulate_frame(SMALL, load_scene("demo"), 2)
    assert digest(alone) == first[2] and len(set(first)) == 3
    assert first[0] != digest(next(simulate(replace(SMALL, seed=1))))


def test_depth_is_taken_later():
    moving = replace(SMALL, sensor=EXACT, depth_delay_s=0.5)
    late = next(simulate(moving))
    assert late.depth_stamp_ns - late.stamp_ns == 500_000_000
    then = simulate_frame(replace(SMALL, sensor=EXACT, rate_hz=2), load_scene("demo"), 1)
    np.testing.assert_array_equal(late.depth, then.depth)


@pytest.mark.parametrize("name", SCENES)
def test_scenes_render(name):
    scene = load_scene(name)
    view = render(scene, CAMERA, mount(0.3, 0.17, 0.02))
    assert np.isfinite(view.color).all() and view.obstacle_id.max() <= len(scene.objects)
    standing = len(scene.boxes) + len(scene.cylinders)
    seen = set(np.unique(view.obstacle_id)) & set(range(1, standing + 1))
    assert len(seen) == min(standing, 8)


def test_scene_files(tmp_path):
    demo = load_scene("demo")
    (tmp_path / "demo.json").write_text(json.dumps(asdict(demo)))
    assert load_scene(str(tmp_path / "demo.json")) == demo
    toml = 'name = "one"\nwalls = []\n[[boxes]]\ncenter = [1.5, 0]\nsize = [0.3, 0.3, 0.4]\n'
    toml += '[boxes.texture]\nkind = "stripes"\ncolor = [200, 0, 0]\n'
    (tmp_path / "one.toml").write_text(toml)
    scene = load_scene(str(tmp_path / "one.toml"))
    assert scene.boxes[0].texture.color == (200, 0, 0)
    config = SimConfig(scene=str(tmp_path / "one.toml"), frames=1, width=64, height=48)
    assert next(simulate(config)).truth.obstacle_id.any()


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("nonsense = 1", ConfigError), ("boxes = 3", ConfigError), ("[[boxes]]\n", ConfigError),
        ("[floor]\nshade = 1", ConfigError), ("= 1", InputError), (None, InputError),
    ],
)  # fmt: skip
def test_bad_scene_files(tmp_path, text, error):
    path = tmp_path / "scene.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(error, match=r"scene\.toml"):
        load_scene(str(path))


def test_bad_values():
    with pytest.raises(ConfigError, match="no scene 'attic'"):
        load_scene("attic")
    for wrong in ({"rate_hz": 0}, {"frames": -1}, {"width": 3}, {"camera_height_m": 0}):
        with pytest.raises(ConfigError, match="out of its range"):
            SimConfig(**wrong)
    with pytest.raises(ConfigError, match="at most 255"):
        Scene(cylinders=(Cylinder((1, 0), 0.1, 1),) * 256)


def test_path_is_smooth_and_endless():
    path = Path(start=(1.0, 2.0), yaw=0.7, length=2.0, speed=0.5, weave=0.2)
    times = np.arange(0, 40, 0.02)
    poses = [pose_at(path, t) for t in times]
    xy = np.array([p[:2] for p in poses])
    steps = np.hypot(*np.diff(xy, axis=0).T)
    assert steps.max() / 0.02 < 0.5 * np.hypot(1, 0.2 * 2 * np.pi / 3) + 1e-3
    assert (np.diff([p.travelled for p in poses]) >= -1e-9).all()
    assert np.hypot(*(xy - path.start).T).max() < 2.1
    speed, turn = velocity_at(path, 1.0)
    assert speed == pytest.approx(steps[50] / 0.02, rel=0.02) and abs(turn) > 0.01
    assert poses[0][:2] == (1.0, 2.0) and pose_at(Path(length=0), 9.0).travelled == 0
    assert drifted(poses[-1], 0.0) == poses[-1]


def test_ground_frame():
    scene = load_scene("row")
    T = ground_frame(pose_at(scene.path, 1.3).T @ mount(0.4, 0.3, 0.1))
    origin = pose_at(scene.path, 1.3)
    ahead = [origin.x + np.cos(origin.yaw), origin.y + np.sin(origin.yaw), 0.2, 1]
    np.testing.assert_allclose(T @ ahead, [0, 1, 0.2, 1], atol=1e-12)
    assert np.linalg.det(T) == pytest.approx(1)


def test_footprints_are_counter_clockwise():
    for solid in (
        Box((1, 2), (0.5, 0.2, 1), 0.3),
        Cylinder((1, 2), 0.3, 1),
        Wall((0, 0), (1, 2)).box,
    ):
        x, y = footprint(solid).T
        assert (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0
