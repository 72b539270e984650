"""Simulated world: ground, path of the robot, pedestrians, batches of worlds, CUDA."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from jaxdet.sim import PixelKind, SimConfig, frame_truth, load_scene, simulate
from jaxdet.sim.ground import ground_height, standing
from jaxdet.sim.raycast import Caster, View
from jaxdet.sim.render import render
from jaxdet.sim.robot import drifted, ground_frame, mount, pose_at, velocity_at
from jaxdet.sim.scene import Ground, Path, Scene
from jaxdet.sim.scenes import scene_of
from jaxdet.sim.world import world_at
from jaxdet.types import Intrinsics

SMALL = SimConfig(width=160, height=120, frames=3)
CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


def test_a_pedestrian_walks_while_walls_stand_still():
    config = replace(SMALL, scene="pedestrian", rate_hz=1.0, frames=4)
    truths = [frame_truth(frame) for frame in simulate(config)]
    j = list(truths[0].names).index("person")
    middles = np.array([truth.box_world[0, j, :4, :2].mean(0) for truth in truths])
    assert (np.hypot(*np.diff(middles, axis=0).T) > 0.1).all()
    assert 1.4 < truths[0].height_m[0, j] < 2.0
    walls = np.array([truth.box_world[0, truth.is_wall] for truth in truths])
    assert (walls == walls[0]).all()


def test_the_robot_follows_a_slope():
    scene = Scene(ground=Ground(slope_rad=0.07, slope_start_m=1.0))
    view = render(scene, CAMERA, mount(0.5, 0.1, 0))
    x, _, z = view.points[view.kind == PixelKind.FLOOR].T
    np.testing.assert_allclose(z, np.tan(0.07) * np.maximum(x - 1, 0), atol=1e-9)
    on_it = replace(scene.ground, slope_start_m=-100.0)
    T = standing(on_it, 2.0, 0.5)
    assert T[2, :3] @ [2.0, 0.5, 0] + T[2, 3] == pytest.approx(np.tan(0.07) * 102)
    np.testing.assert_allclose(T[:3, :3].T @ [-np.sin(0.07), 0, np.cos(0.07)], [0, 0, 1], atol=1e-9)
    bumpy = Scene(ground=Ground(bump_m=0.02))
    view = render(bumpy, CAMERA, mount(0.5, 0.3, 0))
    x, y, z = view.points[view.kind == PixelKind.FLOOR].T
    assert np.abs(z - ground_height(bumpy.ground, x, y)).max() < 0.002 < z.max() < 0.02
    assert scene_of(replace(SMALL, slope_rad=0.03)).ground.slope_rad == 0.03


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


def test_the_ground_frame_is_below_the_robot_with_y_ahead():
    origin = pose_at(load_scene("row").path, 1.3)
    T = ground_frame(origin.T)
    ahead = [origin.x + np.cos(origin.yaw), origin.y + np.sin(origin.yaw), 0.2, 1]
    np.testing.assert_allclose(T @ ahead, [0, 1, 0.2, 1], atol=1e-12)
    assert np.linalg.det(T) == pytest.approx(1)


def test_views_of_a_batch_of_worlds_equal_single_ones():
    scenes = [load_scene("mixed", seed) for seed in range(3)]
    views = [View(mount(0.4, 0.1, 0.02), s.light.direction, 0.05, k) for k, s in enumerate(scenes)]
    together = Caster([world_at(s, 0) for s in scenes]).cast(CAMERA, views, 2)
    for k, scene in enumerate(scenes):
        alone = render(scene, CAMERA, views[k].T_world_camera)
        np.testing.assert_array_equal(together.depth[k], alone.depth)


@pytest.mark.gpu
def test_cuda_gives_the_same_depth():
    if not wp.is_cpu_available():
        pytest.skip("Warp has no CPU compiler here, so there is nothing to compare with")
    for scene in [load_scene("mixed", 1), load_scene("demo")]:
        ours, theirs = (
            render(scene, CAMERA, mount(0.4, 0.1, 0.02), device=d) for d in ("cpu", "cuda")
        )
        same = ours.obstacle_id == theirs.obstacle_id
        assert same.mean() > 0.999
        close = np.isclose(ours.depth, theirs.depth, rtol=1e-9)
        assert close[same].mean() > 0.999
        assert np.abs(ours.color - theirs.color)[close].max() < 0.5
        assert (np.abs(ours.light - theirs.light)[close] < 1e-3).mean() > 0.999
