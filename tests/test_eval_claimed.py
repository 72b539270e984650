"""Drivable floor inside of outlines, by hand and compared with the simulator."""

import math

import numpy as np
import pytest

from jaxdet.config import Config
from jaxdet.eval import (
    EvalConfig,
    Tally,
    claimed_floor,
    floor_positions,
    measured_floor,
    score,
    total,
)
from jaxdet.eval.truth import depth_poses, to_ground_frame
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.pipeline import detect
from jaxdet.results.metric import to_world
from jaxdet.sim import floor_truth, sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.types import Calibration, Detections, Frames, Refusal, Scene
from tests.scenes import frames, small, smooth_depth

CONFIG = EvalConfig(footprint=Config().footprint, min_visible_pixels=3)


def found() -> Detections:
    """Return detections of two frames; the first has two outlines.

    One is the square from (0, 1) to (1, 2) [m], the other is 1 m to the right of it.
    """
    calibration = small()
    color = np.zeros((2, 60, 80, 3), np.uint8)
    plane = flat_plane(*np.full((3, 2), [[0.4], [0.0], [0.0]]))
    given: Frames = frames(calibration, color, smooth_depth(2, calibration.depth), plane=plane)
    empty = detect(given, backend="reference")
    obstacles, scene = empty.obstacles, empty.scene
    assert scene is not None
    margin = round(CONFIG.footprint.margin_m * 1000)
    direction, span = 0 * obstacles.direction, 0 * obstacles.span
    direction[..., 0] = 1
    for slot, left in enumerate((0, 1000)):
        edges = left, left + 1000, 1000, 2000
        span[0, slot] = np.array(edges) + np.array([margin, -margin, margin, -margin])
    obstacles = obstacles._replace(direction=direction, span=span)
    return empty._replace(num_obstacles=np.array([2, 0], np.int32), obstacles=obstacles)


def with_scene(detections: Detections, **parts: object) -> Detections:
    scene = detections.scene
    assert isinstance(scene, Scene)
    return detections._replace(scene=scene._replace(**parts))


FLOOR = np.array([[[[0.5, 1.5], [0.9, 1.9], [1.5, 1.5], [0.5, 2.5]]]] * 2)
"""Positions of four floor pixels, right and forward [m]: two are in the first square of
:func:`found`, one is in the second, and one is behind the first."""


def test_claimed_floor_matches_a_hand_calculation() -> None:
    detections = found()
    heights = np.zeros_like(detections.scene.bottom_top)
    low = with_scene(detections, bottom_top=heights)
    one, other = claimed_floor(low, FLOOR, 0.001, CONFIG)
    assert one == Tally(drivable_pixels=4, drivable_claimed=3, claims=(0.75,))
    assert other == Tally(drivable_pixels=4, drivable_claimed=0, claims=(0.0,))
    figures = score([one, other])
    assert (figures.free_claimed, figures.free_claimed_worst) == (0.375, 0.75)
    assert total([one, other]).claims == (0.75, 0.0)
    assert len(claimed_floor(low, FLOOR, 0.001, CONFIG, np.array([False, True]))) == 1
    heights[0, 0] = 501, 900
    hanging = claimed_floor(with_scene(low, bottom_top=heights), FLOOR, 0.001, CONFIG)
    assert hanging[0].drivable_claimed == 1
    floor = 0 * detections.scene.floor
    floor[:, 7] = Refusal.TOO_LITTLE
    unknown = with_scene(low, bottom_top=heights, floor=floor, prior=unknown_plane(2))
    assert claimed_floor(unknown, FLOOR, 0.001, CONFIG)[0].drivable_claimed == 3
    points = low._replace(scene=None)
    assert claimed_floor(points, FLOOR, 0.001, CONFIG)[0].drivable_claimed == 3


def test_frames_with_little_floor_have_no_fraction_of_claimed_floor() -> None:
    floor = FLOOR.copy()
    floor[0, 0, 1:3] = np.nan
    tallies = claimed_floor(found()._replace(scene=None), floor, 0.001, CONFIG)
    assert (tallies[0].drivable_pixels, tallies[0].drivable_claimed) == (2, 1)
    assert score(tallies).free_claimed_worst == 0.0
    assert math.isnan(score(tallies[:1]).free_claimed_worst)
    assert math.isnan(score([Tally()]).free_claimed)


def test_floor_is_measured_only_where_depth_agrees_with_it() -> None:
    positions = np.array([[[0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [3.0, 3.0], [np.nan, 1.0]]])
    true = np.array([[1.0, 1.0, 1.0, 3.0, 1.0]], np.float16)
    got = measured_floor(positions, true, np.array([[1.05, 0.0, 0.9, 3.0, 1.0]]), EvalConfig())
    assert np.isfinite(got).all(axis=-1).tolist() == [[True, False, False, False, False]]


def test_floor_positions_equal_those_of_the_simulator() -> None:
    (frame,) = sample_frames("corridor", 0, 1, width=160, height=120)
    truth = floor_truth(frame)
    calibration = calibration_of(frame.config)
    given = frame.truth.depth[None], truth.drivable[None]
    got = floor_positions(*given, Calibration(calibration.image), frame.T_world_color[None])
    want = np.where(truth.drivable[..., None], truth.points_m, np.nan)
    assert truth.drivable.sum() > 1000
    np.testing.assert_allclose(got[0], want, atol=2e-3)
    assert math.isnan(got[0, 0, 0, 0]) or truth.drivable[0, 0]
    moved = floor_positions(*given, calibration, frame.T_world_color[None])
    world = to_world(got, frame.T_world_color[None])
    poses = depth_poses(frame.T_world_color[None], calibration)
    np.testing.assert_allclose(moved, to_ground_frame(world, poses), atol=1e-9)
    assert np.nanmedian(np.abs(moved - got)[..., 0]) > 0.005


def test_a_run_reports_claimed_floor(tmp_path) -> None:
    from jaxdet.cli.truth import TruthScore
    from jaxdet.sim import SimConfig, write_log
    from tests.runs import run_logs

    path = tmp_path / "sim.mcap"
    write_log(path, SimConfig(frames=2, width=320, height=240))
    observers = {"score": TruthScore(path, Config())}
    how = {"backend": "reference", "batch_size": 2, "pictures": 0, "observers": observers}
    summary = run_logs(path, tmp_path / "out", **how)
    figures = summary.logs[0].observed["score"]
    assert figures is not None and figures["drivable_pixels"] > 10000
    assert 0 < figures["free_claimed"] <= figures["free_claimed_worst"] < 0.2
    assert figures["free_claimed"] == pytest.approx(
        figures["drivable_claimed"] / figures["drivable_pixels"]
    )


def test_distances_are_not_scored_without_a_floor(tmp_path) -> None:
    from jaxdet.cli.truth import TruthScore
    from jaxdet.config import GroundConfig
    from jaxdet.sim import SimConfig, write_log
    from tests.runs import run_logs

    path = tmp_path / "sim.mcap"
    write_log(path, SimConfig(frames=2, width=320, height=240))
    for source in ("auto", "none"):
        config = Config(ground=GroundConfig(source=source))
        observers = {"score": TruthScore(path, config)}
        how = {"backend": "reference", "batch_size": 2, "pictures": 0, "observers": observers}
        summary = run_logs(path, tmp_path / source, config=config, **how)
        figures = summary.logs[0].observed["score"]
        assert figures is not None and figures["found"] > 0
        assert np.isnan(figures["nearest_error_m"]) == (source == "none")
