"""find_floor: the results of the kernel equal the reference."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper.labelled import RECORDINGS, Recording
from jaxdet import open_log
from jaxdet.camera import pixel_rays
from jaxdet.config import Config, FloorConfig
from jaxdet.floor.plane import flat_plane, join_planes, repeat_plane, unknown_plane
from jaxdet.floor.units import ANGLES, STEEPEST, Scale, floor_fit, prior_units
from jaxdet.reference import cells
from jaxdet.reference._floor import find_floor
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages._tables import floor_tables as tables
from jaxdet.types import GroundPlane, Refusal
from tests.floor_cells import (
    BOXES,
    CAMERA,
    CONFIG,
    POSES,
    UNIT,
    Pose,
    cast,
    cast_step,
    measured,
    positions,
)
from tests.scenes import assert_equal
from tests.steps import find_floor as floor_program

pytestmark = pytest.mark.twin

SURFACE = Config().surface
Cells = list[np.ndarray]


def assert_same(
    grid: Cells, prior: GroundPlane, config: FloorConfig = CONFIG, unit: float = UNIT
) -> np.ndarray:
    """Assert that the kernel and the reference return the same planes.

    Returns:
        Result of the kernel, ``(B, 8)`` int32.
    """
    shared = tables(grid[2][0].size, config, unit)
    known = prior_units(prior, Scale(unit, config.noise_per_m))
    found = floor_program(*grid, known, shared)
    assert_equal(floor_fit(found, prior, unit), find_floor(*grid, prior, config, unit))
    return found


def priors(plane: GroundPlane) -> list[GroundPlane]:
    """Return the planes as prior, the planes with errors of pitch, height or roll, and no prior."""
    up, roll = np.radians(2.0), np.radians(-2.0)
    return [
        plane,
        plane._replace(pitch=plane.pitch + up),
        plane._replace(pitch=plane.pitch - up, height=plane.height + 0.04),
        plane._replace(roll=plane.roll + roll),
        unknown_plane(len(plane.height)),
    ]


def random_cells(seed: int, batch: int, rows: int, columns: int, part: float = 0.7) -> Cells:
    """Return random cells within 1 m of a floor 0.5 m down, a fraction of them measured."""
    rng = np.random.default_rng(seed)
    z = rng.integers(1, 7000, (batch, rows, columns))
    z *= rng.random(z.shape) < part
    x = (rng.uniform(-0.6, 0.6, z.shape) * z).astype(np.int32)
    y = 500 + rng.integers(-1000, 400, z.shape) * (rng.random(z.shape) < 0.5)
    return [x, y.astype(np.int32), z.astype(np.int32)]


# made by hand


def test_floors_equal_the_reference_on_boxes_and_ramps() -> None:
    """Scenes have ramps up, ramps down or no ramp; planes too far from the prior are refused."""
    depths, known = [], []
    for pose in POSES:
        for slope in (0.0, -6.0, 6.0):
            ramp = (1.3, float(np.tan(np.radians(slope)))) if slope else None
            z = measured(cast(pose, BOXES[:2], ramp=ramp))
            for prior in (*priors(pose.plane()), pose.plane(0.0, 6.0), pose.plane(0.12)):
                depths.append(z)
                known.append(prior)
    found = assert_same(positions(np.stack(depths), CAMERA), join_planes(known))
    turn, refused = found[:, 4], found[:, 7]
    assert (turn > 0).sum() > 5 and (turn < 0).sum() > 5 and (turn == 0).sum() > 20
    assert set(refused.tolist()) >= {0, 3}


def test_floors_equal_the_reference_on_steps() -> None:
    """Steps down and up are found from any height, with correct, wrong and no priors."""
    depths, known = [], []
    for pose in (Pose(0.3, 10.0, 1.0), Pose(0.8, 20.0, 1.0), Pose(1.3, 30.0, -2.0)):
        for drop, start in ((0.05, 1.8), (0.15, 2.5), (1.3, 1.8)):
            kerb = [((-9.0, start, 0.0), (9.0, 9.0, drop / 2))]
            for shown in (cast_step(pose, drop, start), cast(pose, kerb)):
                depth = measured(shown, noise=0.004)
                for prior in priors(pose.plane())[::2]:
                    depths.append(depth)
                    known.append(prior)
    grid, prior = positions(np.stack(depths), CAMERA), join_planes(known)
    found = assert_same(grid, prior)
    flat = assert_same(grid, prior, FloorConfig(ramps=False))
    assert (found != flat).any(axis=1).sum() > 20


def test_floors_equal_the_reference_on_ramps_of_just_the_minimum_visible_length() -> None:
    """In units of 1 cm this length is a multiple of the distance bins, so some ramps have it."""
    ahead, length = np.arange(80, 300), np.arange(40, 90)[:, None]
    z = np.where(ahead < 200 + length, ahead, 0)
    y = 50 - np.tan(np.radians(10.0)) * np.maximum(ahead - 200, 0)
    columns = [np.repeat(np.rint(a * (z > 0)).astype(np.int32)[..., None], 30, 2) for a in (y, z)]
    x = np.arange(-15, 15, dtype=np.int32) * (columns[1] > 0)
    prior = repeat_plane(flat_plane(*(np.array([a]) for a in (0.5, 0.0, 0.0))), len(length))
    turn = assert_same([x, *columns], prior, CONFIG, 0.01)[:, 4]
    assert 10 < np.count_nonzero(turn) < 40


def test_floors_equal_the_reference_on_tables_walls_and_few_cells() -> None:
    pose = POSES[3]
    things = [
        ([((-2.0, 0.2, 0.5), (2.0, 1.1, 0.54)), ((-4.0, 2.0, 0.0), (4.0, 2.1, 2.5))], False),
        ([((-4.0, 1.5, 0.0), (4.0, 1.6, 3.0)), ((-1.0, 0.0, 0.0), (-0.9, 1.5, 3.0))], False),
        ([((-4.0, 1.1, 0.0), (4.0, 1.2, 3.0))], True),
        ([], True),
    ]
    low = measured(cast(Pose(0.06, -6.0, 1.4), [((-4.0, 1.1, 0.0), (4.0, 1.2, 3.0))]))
    few = np.zeros((120, 160), np.uint16)
    few[100:104, 20:60] = 1000
    depths = [measured(cast(pose, boxes, floor=floor)) for boxes, floor in things]
    grid = positions(np.stack([*depths, low, few, 0 * few]), CAMERA)
    refused = [
        assert_same(grid, prior)[:, 7] for prior in priors(repeat_plane(pose.plane(), len(grid[2])))
    ]
    assert {int(n) for row in refused for n in row} >= {0, 1, 3}


@pytest.mark.parametrize(
    "config",
    [
        FloorConfig(ramps=False),
        FloorConfig(max_turn_deg=1.0, max_shift_m=0.01),
        FloorConfig(max_turn_deg=10.0, max_shift_m=1.0, min_share=0.5, min_share_alone=0.6),
        FloorConfig(noise_per_m=0.0, max_depth_m=2.0),
        FloorConfig(noise_per_m=0.05, max_depth_m=65.0),
    ],
)
def test_floors_equal_the_reference_with_any_settings(config: FloorConfig) -> None:
    depths, known = [], []
    for pose, slope in zip(POSES, (0.0, 6.0, -6.0, 4.0), strict=True):
        ramp = (1.3, float(np.tan(np.radians(slope)))) if slope else None
        for prior in priors(pose.plane())[::2]:
            depths.append(measured(cast(pose, BOXES, ramp=ramp)))
            known.append(prior)
    assert_same(positions(np.stack(depths), CAMERA), join_planes(known), config)


@pytest.mark.parametrize("unit", [0.0001, 0.01, 0.1])
def test_floors_equal_the_reference_in_any_depth_unit(unit: float) -> None:
    pose = POSES[1]
    shown = cast(pose, BOXES, ramp=(1.3, 0.1)), cast_step(pose, 0.25, 1.8)
    grid = positions(np.stack([measured(z) for z in shown]), CAMERA)
    scaled = [np.rint(a * (UNIT / unit)).astype(np.int32) for a in grid]
    for prior in priors(pose.plane()):
        assert_same(scaled, repeat_plane(prior, 2), CONFIG, unit)


def test_cells_at_the_edge_of_the_tolerance_do_not_move_the_plane() -> None:
    """In coarse units the tolerance is a few units, and Tukey's biweight at its edge is 0."""
    z = np.broadcast_to(np.arange(340, 590, 5, dtype=np.int32)[:, None], (50, 40))[None].copy()
    x = np.broadcast_to(np.arange(-20, 20, dtype=np.int32), z.shape).copy()
    given = flat_plane(*(np.array([a]) for a in (0.5, 0.0, 0.0)))
    config = FloorConfig(noise_per_m=0.0, max_turn_deg=0.0, max_shift_m=0.0)
    for below in (3, -3):
        (found,) = assert_same([x, np.full_like(x, 50 + below), z], given, config, 0.01)
        assert found[:3].tolist() == [0, 0, 50]


def test_floors_equal_the_reference_on_ramps_seen_from_straight_above() -> None:
    """The camera is pitched by 80 degrees or more, the ramps in it by up to 97, including 90."""
    depths, known = [], []
    for pitch, turn, start in ((80.0, 7.0, 0.15), (80.0, 9.0, 0.25), (82.0, 8.0, 0.15)):
        pose = Pose(1.5, pitch, 0.0)
        shown = cast(pose, [], ramp=(start, float(np.tan(np.radians(turn)))))
        depths.append(measured(shown, noise=0.0))
        depths.append(np.rint(shown / UNIT).astype(np.uint16))
        known += 2 * [pose.plane()]
    found = assert_same(positions(np.stack(depths), CAMERA), join_planes(known))
    assert (np.abs(found[:, 0]) <= STEEPEST).all()


@pytest.mark.parametrize("low", [1e-5, 0.003])
def test_tolerance_is_not_smaller_for_a_plane_above_the_camera(low: float) -> None:
    """A negative height of the camera would make the tolerance negative if noise is strong."""
    rng = np.random.default_rng(3)
    config = FloorConfig(noise_per_m=0.6, max_shift_m=1.0, max_turn_deg=10.0, min_share=0.0)
    pitch = rng.uniform(np.radians(-85), np.radians(-60), 12)
    x, y = (axis[::2, ::2] for axis in pixel_rays(CAMERA))
    above = y * np.cos(pitch)[:, None, None] + np.sin(pitch)[:, None, None]
    z = np.where(above < -0.05, rng.uniform(0.09, 0.2, (12, 1, 1)) / np.maximum(-above, 0.05), 0.0)
    z = np.minimum(z, 0.65)
    grid = [np.rint(a / 1e-5).astype(np.int32) for a in (x * z, y * z, z)]
    assert_same(grid, flat_plane(np.full(12, low), pitch, np.zeros(12)), config, 1e-5)
    sharp = Scale(1e-5, 0.6).sharp
    assert (sharp.of(grid[2].astype(np.int64), -20000) >= sharp.base).all()


# random cells


@pytest.mark.parametrize(
    ("batch", "rows", "columns"), [(1, 1, 1), (1, 7, 5), (3, 61, 83), (2, 160, 213), (5, 24, 31)]
)
def test_floors_equal_the_reference_on_random_cells(batch: int, rows: int, columns: int) -> None:
    one = flat_plane(*(np.array([a]) for a in (0.5, 0.0, 0.02)))
    for part in (0.0, 0.05, 0.7, 1.0):
        grid = random_cells(rows, batch, rows, columns, part)
        for prior in priors(repeat_plane(one, batch)):
            assert_same(grid, prior)


def test_floors_equal_the_reference_on_fewer_cells_than_in_the_grid() -> None:
    config = replace(CONFIG, max_cells=300)
    plane = flat_plane(*(np.array([a]) for a in (0.5, 0.0, 0.02)))
    for prior in priors(plane):
        assert_same(random_cells(3, 1, 61, 83), prior, config)


@pytest.mark.parametrize("roll_deg", [-180.0, -177.0, 90.0, 178.0])
def test_floors_equal_the_reference_at_any_roll(roll_deg: float) -> None:
    """The camera may have any roll, for instance hang upside down."""
    plane = flat_plane(*(np.array([a]) for a in (0.5, 0.2, np.radians(roll_deg))))
    for grid in (random_cells(5, 1, 40, 50), [-a for a in random_cells(6, 1, 40, 50)]):
        assert_same([*grid[:2], np.abs(grid[2])], plane)


@pytest.mark.parametrize("roll_deg", [178.0, 179.95, 180.0, -179.95])
@pytest.mark.parametrize("turn_deg", [-1.5, 0.0, 1.5])
def test_floor_of_a_camera_upside_down_is_found_on_both_sides_of_180_degrees(
    roll_deg: float, turn_deg: float
) -> None:
    pose = Pose(0.62, 19, roll_deg)
    grid = positions(measured(cast(pose, BOXES))[None], CAMERA)
    pitch, roll, _, *_, refused = assert_same(grid, pose.plane(roll=turn_deg))[0]
    apart = (roll / ANGLES - roll_deg + 180) % 360 - 180
    assert refused == Refusal.NONE
    assert abs(pitch / ANGLES - 19) < 0.2 and abs(apart) < 0.2


# simulated and recorded


@pytest.mark.parametrize(
    ("family", "depth_error"),
    [
        ("corridor", 1.0),
        ("room", 1.0),
        ("tables", 1.0),
        ("ramps", 0.0),
        ("mixed", 0.0),
        ("drops", 1.0),
    ],
)
def test_floors_equal_the_reference_on_simulated_frames(family: str, depth_error: float) -> None:
    frames = list(sample_frames(family, 300, 1, depth_error=depth_error))
    calibration = calibration_of(frames[0].config)
    depth = np.stack([f.depth for f in frames if f.depth is not None])
    grid = cells(depth, calibration, SURFACE)
    plane = join_planes([frame.plane for frame in frames])
    for prior in priors(plane):
        assert_same([grid.x, grid.y, grid.z], prior)


def test_a_steep_plane_through_a_hedge_is_not_the_floor() -> None:
    """A plane through a hedge and objects in front of it has more inliers than the level floor."""
    level = {"camera_pitch_rad": 0.0, "camera_roll_rad": 0.0, "width": 320, "height": 240}
    (frame,) = sample_frames("mixed", 2102, 1, **level)
    assert frame.depth is not None
    grid = cells(frame.depth[None], calibration_of(frame.config), SURFACE)
    (found,) = assert_same([grid.x, grid.y, grid.z], unknown_plane(1))
    pitch, roll, height, *_, refused = found.tolist()
    assert max(abs(pitch), abs(roll)) <= 8 and abs(height - 300) <= 4 and not refused


@pytest.mark.parametrize(
    "recording",
    [one for one in RECORDINGS if one.place.endswith(".mcap") and one.learnt],
    ids=lambda one: one.name,
)
def test_floors_equal_the_reference_on_recorded_frames(
    recording: Recording, shared_data: Path
) -> None:
    with open_log(str(shared_data / recording.place)) as log:
        batch = next(iter(log.batches(4)))
    frames, unit = batch.frames, batch.frames.calibration.depth_unit
    grid = cells(frames.depth, frames.calibration, SURFACE)
    found = [grid.x, grid.y, grid.z]
    alone = assert_same(found, unknown_plane(len(frames.depth)), CONFIG, unit)
    fit = floor_fit(alone, unknown_plane(len(alone)), unit)
    for prior in priors(fit.plane._replace(valid=np.ones(len(alone), bool)))[:3]:
        assert_same(found, prior, CONFIG, unit)
