"""find_floor: floor of each frame on synthetic cells."""

import numpy as np
import pytest

from jaxdet.camera import pixel_rays
from jaxdet.config import FloorConfig
from jaxdet.floor.plane import down_vector, flat_plane, forward_vector, unknown_plane
from jaxdet.reference._floor import find_floor
from jaxdet.types import GroundPlane, Refusal
from tests.floor_cells import (
    BOXES,
    CAMERA,
    CONFIG,
    POSES,
    UNIT,
    Box,
    Pose,
    assert_found,
    assert_refused,
    cast,
    cast_step,
    errors,
    found,
    measured,
    positions,
)

# by hand


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize(
    "wrong", [None, (0.0, 0.0, 0.0), (0.03, 2.0, 0.0), (-0.03, -2.0, 1.0), (0.05, 0.0, -3.0)]
)
def test_plane_is_found_next_to_boxes(pose, wrong):
    prior = unknown_plane(1) if wrong is None else pose.plane(*wrong)
    fit = found(measured(cast(pose, BOXES)), prior)
    assert_found(fit, pose)
    assert np.isinf(fit.plane.ramp_start[0])


@pytest.mark.parametrize("pose", [POSES[0], POSES[2]])
@pytest.mark.parametrize("wrong", [None, (0.0, 0.0, 0.0), (0.03, 2.0, -1.0), (0.0, -1.0, 2.5)])
def test_plane_is_found_in_a_corridor(pose, wrong):
    """Walls are 60 cm away on both sides, with low boxes between them."""
    walls: list[Box] = [((-0.7, -1, 0), (-0.6, 9, 2.5)), ((0.6, -1, 0), (0.7, 9, 2.5))]
    low: list[Box] = [((x, y, 0), (x + 0.2, y + 0.3, 0.08)) for x, y in ((-0.5, 1.0), (0.2, 1.7))]
    prior = unknown_plane(1) if wrong is None else pose.plane(*wrong)
    assert_found(found(measured(cast(pose, walls + low)), prior), pose)


@pytest.mark.parametrize("noise", [0.004, 0.006])
def test_noise_has_little_influence_on_the_plane(noise):
    pose = POSES[0]
    fit = found(measured(cast(pose, BOXES), noise=noise), pose.plane(0.03, 1.0, -1.0))
    assert_found(fit, pose, angle=0.25, height=6.0)


def test_the_floor_of_a_level_camera_is_exact():
    """For a level camera 500 mm up, floor cells are 500 below it at any depth."""
    z = np.zeros((120, 160), np.int32)
    v = np.arange(61, 120)
    z[61:] = (500 * 152 / (v - 59.5))[:, None]
    fit = found(np.where(z < 6000, z, 0), Pose(0.52, 1.0, 1.0).plane())
    assert_found(fit, Pose(0.5, 0.0, 0.0), angle=0.05, height=1.01)
    assert fit.share[0] > 0.99


@pytest.mark.parametrize("known", [True, False])
def test_walls_are_refused_as_floor(known):
    walls: list[Box] = [((-4, 1.5, 0), (4, 1.6, 3)), ((-1.0, 0, 0), (-0.9, 1.5, 3))]
    pose = Pose(1.2, 0.0, 0.0)
    prior = pose.plane() if known else unknown_plane(1)
    fit = found(measured(cast(pose, walls, floor=False)), prior)
    assert fit.refused[0] in (Refusal.TOO_LITTLE, Refusal.MOSTLY_OBSTACLE, Refusal.FAR)
    assert_refused(fit, Refusal(int(fit.refused[0])), prior)


@pytest.mark.parametrize(("pose", "measured_share"), [((0.06, -6, 1.4), 0.5), ((0.1, -5, 2), 0.5)])
def test_floor_is_found_though_a_wall_has_more_cells(pose, measured_share):
    """A camera just above a glossy floor, half of which is measured, sees walls at a metre."""
    pose = Pose(*pose)
    walls: list[Box] = [((-3, 1.0, 0), (-0.35, 1.1, 2)), ((-0.35, 1.7, 0), (0.4, 1.8, 2))]
    walls.append(((0.4, 1.2, 0), (3, 1.3, 2)))
    whole, bare = cast(pose, walls), cast(pose, [])
    lost = np.random.default_rng(0).random(whole.shape) > measured_share
    z = np.where(lost & (whole == bare), 0, measured(whole))
    assert_found(found(z, unknown_plane(1)), pose, angle=0.3)


BACK_WALL: Box = ((-4, 3.6, 0), (4, 3.7, 3))
DESK: list[Box] = [BACK_WALL, ((0.5, 1.2, 0), (1.5, 2.2, 0.72)), ((-2.2, 2.2, 0), (-1, 3, 1.8))]
CHAIR: list[Box] = [BACK_WALL, ((0.7, 1.4, 0), (1.7, 2.4, 0.72)), ((-2.2, 2.4, 0), (-0.8, 2.6, 1))]
CHAIR += [((-0.2, 2.2, 0.4), (0.2, 2.6, 0.45)), ((-0.2, 2.6, 0.45), (0.2, 2.65, 0.9))]


@pytest.mark.parametrize("room", [DESK, CHAIR], ids=["desk", "chair"])
@pytest.mark.parametrize("pose", [Pose(1.06, 0.0, 1.0), Pose(1.3, 5.0, 0.0)])
def test_floor_is_found_by_a_level_camera_that_sees_little_of_it(pose, room):
    """Less than a tenth of the image is floor; the rest is walls and furniture."""
    fit = found(measured(cast(pose, room)), unknown_plane(1))
    assert_found(fit, pose, angle=0.4, height=20.0)
    assert fit.share[0] < 0.1


def test_a_plane_through_a_room_is_not_a_floor():
    """Hardly any floor is visible; a steep plane through wall and furniture has more inliers."""
    room: list[Box] = [((-4, 4.2, 0), (4, 4.3, 3)), ((0.3, 2.4, 0), (1.7, 3.2, 0.72))]
    room.append(((-2.2, 2.8, 0), (-0.4, 3.2, 1.2)))
    fit = found(measured(cast(Pose(1.06, -3.0, 2.0), room)), unknown_plane(1))
    assert_refused(fit, Refusal.FAR, unknown_plane(1))


TABLE: list[Box] = [((-0.8, 0.2, 0.70), (0.8, 1.0, 0.74)), ((-4.0, 3.5, 0.0), (4.0, 3.6, 2.5))]


def test_table_is_not_the_floor():
    """From 1.3 m the table fills half of the image, and the floor continues behind it."""
    pose = Pose(1.3, 40.0, 0.0)
    z = measured(cast(pose, TABLE))
    assert_found(found(z, pose.plane(0.04, 2.0, 1.0)), pose, angle=0.3, height=15.0)
    alone = found(z, unknown_plane(1))
    assert not alone.own[0] or abs(alone.plane.height[0] - 1.3) < 0.02


def test_table_without_floor_is_refused_if_something_is_visible_below_it():
    pose = Pose(1.3, 35.0, 0.0)
    low: Box = ((-4.0, 2.0, 0.0), (4.0, 2.1, 2.5))
    z = measured(cast(pose, [((-2.0, 0.2, 0.70), (2.0, 1.1, 0.74)), low], floor=False))
    assert_refused(found(z, unknown_plane(1)), Refusal.TABLE, unknown_plane(1))


@pytest.mark.parametrize(("known", "columns"), [(True, 16), (True, 90), (False, 16), (False, 24)])
def test_reflections_do_not_lead_to_refusal(known, columns):
    """A glossy floor shows mirrored lamps below itself.

    With a prior, up to 14 % of the cells are reflections, without one 4 %: far fewer than inliers.
    """
    pose = Pose(0.6, 20.0, 0.0)
    z = cast(pose, BOXES)
    z[70:100, 60 : 60 + columns] *= 1.6
    fit = found(measured(z), pose.plane(0.0, 1.0, 0.0) if known else unknown_plane(1))
    assert_found(fit, pose)


def test_too_few_cells_are_refused():
    z = np.zeros((120, 160), np.uint16)
    z[100:104, 20:60] = 1000
    for prior in (POSES[0].plane(), unknown_plane(1)):
        assert_refused(found(z, prior), Refusal.TOO_LITTLE, prior)
        assert_refused(found(0 * z, prior), Refusal.TOO_LITTLE, prior)


def test_a_floor_below_nearly_all_cells_is_refused():
    """A little floor is visible under a plate that hangs 0.6 m ahead."""
    pose = Pose(0.5, 0.0, 0.0)
    z = cast(pose, [])
    little, more = (np.where(np.arange(120)[:, None] < row, 0.6, z) for row in (115, 112))
    little[:, 136:] = 0.6
    assert_refused(found(measured(little), pose.plane()), Refusal.MOSTLY_OBSTACLE, pose.plane())
    assert_found(found(measured(more), pose.plane()), pose, angle=0.5)


def test_a_camera_on_its_side_is_refused_without_a_prior():
    """Without a prior, a floor to the right of the image is taken for a wall."""
    pose = Pose(0.6, 20.0, 60.0)
    z = measured(cast(pose, []))
    assert_found(found(z, pose.plane(0.02, 1.0, 0.0)), pose)
    alone = found(z, unknown_plane(1))
    assert_refused(alone, Refusal.FAR, unknown_plane(1))


def test_the_floor_before_a_close_wall_is_refused_as_too_little():
    pose = Pose(0.5, 5.0, 0.0)
    wall: list[Box] = [((-4, 1.1, 0), (4, 1.2, 3))]
    fit = found(measured(cast(pose, wall)), unknown_plane(1))
    assert not fit.own[0]
    assert not fit.plane.valid[0]


def test_a_plane_too_far_from_the_prior_is_refused():
    pose = POSES[1]
    z = measured(cast(pose, BOXES))
    for wrong in ((0.0, 0.0, 6.0), (0.12, 0.0, 0.0)):
        prior = pose.plane(*wrong)
        assert_refused(found(z, prior), Refusal.FAR, prior)


def test_a_floor_above_the_camera_is_refused():
    """A ceiling is 2 cm above the axis, and the prior has a height of 4 cm."""
    pose = Pose(0.04, 0.0, 0.0)
    ceiling = np.flip(cast(pose._replace(height=0.02), []), axis=0)
    fit = found(measured(ceiling, noise=0.0), pose.plane())
    assert not fit.own[0] and fit.refused[0] in (Refusal.FAR, Refusal.TOO_LITTLE)


@pytest.mark.parametrize("pose", [Pose(0.3, 10, 1), Pose(0.8, 20, 1), Pose(1.3, 30, -2)])
@pytest.mark.parametrize("drop", [0.09, 0.25, 0.9])
@pytest.mark.parametrize("start", [1.8, 2.5])
def test_the_floor_before_a_step_down_is_found(pose, drop, start):
    """A plane tilted by 1 to 4 degrees would fit both the floor before the step and beyond it."""
    z = measured(cast_step(pose, drop, start), noise=0.004)
    for wrong in ((0.0, 0.0, 0.0), (0.03, 1.5, -1.0), (-0.02, -1.5, 1.0), (0.0, 2.0, 0.0)):
        fit = found(z, pose.plane(*wrong))
        assert_found(fit, pose)
        assert np.isinf(fit.plane.ramp_start[0])


def test_without_a_prior_a_drop_must_be_deeper_than_a_table_is_high():
    pose = Pose(1.3, 25.0, 0.0)
    table, drop = (measured(cast_step(pose, down, 2.4), noise=0.002) for down in (0.6, 0.9))
    assert_refused(found(table, unknown_plane(1)), Refusal.TABLE, unknown_plane(1))
    assert_found(found(drop, unknown_plane(1)), pose)


@pytest.mark.parametrize(
    ("pose", "start"),
    [
        *((Pose(0.3, 10, 1), start) for start in (0.8, 1.2, 2.4)),
        *((Pose(0.6, 25, 0), start) for start in (1.2, 1.8, 2.4)),
        (Pose(1.3, 30, -2), 1.8),
    ],
)
@pytest.mark.parametrize("high", [0.065, 0.1, 0.2])
def test_the_floor_before_a_kerb_is_found(pose, start, high):
    """A plane fitted to both road and pavement would hide the kerb."""
    z = measured(cast(pose, [((-9.0, start, 0.0), (9.0, 9.0, high))]), noise=0.004)
    for wrong in ((0.0, 0.0, 0.0), (0.02, 0.7, -1.0), (-0.02, -0.7, 1.0)):
        assert_found(found(z, pose.plane(*wrong)), pose, angle=0.2, height=5.0)


def test_a_wall_behind_the_floor_is_not_a_step():
    """A wall has equally many cells at each height, but all are at one distance."""
    pose = Pose(1.7, 29.0, -0.8)
    walls: list[Box] = [((-4.0, 2.6, 0.0), (4.0, 2.7, 2.5)), ((-0.9, 1.4, 0.2), (0.8, 2.6, 0.6))]
    assert_found(found(measured(cast(pose, walls)), pose.plane()), pose)


@pytest.mark.parametrize(
    ("pose", "start", "end"),
    [(Pose(0.6, 25, 0), 0.3, 0.8), (Pose(0.6, 25, 0), 0.3, 1.1), (Pose(1.3, 30, -2), 0.7, 1.5)],
)
@pytest.mark.parametrize("high", [0.055, 0.065])
def test_a_low_object_as_wide_as_the_image_is_not_the_floor(pose, start, end, high):
    """Beyond the object, the floor has its previous height, so the object's far edge is no drop."""
    platform: Box = ((-3.0, start, 0.0), (3.0, end, high))
    fit = found(measured(cast(pose, [platform]), noise=0.004), pose.plane())
    height, pitch, _ = errors(fit, pose)
    assert abs(height) < 4.0 and abs(pitch) < 0.12


def test_floor_beyond_a_step_counts_as_floor():
    """Cells on the lower floor count as inliers, not as floor below a table."""
    pose = Pose(1.3, 30.0, 0.0)
    shown = cast_step(pose, 0.25, 1.8), cast(pose, [])
    share = [found(measured(z), pose.plane()).share[0] for z in shown]
    assert share[0] > 0.8 * share[1]


@pytest.mark.parametrize("slope", [-8.0, -4.0, 4.0, 8.0])
@pytest.mark.parametrize("wrong", [(0.0, 0.0, 0.0), (0.02, 1.0, 0.5), None])
def test_visible_ramps_are_found(slope, wrong):
    """The surface, plane or ramp, is within 2 cm + 1.5 cm/m of the true visible floor."""
    pose, start = Pose(0.4, 15.0, 2.0), 1.3
    z = cast(pose, BOXES[:1], ramp=(start, float(np.tan(np.radians(slope)))))
    prior = unknown_plane(1) if wrong is None else pose.plane(*wrong)
    fit = found(measured(z), prior)
    assert fit.own[0]
    bare = cast(pose, [], ramp=(start, float(np.tan(np.radians(slope)))))
    seen = (bare < 4) & (z == bare)
    x, y = pixel_rays(CAMERA)
    points = np.stack([x, y, np.ones_like(x)], axis=-1)[seen] * bare[seen, None]
    down = down_vector(fit.plane.pitch, fit.plane.roll)
    beyond = np.maximum(points @ forward_vector(down)[0] - fit.plane.ramp_start[0], 0.0)
    deep = points @ down[0] - fit.plane.height[0] + fit.plane.ramp_slope[0] * beyond
    assert np.mean(np.abs(deep) < 0.02 + 0.015 * points[:, 2]) > 0.98
    if wrong == (0.0, 0.0, 0.0):
        assert abs(np.degrees(np.arctan(fit.plane.ramp_slope[0])) - slope) < 0.75
        assert abs(fit.plane.ramp_start[0] - start) < 0.2


def test_a_ramp_between_cabinets_is_found():
    """Most of the image shows cabinets and a wall; a tenth of the floor is on the ramp."""
    pose, start, slope = Pose(0.3, 10.0, 1.0), 1.8, 5.0
    things: list[Box] = [((-4, 3.2, 0), (4, 3.3, 3)), ((-2, 1.0, 0), (-0.1, 1.2, 2))]
    things.append(((0.1, 1.0, 0), (2, 1.2, 2)))
    z = cast(pose, things, ramp=(start, float(np.tan(np.radians(slope)))))
    plane = found(measured(z), pose.plane()).plane
    assert abs(plane.ramp_start[0] - start) < 0.1
    assert abs(np.degrees(np.arctan(plane.ramp_slope[0])) - slope) < 0.5


@pytest.mark.parametrize("slope", [-4.0, 4.0])
def test_no_ramp_is_found_if_ramps_are_disabled(slope):
    pose = Pose(0.4, 15.0, 2.0)
    z = measured(cast(pose, [], ramp=(1.3, float(np.tan(np.radians(slope))))))
    fit = found(z, pose.plane(), FloorConfig(ramps=False))
    assert np.isinf(fit.plane.ramp_start[0])


@pytest.mark.parametrize("pose", POSES[:2])
def test_bent_margins_do_not_tilt_the_plane(pose):
    """The outer tenth of the columns is nearer by up to 8 percent, on one side or on both."""
    u = np.arange(160)
    for sides in ((True, True), (True, False)):
        bend = np.maximum(np.where(sides[0], 16 - u, 0), np.where(sides[1], u - 143, 0)).clip(0)
        z = measured(cast(pose, BOXES) * (1 - 0.08 * bend / 16))
        fit = found(z, pose.plane(0.0, 1.0, 1.0))
        assert_found(fit, pose, angle=0.25, height=6.0)
        assert np.isinf(fit.plane.ramp_start[0])


def test_a_box_face_is_not_a_ramp():
    pose = Pose(0.3, 10.0, 0.0)
    for distance in (0.9, 1.5, 2.2):
        low: list[Box] = [((-2.0, distance, 0.0), (2.0, distance + 0.3, 0.12))]
        fit = found(measured(cast(pose, low)), pose.plane(0.02, 1.0, 0.0))
        assert fit.own[0]
        assert np.isinf(fit.plane.ramp_start[0])


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_a_floor(seed):
    rng = np.random.default_rng(seed)
    z = rng.integers(0, 8000, (120, 160)).astype(np.uint16)
    for prior in (
        unknown_plane(1),
        POSES[2].plane(),
        flat_plane(np.ones(1), np.full(1, 1.57), np.full(1, -3.1)),
    ):
        fit = found(z, prior)
        assert_refused(fit, Refusal(int(fit.refused[0])), prior)
        assert fit.refused[0] != Refusal.NONE


# laws


def test_batch_is_the_stack_of_singles():
    z = np.stack([measured(cast(pose, BOXES), seed=7) for pose in POSES])
    z[2] = 0
    priors = [POSES[0].plane(), unknown_plane(1), POSES[2].plane(), POSES[3].plane(0.02, 1.0)]
    prior = GroundPlane(*(np.concatenate(parts) for parts in zip(*priors, strict=True)))
    batch = find_floor(*positions(z, CAMERA), prior, CONFIG, UNIT)
    assert batch.own.tolist() == [True, True, False, True]
    for b, one in enumerate(priors):
        single = found(z[b], one)
        for whole, part in zip(
            (*batch.plane, *batch[1:]), (*single.plane, *single[1:]), strict=True
        ):
            np.testing.assert_array_equal(whole[b : b + 1], part)


@pytest.mark.parametrize("pose", POSES)
def test_a_wrong_prior_leads_to_the_same_plane(pose):
    z = measured(cast(pose, BOXES), seed=3)
    true = found(z, pose.plane()).plane
    for wrong in ((0.0, 2.0, 0.0), (0.0, -2.0, 0.0), (0.03, 0.0, 2.0), (-0.03, 0.0, -2.0)):
        plane = found(z, pose.plane(*wrong)).plane
        assert abs(np.degrees(plane.pitch - true.pitch)) < 0.1
        assert abs(np.degrees(plane.roll - true.roll)) < 0.1
        assert abs(plane.height - true.height) < 0.003


def test_the_depth_unit_has_little_influence():
    pose = POSES[0]
    z = measured(cast(pose, BOXES))
    x, y, depth = positions(z[None], CAMERA)
    fit = find_floor(10 * x, 10 * y, 10 * depth, pose.plane(0.02, 1.0), CONFIG, UNIT / 10)
    assert_found(fit, pose)
