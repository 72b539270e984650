"""Sections of the report on hard conditions: claimed floor, wrong mounts, steps down, cases."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import jaxdet
from benchmarks.paper.case_list import CASES
from benchmarks.paper.cases import drop_of
from benchmarks.paper.free import claim_of
from benchmarks.paper.missed import CLASSES, kinds_of
from benchmarks.paper.mounts import MOUNTS
from benchmarks.paper.shots import Spec, frames_of, shot_of
from benchmarks.paper.systems import eval_config
from jaxdet.config import Config
from jaxdet.sim import SimConfig, floor_truth, make_scene
from jaxdet.sim.draft import Draft
from jaxdet.sim.frames import simulate_frame
from jaxdet.sim.scene import Box, Ground, Scene
from jaxdet.types import FreeEnd

CONFIG = Config()


def shot_and_frame(scene, **changes):
    config = SimConfig(width=320, height=240, **changes)
    frame = simulate_frame(config, scene, 0)
    return shot_of(Spec("case", 0, 1), frame), frame


@pytest.fixture(scope="module")
def box():
    """Return a simulated frame of a box of 30 cm, its ground truth and the detections."""
    shot, frame = shot_and_frame(Scene(boxes=(Box((1.65, 0.0), (0.3, 0.3, 0.3)),)))
    return shot, frame, jaxdet.detect(frames_of([shot]), CONFIG, backend="reference")


def with_outline(found, left, right, near, far):
    """Return detections of one obstacle whose outline has these sides [mm]."""
    obstacles = found.obstacles
    direction, span = obstacles.direction.copy(), obstacles.span.copy()
    direction[0, 0], span[0, 0] = (1, 0), (left, right, near, far)
    one = np.array([1], np.int32)
    return found._replace(
        obstacles=obstacles._replace(direction=direction, span=span), num_obstacles=one
    )


def test_claimed_floor_is_the_drivable_floor_inside_outlines(box):
    shot, frame, found = box
    truth = floor_truth(frame)
    points = truth.points_m[truth.drivable]
    near = points[np.hypot(*points.T) <= 4.0]

    nothing = found._replace(num_obstacles=np.zeros(1, np.int32))
    drivable, claimed = claim_of(shot, nothing, CONFIG)
    assert claimed == 0
    # Not all of it is measured.
    assert 0.9 * len(near) < drivable < len(near)
    everything = with_outline(found, -9000, 9000, -9000, 9000)
    assert claim_of(shot, everything, CONFIG) == (drivable, drivable)

    z = found.obstacles.xyz_min[0, 0, 2] * 0.001
    margin = CONFIG.footprint.margin_m + CONFIG.footprint.margin_per_m2 * z**2
    right, forward = near.T
    want = (right >= -margin) & (right <= 0.5 + margin)
    want &= (forward >= 1.0 - margin) & (forward <= 1.5 + margin)
    claim = claim_of(shot, with_outline(found, 0, 500, 1000, 1500), CONFIG)
    assert claim.claimed == pytest.approx(want.sum(), rel=0.05)
    assert claim.share == claim.claimed / drivable


def test_the_outline_of_a_box_claims_only_the_floor_in_its_margin(box):
    shot, _, found = box
    assert 0 < claim_of(shot, found, CONFIG).share < 0.02


def test_overlapping_and_hardly_measured_objects_are_classified():
    size, config = (0.3, 0.3, 0.3), eval_config(CONFIG)
    boxes = [Box((1.65, y), size) for y in (-0.5, 0.1, 0.35)]
    shot, _ = shot_and_frame(Scene(boxes=tuple(boxes)))
    apart, inside, hidden = range(len(CLASSES))
    assert kinds_of(shot, config).tolist() == [apart, inside, inside]
    blind = shot._replace(depth=np.zeros_like(shot.depth))
    assert kinds_of(blind, config).tolist() == [hidden] * 3


def test_wrong_mounts_differ_from_the_true_one_by_their_error(box):
    shot = box[0]
    height, pitch, roll = shot.mount
    wrong = {mount.name: mount.applied(shot) for mount in MOUNTS}
    assert wrong["pitch+0"].mount == shot.mount
    assert wrong["pitch-2"].mount == pytest.approx((height, pitch - np.radians(2), roll))
    assert wrong["height+3"].mount == pytest.approx((height + 0.03, pitch, roll))
    assert wrong["roll-2"].mount == pytest.approx((height, pitch, roll - np.radians(2)))
    rocked = wrong["rocks"].mount
    assert rocked[0] == height and rocked[1] != pitch and rocked[2] != roll
    again = next(mount for mount in MOUNTS if mount.name == "rocks").applied(shot)
    assert again.mount == wrong["rocks"].mount


def test_a_step_down_is_reported_with_its_distance():
    shot, _ = shot_and_frame(Scene(ground=Ground(drop_m=0.4, drop_start_m=1.5)))
    found = jaxdet.detect(frames_of([shot]), CONFIG, backend="reference")
    assert drop_of(found, 0.001) == pytest.approx(1.5, abs=0.1)


def test_a_step_down_requires_neighbouring_rays(box):
    found = box[2]
    assert np.isnan(drop_of(found, 0.001))
    end, free = np.zeros_like(found.scene.free_end), np.zeros_like(found.scene.free)
    end[0, [703, 704, *range(718, 722)]] = FreeEnd.DROP
    free[0, :, 1] = 1000
    scene = found.scene._replace(free_end=end, free=free)
    assert np.isnan(drop_of(found._replace(scene=scene), 0.001))
    end[0, 722] = FreeEnd.DROP
    assert drop_of(found._replace(scene=scene), 0.001) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("key", CASES)
def test_a_case_is_drawn_by_its_seed(key):
    build = CASES[key].build
    scenes = [build(Draft(seed, "case")) for seed in (1, 2)]
    assert scenes[0] != scenes[1] and scenes[0] == build(Draft(1, "case"))


def test_gaps_and_distances_of_walls_are_those_of_the_case():
    left, right = sorted(b.center[1] for b in scene_of("gap.10cm.2m").boxes)
    assert right - left == pytest.approx(0.3 + 0.1)
    scene = scene_of("wall.box_40_cm.5cm.2.5m")
    (box_,), (wall,) = scene.boxes, scene.walls
    assert wall.start[0] - 0.05 - (box_.center[0] + 0.2) == pytest.approx(0.05)
    person = scene_of("wall.person.10cm.3.5m")
    _, frame = shot_and_frame(person)
    solid = frame.truth.obstacle_id == 1
    assert solid.any() and frame.truth.points[solid][:, 0].max() < 3.4


def scene_of(key):
    return CASES[key].build(Draft(5, "case"))


def test_cases_with_holes_in_depth_show_scenes_of_their_family():
    assert scene_of("holes.mixed.pixels").name == make_scene("mixed", 0).name
