"""Harder families and mounts, and the ground truth of their floors."""

import hashlib
from itertools import pairwise

import numpy as np
import pytest

import jaxdet
from jaxdet.errors import ConfigError
from jaxdet.eval import truth_of
from jaxdet.floor.plane import down_vector, flat_plane
from jaxdet.sim import (
    EDGE_BEARINGS_RAD,
    HARD_FAMILIES,
    DepthSensor,
    PixelKind,
    SimConfig,
    floor_edge,
    floor_truth,
    frame_truth,
    load_drivable,
    load_scene,
    load_truth,
    sample_frames,
    write_log,
)
from jaxdet.sim.config import calibration_of
from jaxdet.sim.frames import simulate_frame
from jaxdet.sim.placed import placed
from jaxdet.sim.render import render
from jaxdet.sim.robot import mount
from jaxdet.sim.scene import Box, Ground, Path, Scene, Wall
from jaxdet.types import Intrinsics

SMALL = {"width": 160, "height": 120}
CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
EXACT = DepthSensor(enabled=False)
CLEAN = {
    "mixed": "6e95e47b8ca5a0a75c21448a6e2563507798696ca2ac011efd5f19cc58e40bde",
    "low_things": "8f297c1638c938b9223a91c060d7e103f33f5a9936d7b0d28031c718939b3ed9",
}
"""SHA-256 of images of the default sensor, with which figures were measured."""


@pytest.mark.parametrize("family", CLEAN)
def test_frames_of_the_default_sensor_have_not_changed(family):
    digest = hashlib.sha256()
    for frame in sample_frames(family, 3, 2, depth_form="both", **SMALL):
        truth = frame.truth
        arrays = frame.color, frame.depth, frame.aligned, truth.obstacle_id, truth.depth
        for array in (*arrays, frame.T_world_color):
            digest.update(array.tobytes())
    assert digest.hexdigest() == CLEAN[family]


@pytest.mark.parametrize("family", HARD_FAMILIES)
def test_random_scenes_of_a_family_are_determined_by_the_seed(family):
    scenes = [load_scene(family, seed) for seed in range(4)]
    assert len(set(scenes)) == 4 and scenes[2] == load_scene(family, 2)
    for scene in scenes:
        assert scene.walls and len(scene.objects) > len(scene.walls)
        # The position of the robot is free.
        near = render(scene, CAMERA, mount(0.3, 0.17, 0.0), light=None).depth
        assert near.min() > 0.3


def corners_of(scene):
    """Return the outlines of all objects on the floor."""
    return [o[~np.isnan(o[:, 0])].astype(float) for o in placed(scene, 0.0)[2]]


@pytest.mark.parametrize("seed", range(12))
def test_corridors_are_between_1_2_and_2_4_m_wide(seed):
    scene = load_scene("corridor", seed)
    outlines = corners_of(scene)
    walls = dict(zip([w.name for w in scene.walls], outlines[-len(scene.walls) :], strict=True))
    way = np.subtract(scene.walls[0].end, scene.walls[0].start)
    across = np.array([-way[1], way[0]]) / np.hypot(*way)
    left, right = (walls[f"wall {side}"] @ across for side in ("left", "right"))
    assert 1.19 < left.min() - right.max() < 2.41
    for outline in outlines[: -len(scene.walls)]:
        places = outline @ across
        assert places.min() > right.max() - 0.25 and places.max() < left.min() + 0.25


@pytest.mark.parametrize("seed", range(12))
def test_objects_stand_in_front_of_a_wall(seed):
    scene = load_scene("wall_in_range", seed)
    (wall,) = scene.walls
    *things, slab = corners_of(scene)
    way = np.subtract(wall.end, wall.start) / np.hypot(*np.subtract(wall.end, wall.start))
    ahead = np.array([way[1], -way[0]]) * np.sign(np.cross([*way, 0], [1, 0, 0])[2] * -1)
    face = (slab @ ahead).min()
    assert 1.3 < face < 3.6
    for outline in things:
        # The foot of a cone, lower than 5 cm, is nearer to the wall than its outline.
        assert 0.04 < face - (outline @ ahead).max() < 0.6


def test_sizes_of_low_objects_drops_and_ramps_are_in_their_ranges():
    for seed in range(8):
        scene = load_scene("low_clutter", seed)
        tall = placed(scene, 0.0)[0][: -len(scene.walls)]
        assert len(tall) >= 3 and tall.min() > 0.0599 and tall.max() < 0.2401
        ground = load_scene("drops", seed).ground
        assert 1 <= ground.edges_m[0] <= 3 and 0.05 <= ground.drop_m <= 1.5
        assert all(b - a == pytest.approx(ground.drop_tread_m) for a, b in pairwise(ground.edges_m))
        ramp = load_scene("ramps", seed).ground
        assert 3 <= abs(np.degrees(ramp.slope_rad)) <= 8
    assert len({load_scene("drops", seed).ground.drop_steps for seed in range(20)}) > 2


def test_table_tops_hang_in_the_air():
    bases = [box.base for seed in range(10) for box in load_scene("tables", seed).boxes]
    assert len(bases) > 2 and min(bases) >= 0.3


def scene_with(*boxes, **rest):
    return Scene(boxes=boxes, path=Path(length=0.0), **rest)


def frame_of(scene, **changes):
    return simulate_frame(SimConfig(frames=1, sensor=EXACT, **SMALL, **changes), scene, 0)


def test_drivable_floor_is_outside_footprints():
    top = Box((2.0, 0.0), (0.8, 1.0, 0.03), base=0.7, name="top")
    mat = Box((1.2, 0.0), (0.2, 0.2, 0.03), name="mat")
    wall = Wall((4.0, -9.0), (4.0, 9.0))
    frame = frame_of(scene_with(top, mat, walls=(wall,)), camera_roll_rad=0.0)
    drivable, points = floor_truth(frame)
    floor = frame.truth.kind == PixelKind.FLOOR
    assert (np.isnan(points).any(-1) == ~floor).all()
    right, forward = points[floor].T
    under = (np.abs(right) < 0.5) & (np.abs(forward - 2) < 0.4)
    assert under.sum() > 100
    assert (drivable[floor] == ~under).mean() > 0.999 and not drivable[~floor].any()
    # Right and forward by the plane's equation: row v looks down by pitch + atan.
    v, u = np.nonzero(floor)
    T = frame.T_world_color
    z = frame.truth.depth[v, u]
    camera = calibration_of(frame.config).color
    y = (v - camera.cy) / camera.fy
    np.testing.assert_allclose(forward, (T[0, 2] + T[0, 1] * y) * z, rtol=1e-5)


def test_floor_beyond_a_drop_is_lower_and_not_drivable():
    ground = Ground(drop_m=0.1, drop_start_m=2.0, drop_steps=2, drop_tread_m=0.3, slope_yaw=0.2)
    high = {"camera_height_m": 1.2, "camera_pitch_rad": 0.4, "camera_roll_rad": 0.0}
    frame = frame_of(scene_with(Box((1.5, 0.3), (0.2, 0.2, 0.9)), ground=ground), **high)
    drivable, points = floor_truth(frame)
    floor = frame.truth.kind == PixelKind.FLOOR
    z = frame.truth.points[floor][:, 2]
    along = np.cos(0.2) * points[floor][:, 1] - np.sin(0.2) * points[floor][:, 0]
    level = np.select([along < 2.0, along < 2.3], [0.0, -0.1], -0.2)
    assert np.isclose(z, level, atol=1e-4).mean() > 0.99 and len(np.unique(level)) == 3
    assert (drivable[floor] <= (along < 2.001)).all() and drivable.sum() > 1000
    distance, seen = floor_edge(frame)
    np.testing.assert_allclose(distance, 2.0 / np.cos(EDGE_BEARINGS_RAD + 0.2), rtol=1e-6)
    # The box hides the edge behind it, and the image ends about 32 degrees to each side.
    bearings = np.degrees(EDGE_BEARINGS_RAD)
    assert not seen[np.abs(bearings) > 36].any() and seen[(bearings > 0) & (bearings < 24)].all()
    assert not seen[np.isclose(bearings, round(np.degrees(np.arctan2(-0.3, 1.5))))].any()
    level_floor = frame_of(scene_with())
    assert np.isnan(floor_edge(level_floor)[0]).all() and not floor_edge(level_floor)[1].any()
    (behind,) = floor_edge(frame, np.array([np.pi]))[0]
    assert np.isnan(behind)
    with pytest.raises(ConfigError, match="drop_tread_m is out of range"):
        Ground(drop_m=-0.1)


@pytest.mark.parametrize("family", ["corridor", "drops", "ramps"])
def test_ground_truth_of_a_log_has_the_floor(family, tmp_path):
    path = tmp_path / "hard.mcap"
    config = SimConfig(scene=family, frames=2, seed=4, depth_error=1.0, rock_rad=0.01, **SMALL)
    truth = write_log(path, config)
    frame = simulate_frame(config, load_scene(family, 4), 1)
    images = load_drivable(path, [0, 1])
    assert images.dtype == bool and (images[1] == floor_truth(frame).drivable).all()
    kept = load_truth(path)
    assert np.isfinite(kept.edge_m).any() == (family == "drops")
    np.testing.assert_array_equal(kept.edge_m[1], floor_edge(frame)[0])
    assert (kept.edge_seen == truth.edge_seen).all() and kept.is_wall.any()
    ids = np.zeros((2, 120, 160), np.uint8)
    assert truth_of(kept, [0, 1], ids, None, images).drivable is images


def test_a_wrong_mount_is_in_the_log_but_not_in_the_ground_truth(tmp_path):
    wrong = {
        "mount_pitch_error_rad": 0.03, "mount_roll_error_rad": -0.02, "mount_height_error_m": 0.03,
    }  # fmt: skip
    (frame,) = sample_frames("corridor", 2, 1, sensor=EXACT, **wrong, **SMALL)
    given, true = frame.plane, flat_plane(*frame.mount)
    assert (given.height[0], given.pitch[0], given.roll[0]) == (0.30, 0.1745, 0.0175)
    np.testing.assert_allclose([true.height, true.pitch, true.roll], [[0.33], [0.2045], [-0.0025]])
    truth = frame_truth(frame)
    assert (truth.camera_height, truth.camera_pitch) == (true.height, true.pitch)
    floor = frame.truth.kind == PixelKind.FLOOR
    local = (frame.truth.points[floor] - frame.T_world_color[:3, 3]) @ frame.T_world_color[:3, :3]
    np.testing.assert_allclose(local @ down_vector(true.pitch, true.roll)[0], 0.33, atol=1e-6)
    path = tmp_path / "wrong.mcap"
    write_log(path, SimConfig(scene="corridor", frames=1, **wrong, **SMALL))
    with jaxdet.open_log(str(path)) as log:
        motion = log.calibration.color_from_depth
        assert motion is not None
        T_base_depth = mount(0.30, 0.1745, 0.0175) @ motion.T
        np.testing.assert_allclose(log.T_base_camera, T_base_depth, atol=1e-9)
    assert load_truth(path).camera_pitch[0] == pytest.approx(0.2045)


def test_a_rocking_robot_changes_pitch_and_roll():
    config = SimConfig(scene="empty", rock_rad=0.012, width=16, height=16)
    mounts = np.array([simulate_frame(config, scene_with(), i).mount for i in range(60)])
    assert (mounts[:, 0] == 0.30).all()
    off = mounts[:, 1:] - np.array([0.1745, 0.0175])
    assert off.std(0) == pytest.approx([0.012, 0.012], rel=0.3) and (abs(off.mean(0)) < 0.005).all()
    assert abs(np.corrcoef(off.T)[0, 1]) < 0.4
    again = simulate_frame(config, scene_with(), 7)
    assert again.mount == tuple(mounts[7]) and again.plane.pitch == 0.1745


@pytest.mark.parametrize(
    "wrong", [{"depth_error": -1}, {"rock_rad": 1}, {"mount_height_error_m": -0.3}]
)
def test_values_out_of_range_are_errors(wrong):
    with pytest.raises(ConfigError, match="out of range"):
        SimConfig(**wrong)
