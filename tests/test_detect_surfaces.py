"""detect with surfaces: complete scenes, synthetic, simulated and recorded."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from benchmarks.paper.labelled import RECORDINGS, Recording, labels_of
from benchmarks.scores.boxes import BoxTally, score_boxes, tally_boxes
from jaxdet import detect
from jaxdet.config import Config, GroundConfig
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.io import open_log
from jaxdet.pipeline import BackendName
from jaxdet.presets import preset
from jaxdet.reference.paper import align
from jaxdet.reference.paper._ground import above_floor
from jaxdet.results import metric
from jaxdet.results.free_floor import ray_bearings
from jaxdet.results.metric import floors
from jaxdet.sim import DepthSensor, SimConfig, sample_frames
from jaxdet.sim.appearance import CARTON, POST, RED_CRATE, WOOD
from jaxdet.sim.config import calibration_of
from jaxdet.sim.frames import SimFrame, simulate_frame
from jaxdet.sim.scene import Box, Cylinder, Ground, Scene
from jaxdet.sim.scene import Path as Way
from jaxdet.types import (
    MAX_OBSTACLES,
    Calibration,
    Detections,
    Frames,
    FreeEnd,
    GroundPlane,
    Intrinsics,
    Refusal,
)
from tests.floor_cells import CAMERA, Pose, cast, measured
from tests.floor_cells import Box as BoxCorners
from tests.scenes import D435, D435_MOTION, assert_equal, frames

SURFACES = Config()
UNIT = 0.001
POSE = Pose(0.5, 15.0, 0.0)
MARGIN = SURFACES.footprint.margin_per_m2 * 1.2**2
"""Margin of an obstacle whose nearest point is 1.2 m ahead [m]."""


def found(given: Frames, config: Config = SURFACES) -> Detections:
    return detect(given, config, backend="reference")


def made(depth_m: np.ndarray, plane: GroundPlane | None, unit: float = 0.001) -> Frames:
    """Return frames of exact aligned depth ``(B, H, W)`` [m], with black colour images."""
    depth = np.where((depth_m > 0) & (depth_m < 8), np.rint(depth_m / unit), 0).astype(np.uint16)
    height, width = depth.shape[1:]
    camera = CAMERA._replace(width=width, height=height)
    calibration = Calibration(camera, depth_unit=unit)
    return frames(calibration, np.zeros((*depth.shape, 3), np.uint8), depth, plane=plane)


def of(frame: SimFrame, wrong_deg: float = 0.0) -> Frames:
    """Return a simulated frame whose prior is its floor, with an error of pitch [degree]."""
    assert frame.depth is not None
    plane = frame.plane._replace(pitch=frame.plane.pitch + np.radians(wrong_deg))
    calibration = calibration_of(frame.config)
    return frames(calibration, frame.color[None], frame.depth[None], plane=plane)


def simulated(
    *boxes: Box, poles: tuple = (), floor: Ground | None = None, **settings: Any
) -> SimFrame:
    """Return a frame of 320 x 240 pixels of boxes and poles on a wooden floor."""
    scene = Scene("made", boxes, poles, floor=WOOD, ground=floor or Ground(), path=Way(length=0.0))
    return simulate_frame(SimConfig(width=320, height=240, **settings), scene, 0)


def count(detections: Detections, b: int = 0) -> int:
    return int(detections.num_obstacles[b])


def sizes(detections: Detections, config: Config = SURFACES) -> np.ndarray:
    """Return width along AB, depth and top of the obstacles of frame 0, without the margin [m]."""
    n, assumed = count(detections), detections.scene
    assert assumed
    bare = replace(config.footprint, margin_m=0.0, margin_per_m2=0.0)
    corners = metric.rectangles(detections.obstacles, 0.001, bare)[0, :n]
    along = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    across = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
    top = assumed.bottom_top[0, :n, 1] * 0.001
    return np.stack([along, across, top], axis=1)


BOX = ((-0.3, 1.2, 0.0), (0.1, 1.5, 0.3))


# made by hand: exact depth of boxes on a floor


def test_a_box_in_exact_depth_is_found_with_its_size() -> None:
    detections = found(made(cast(POSE, [BOX])[None], POSE.plane()))
    scene = detections.scene
    assert count(detections) == 1 and scene
    np.testing.assert_allclose(sizes(detections), [[0.4, 0.3, 0.3]], atol=0.03)
    (a, b, c, d) = metric.rectangles(detections.obstacles, 0.001, SURFACES.footprint)[0, 0]
    true = np.array([[-0.3, 1.2], [0.1, 1.2], [0.1, 1.5], [-0.3, 1.5]])
    outward = MARGIN * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    np.testing.assert_allclose([a, b, c, d], true + outward, atol=0.03)
    contour = scene.contour[0, 0, : scene.contour_points[0, 0]]
    assert len(contour) > 30 and (np.abs(contour[2:-2, 1] - 1200) < 15).all()
    assert (np.diff(contour[:, 0]) > 0).all()
    assert metric.distances(detections)[0, 0] == pytest.approx(1200, abs=15)
    assert floors(scene, UNIT).own[0] and floors(scene, UNIT).refused[0] == Refusal.NONE
    assert floors(scene, UNIT).plane.height[0] == pytest.approx(POSE.height, abs=0.004)


def test_preset_tabletop_takes_a_table_in_a_room_for_the_floor() -> None:
    """The far third of the image shows the room's floor, 0.7 m below the table."""
    pose, box = Pose(0.5, 40.0, 0.0), ((-0.05, 0.5, 0.0), (0.05, 0.6, 0.1))
    depth = cast(pose, [box])
    rows = depth.shape[0] // 3
    depth[:rows] = cast(pose._replace(height=1.2), [])[:rows]
    detections = found(made(depth[None], None), preset("tabletop"))
    scene = detections.scene
    assert scene and floors(scene, UNIT).own[0]
    assert floors(scene, UNIT).plane.height[0] == pytest.approx(0.5, abs=0.01)
    assert count(detections) == 1
    assert metric.distances(detections)[0, 0] == pytest.approx(500, abs=15)


def test_free_floor_ends_at_a_box_and_continues_next_to_it() -> None:
    scene = found(made(cast(POSE, [BOX])[None], POSE.plane())).scene
    assert scene
    stop, end = scene.free[0, :, 1], scene.free_end[0]
    blocked = np.flatnonzero(end == FreeEnd.OBSTACLE)
    assert np.ptp(blocked) + 1 == len(blocked)
    bearing, _ = ray_bearings()
    assert (np.abs(stop[blocked] * np.cos(bearing[blocked]) - 1200) < 30).all()
    assert bearing[blocked].min() == pytest.approx(-np.arctan2(0.3, 1.2), abs=0.03)
    assert bearing[blocked].max() == pytest.approx(np.arctan2(0.1, 1.2), abs=0.03)
    assert FreeEnd.DROP not in end
    beyond = (stop * np.cos(bearing))[end == FreeEnd.RANGE]
    assert len(beyond) > 50 and (beyond > 3400).all() and (beyond <= 4000).all()


def test_an_object_above_the_robot_is_not_an_obstacle() -> None:
    """A gate has two posts 1.2 m apart and, in the same plane, a beam from 0.5 m up."""
    posts = [((-0.8, 2.0, 0.0), (-0.6, 2.2, 1.0)), ((0.6, 2.0, 0.0), (0.8, 2.2, 1.0))]
    gate = made(cast(POSE, [*posts, ((-0.6, 2.0, 0.5), (0.6, 2.2, 1.0))])[None], POSE.plane())

    def under(height_m: float) -> Detections:
        ground = replace(SURFACES.ground, max_height_m=height_m)
        return found(gate, replace(SURFACES, ground=ground))

    for height_m in (0.0, 1.3):
        whole = under(height_m)
        assert count(whole) == 1 and sizes(whole)[0, 0] == pytest.approx(1.6, abs=0.05)
        assert sizes(whole)[0, 2] > 0.7
    low = under(0.45)
    assert count(low) == 2 and (sizes(low)[:, 0] < 0.3).all()
    assert (sizes(low)[:, 2] <= 0.45).all() and (sizes(low)[:, 2] > 0.4).all()
    assert low.scene
    between = np.abs(ray_bearings()[0]) < 0.5 / 2.2
    assert between.sum() > 20 and (low.scene.free_end[0, between] == FreeEnd.RANGE).all()


def test_the_maximum_height_has_no_effect_if_the_floor_is_unknown() -> None:
    given = made(cast(POSE, [BOX])[None], None)
    unknown = replace(SURFACES, floor=replace(SURFACES.floor, min_share_alone=1.0))
    limits = (replace(SURFACES.ground, max_height_m=m) for m in (0.0, 0.1))
    assert_equal(*(found(given, replace(unknown, ground=limit)) for limit in limits))


def test_cells_with_twice_the_side_raise_the_step_height_by_half_as_much() -> None:
    """A box 9 cm high is 2.6 m away; cells are single pixels, or 2 x 2 equal pixels."""
    fine_camera = Intrinsics(320, 240, 304.0, 304.0, 159.5, 119.5)
    coarse = made(cast(POSE, [((-0.5, 2.6, 0.0), (0.5, 3.4, 0.09))])[None], POSE.plane())
    depth = np.kron(coarse.depth, np.ones((1, 2, 2), np.uint16))
    black = np.zeros((1, 240, 320, 3), np.uint8)
    fine = frames(Calibration(fine_camera), black, depth, plane=POSE.plane())

    def kept(given: Frames, per_m: float, noise: float = 0.0) -> np.ndarray:
        ground = GroundConfig(step_height_per_m=per_m, noise_per_m=noise)
        config = replace(SURFACES, ground=ground)
        cells = detect(given, config, backend="reference", with_cells=True).cells
        assert cells
        return cells.keep[0]

    np.testing.assert_array_equal(kept(coarse, 0.01), kept(fine, 0.02))
    assert kept(fine, 0.02).sum() > kept(coarse, 0.02).sum()
    np.testing.assert_array_equal(kept(coarse, 0.0, 0.05), kept(fine, 0.0, 0.1))
    # The maximum noise is that of depth with more noise.
    depth = measured(coarse.depth[0] * UNIT, noise=0.05)[None]
    coarse = coarse._replace(depth=depth)
    fine = fine._replace(depth=np.kron(depth, np.ones((1, 2, 2), np.uint16)))
    np.testing.assert_array_equal(kept(coarse, 0.0, 0.05), kept(fine, 0.0, 0.1))
    assert kept(fine, 0.0, 0.1).sum() > kept(coarse, 0.0, 0.1).sum()


HIGH = Pose(1.3, 30.0, 0.0)
CARTON_AHEAD = ((-0.2, 1.6, 0.0), (0.1, 1.9, 0.08))


@pytest.mark.parametrize("roll", [0.0, 30.0, 180.0])
def test_a_low_box_seen_from_above_is_found_if_the_floor_has_little_noise(roll: float) -> None:
    """The maximum noise, which cells of one pixel have, would hide everything below 18 cm."""
    pose = HIGH._replace(roll=roll)
    given = made(cast(pose, [CARTON_AHEAD])[None], pose.plane())
    detections = found(given)
    assert count(detections) == 1 and detections.scene
    bottom, top = detections.scene.bottom_top[0, 0] * UNIT
    assert 0.025 < bottom < 0.045 and top == pytest.approx(0.08, abs=0.01)
    none = replace(SURFACES, ground=GroundConfig(step_height_m=0.2))
    assert count(found(given, none)) == 0


@pytest.mark.parametrize("noise", [0.003, 0.006, 0.008])
def test_noise_of_the_floor_is_no_obstacle(noise: float) -> None:
    """The standard deviation of depth is the noise times z squared."""
    for seed in range(4):
        depth = measured(cast(HIGH, []), seed, noise) * UNIT
        assert count(found(made(depth[None], HIGH.plane()))) == 0


def test_labelled_cells_span_the_box_of_their_obstacle() -> None:
    given = made(cast(POSE, [BOX])[None], POSE.plane())
    detections = detect(given, SURFACES, backend="reference", with_cells=True)
    cells, side = detections.cells, 1
    assert cells
    on = cells.label[0] == 0
    assert on[cells.keep[0]].all() and (cells.label[0, ~on] == -1).all()
    lower = on & ~cells.keep[0]  # between half of the step height and the step height
    assert lower.any() and detections.scene and detections.scene.bottom_top[0, 0, 0] * UNIT > 0.025
    row, column = np.nonzero(on)
    assert detections.obstacles.num_points[0, 0] == on.sum()
    first, last = detections.obstacles.uv_min[0, 0], detections.obstacles.uv_max[0, 0]
    assert first.tolist() == [side * column.min(), side * row.min()]
    assert last.tolist() == [side * (column.max() + 1) - 1, side * (row.max() + 1) - 1]


def test_box_of_an_obstacle_outside_of_the_colour_image_is_empty() -> None:
    """A narrow colour camera that looks to the left does not see a box to the right."""
    given = made(cast(POSE, [((0.3, 1.2, 0.0), (0.6, 1.5, 0.3))])[None], POSE.plane())
    camera = given.calibration.depth
    narrow = camera._replace(fx=4 * camera.fx, fy=4 * camera.fy)
    calibration = given.calibration._replace(color=narrow, color_from_depth=D435_MOTION)
    detections = found(given._replace(calibration=calibration))
    assert count(detections) == 1
    assert detections.obstacles.uv_min[0, 0].tolist() == [0, 0]
    assert detections.obstacles.uv_max[0, 0].tolist() == [-1, -1]
    alone = found(given)
    np.testing.assert_array_equal(detections.obstacles.a, alone.obstacles.a)


@pytest.mark.parametrize("backend", ["reference", "jax"])
def test_colour_has_no_influence(backend: BackendName) -> None:
    given = made(cast(POSE, [BOX])[None], POSE.plane())
    noise = np.random.default_rng(0).integers(0, 256, given.color.shape).astype(np.uint8)
    want = detect(given, backend=backend)
    for color in (None, noise):
        assert_equal(detect(given._replace(color=color), backend=backend), want)


def test_floor_bent_at_the_margin_is_not_an_obstacle() -> None:
    """The outer tenth of the columns is nearer by up to 8 percent."""
    u = np.arange(160)
    bend = np.maximum(16 - u, u - 143).clip(0)
    depth = cast(POSE, []) * (1 - 0.08 * bend / 16)
    detections = found(made(depth[None], POSE.plane()))
    assert count(detections) == 0
    assert detections.scene and (detections.scene.bottom_top == 0).all()


# simulated


@pytest.mark.parametrize(("family", "things"), [("empty", 0), ("single_box", 1), ("row", 4)])
def test_simulated_families_have_the_expected_obstacles(family: str, things: int) -> None:
    for frame in sample_frames(family, 0, 1, width=320, height=240):
        detections = found(of(frame))
        assert count(detections) == things
        assert detections.scene and floors(detections.scene, UNIT).own[0]


CARTON_BOX = Box((1.5, 0.0), (0.3, 0.4, 0.4), 0.0, CARTON)
LOW_BOX = Box((1.3, 0.0), (0.3, 0.4, 0.15), 0.4, CARTON)
APART = tuple(
    Box((1.8, y), (0.3, 0.4, 0.3), 0.0, look) for y, look in ((0.32, CARTON), (-0.32, RED_CRATE))
)
BEHIND = Box((2.0, 0.0), (0.3, 0.7, 0.3), 0.0, CARTON)
POLE = (Cylinder((1.2, 0.0), 0.03, 0.8, POST),)
LOOKING_DOWN = {"camera_height_m": 0.6, "camera_pitch_rad": 0.45}


def test_sizes_without_noise_are_within_3_cm() -> None:
    """A tall box shows its front, a low box that is seen from above its width and depth."""
    sensor = DepthSensor(enabled=False)
    wide, _, high = sizes(found(of(simulated(CARTON_BOX, sensor=sensor))))[0]
    assert (wide, high) == pytest.approx((0.4, 0.4), abs=0.03)
    low = sizes(found(of(simulated(LOW_BOX, sensor=sensor, **LOOKING_DOWN))))
    np.testing.assert_allclose(low, [[0.4, 0.3, 0.15]], atol=0.03)


def test_sizes_with_stereo_noise_are_smeared_by_few_pixels() -> None:
    """Silhouettes are smeared over three of 192 pixels per radian, on each side."""
    detections = found(of(simulated(CARTON_BOX)))
    wide, _, high = sizes(detections)[0]
    assert count(detections) == 1
    assert wide == pytest.approx(0.4, abs=2 * 3 / 192 * 1.35) and high == pytest.approx(
        0.4, abs=0.03
    )


@pytest.mark.parametrize(
    ("things", "scene"),
    [
        (1, {"boxes": (CARTON_BOX,)}),
        (1, {"boxes": (LOW_BOX,), **LOOKING_DOWN}),
        (2, {"boxes": APART}),
        (2, {"boxes": (BEHIND,), "poles": POLE}),
        (0, {"boxes": ()}),
    ],
    ids=["box", "low box", "a gap apart", "behind a pole", "nothing"],
)
def test_number_of_obstacles_does_not_depend_on_the_prior(things: int, scene: dict) -> None:
    """The mount has an error of 2 degrees of pitch, up or down."""
    settings = {k: v for k, v in scene.items() if k != "boxes"}
    frame = simulated(*scene["boxes"], **settings)
    true = found(of(frame))
    assert count(true) == things
    for wrong_deg in (2.0, -2.0):
        other = found(of(frame, wrong_deg))
        assert count(other) == things
        assert other.scene and floors(other.scene, UNIT).own[0]
        assert np.abs(sizes(other) - sizes(true)).max(initial=0) < 0.05


def test_a_box_behind_a_pole_is_one_obstacle() -> None:
    detections = found(of(simulated(BEHIND, poles=POLE)))
    wide = sizes(detections)[:, 0]
    assert wide[0] < 0.15 and wide[1] == pytest.approx(0.7, abs=0.1)


def test_a_step_down_ends_the_free_floor() -> None:
    floor = Ground(drop_m=0.3, drop_start_m=1.5)
    frame = simulated(floor=floor, camera_height_m=0.5, camera_pitch_rad=0.35)
    detections = found(of(frame))
    scene = detections.scene
    assert count(detections) == 0 and scene
    drops = scene.free_end[0] == FreeEnd.DROP
    assert drops.sum() > 0.5 * (scene.free[0, :, 1] > 0).sum()
    assert set(scene.free_end[0].tolist()) == {FreeEnd.DROP, FreeEnd.UNKNOWN}
    ahead = scene.free[0, :, 1] * np.cos(ray_bearings()[0])
    assert np.median(ahead[drops]) == pytest.approx(1500, abs=60)
    assert ahead.max() < 1600


# laws


def test_batch_is_the_stack_of_singles() -> None:
    other = ((-0.5, 1.6, 0.0), (0.5, 1.9, 0.5))
    depth = np.stack([cast(POSE, [BOX]), cast(POSE, []), np.zeros((120, 160)), cast(POSE, [other])])
    plane = flat_plane(np.full(4, POSE.height), np.full(4, np.radians(POSE.pitch)), np.zeros(4))
    plane = plane._replace(valid=np.array([True, True, True, False]))
    given = made(depth, plane)
    whole = found(given)
    assert whole.num_obstacles.tolist() == [1, 0, 0, 1]
    assert whole.has_depth.tolist() == [True, True, False, True]

    def part(values: Any, b: int) -> Any:
        if values is None or isinstance(values, np.ndarray):
            return None if values is None else values[b : b + 1]
        return type(values)(*(part(v, b) for v in values))

    for b in range(4):
        one = {k: getattr(given, k)[b : b + 1] for k in ("color", "depth", "number", "valid")}
        single = given._replace(**one, plane=part(plane, b))
        assert_equal(part(whole, b), found(single))


def test_mirrored_images_have_mirrored_obstacles() -> None:
    boxes = [BOX, ((0.4, 1.8, 0.0), (0.8, 2.0, 0.5))]
    depth = cast(POSE, boxes)[None]
    one, other = (found(made(d, POSE.plane())) for d in (depth, depth[:, :, ::-1]))
    assert count(one) == count(other) == 2
    here, there = (
        np.sort(metric.rectangles(d.obstacles, 0.001, SURFACES.footprint)[0, :2], axis=1)
        for d in (one, other)
    )
    mirrored = np.sort(here * (-1, 1), axis=1)
    np.testing.assert_allclose(there, mirrored, atol=0.03)
    assert one.scene and other.scene
    same = one.scene.free_end[0] == other.scene.free_end[0, ::-1]
    assert same.mean() > 0.97


def test_the_depth_unit_has_little_influence() -> None:
    depth = cast(POSE, [BOX])[None]
    depth = np.where(depth < 6, depth, 0)
    one, fine = (found(made(depth, POSE.plane(), unit)) for unit in (0.001, 0.0001))
    assert count(one) == count(fine) == 1
    corners = [
        metric.rectangles(d.obstacles, unit, SURFACES.footprint)[0, 0]
        for d, unit in ((one, 0.001), (fine, 0.0001))
    ]
    np.testing.assert_allclose(corners[1], corners[0], atol=0.01)


# edges


@pytest.mark.parametrize("calibration", [D435, Calibration(D435.depth)])
@pytest.mark.parametrize("known", [True, False])
def test_without_depth_there_are_no_obstacles(calibration: Calibration, known: bool) -> None:
    plane = POSE.plane() if known else unknown_plane(1)
    color, depth = np.zeros((1, 480, 640, 3), np.uint8), np.zeros((1, 480, 640), np.uint16)
    detections = found(frames(calibration, color, depth, plane=plane))
    assert count(detections) == 0 and not detections.has_depth[0]
    assert not detections.overflow[0]
    scene = detections.scene
    assert (
        scene
        and not floors(scene, UNIT).own[0]
        and floors(scene, UNIT).refused[0] == Refusal.TOO_LITTLE
    )
    assert not scene.free.any() and (scene.free_end == FreeEnd.UNKNOWN).all()
    assert not any(np.any(part) for part in jax.tree.leaves(detections.obstacles))


def test_floor_is_not_removed_if_it_is_refused() -> None:
    """Floor and box are obstacles if the floor is refused."""
    config = replace(SURFACES, floor=replace(SURFACES.floor, min_share_alone=1.0))
    given = made(cast(POSE, [BOX])[None], None)
    detections = detect(given, config, backend="reference", with_cells=True)
    scene = detections.scene
    assert scene and not floors(scene, UNIT).own[0] and not floors(scene, UNIT).plane.valid[0]
    assert count(detections) >= 1
    assert detections.cells and detections.cells.keep[0].mean() > 0.4
    assert FreeEnd.RANGE not in scene.free_end and FreeEnd.DROP not in scene.free_end


def test_the_floor_search_can_be_disabled() -> None:
    config = replace(SURFACES, ground=GroundConfig(source="none"))
    scene = found(made(cast(POSE, [BOX])[None], None), config).scene
    assert scene and not floors(scene, UNIT).own[0] and not floors(scene, UNIT).plane.valid[0]


def test_surplus_obstacles_are_counted_as_overflow() -> None:
    """17 x 13 squares hang in the air, each a centimetre behind the previous one."""
    depth = np.zeros((1, 120, 160))
    for row in range(13):
        for column in range(17):
            z = 1.5 + 0.01 * (17 * row + column)
            depth[0, 9 * row : 9 * row + 6, 9 * column : 9 * column + 6] = z
    loose = replace(SURFACES.obstacle, forward_gap_m=0.0)
    detections = found(made(depth, unknown_plane(1)), replace(SURFACES, obstacle=loose))
    assert detections.scene and not floors(detections.scene, UNIT).own[0]
    assert count(detections) == MAX_OBSTACLES < 13 * 17
    assert detections.overflow[0]
    assert detections.obstacles.num_points.shape == (1, MAX_OBSTACLES)
    assert (detections.obstacles.num_points > 0).all()


@pytest.mark.parametrize("backend", ["reference", "jax"])
def test_surplus_surfaces_are_not_obstacles(backend: BackendName) -> None:
    """35 x 26 squares hang in the air, all of them too small for obstacles."""
    row, column = np.indices((26, 35))
    z = 1.5 + 0.01 * ((17 * row + column) % 200)
    depth = np.zeros((1, 9 * 26, 9 * 35))
    for down, right in np.ndindex(6, 6):
        depth[0, down::9, right::9] = z
    large = replace(SURFACES, obstacle=replace(SURFACES.obstacle, forward_gap_m=0.0, min_cells=999))
    detections = detect(made(depth, unknown_plane(1)), large, backend=backend)
    assert count(detections) == 0 and detections.overflow[0]


@pytest.mark.parametrize(("height", "width"), [(119, 157), (60, 160), (120, 40)])
def test_a_box_is_found_in_cropped_images_that_contain_it(height: int, width: int) -> None:
    detections = found(made(cast(POSE, [BOX])[None, :height, :width], POSE.plane()))
    assert count(detections) == int(width > 50)


def test_a_box_in_a_large_image_is_found_with_its_width() -> None:
    camera = Intrinsics(1280, 720, 912.0, 912.0, 639.5, 359.5)
    v = (np.arange(720) - camera.cy) / camera.fy
    floor = np.tile(np.where(v > 0.07, 400 / np.maximum(v, 0.07), 65535)[:, None], (1, 1280))
    box = np.full(floor.shape, 65535)
    box[250:, 500:700] = 1100
    depth = np.minimum(floor, box)
    depth = np.where(depth < 65535, depth, 0).astype(np.uint16)
    color = np.zeros((1, 720, 1280, 3), np.uint8)
    plane = flat_plane(*np.array([[0.4], [0.0], [0.0]]))
    detections = found(frames(Calibration(camera), color, depth[None], plane=plane))
    assert count(detections) == 1
    assert sizes(detections)[0, 0] == pytest.approx(200 / 912 * 1.1, abs=0.03)


def test_saturated_depth_has_no_obstacles() -> None:
    """Some drivers send 65535 for missing measurements; for a rotated camera, z exceeds that."""
    depth = np.full((1, 480, 640), 65535, np.uint16)
    color = np.zeros((1, 480, 640, 3), np.uint8)
    assert count(found(frames(D435, color, depth, plane=POSE.plane()))) == 0


# recorded


def judged(shared_data: Path, name: str, config: Config, **changes: Any) -> list[BoxTally]:
    """Evaluate each labelled frame separately, without held-out ones."""
    recording: Recording = next(r for r in RECORDINGS if r.name == name)._replace(**changes)
    tallies = []
    if not (shared_data / recording.place).is_file():
        pytest.skip(f"no {recording.place}")
    with open_log(str(shared_data / recording.place)) as log:
        for batch in log.batches(1):
            given = batch.frames._replace(plane=None)
            number, unit = int(given.number[0]), given.calibration.depth_unit
            if recording.holds_out(number):
                continue
            aligned = align(given.depth, given.calibration)
            z_m = aligned.z[0] * unit
            labels = labels_of(recording, shared_data, number, z_m, given.calibration)
            if labels is None:
                continue
            detections = found(given, config)
            n, scene = count(detections), detections.scene
            assert scene
            boxes = np.concatenate(
                [detections.obstacles.uv_min[0, :n], detections.obstacles.uv_max[0, :n]], axis=1
            )
            nearest = metric.extents(detections.obstacles, unit).minimum[0, :n, 2]
            kept = above_floor(aligned.z, floors(scene, UNIT).plane, given.calibration, config)[0]
            tallies.append(tally_boxes(labels, boxes, nearest, kept, z_m > 0, recording.least_iou))
    return tallies


def test_labelled_objects_on_a_table_are_found(shared_data: Path) -> None:
    tallies = judged(shared_data, "mosd", preset("tabletop"))
    assert len(tallies) == 36
    score = score_boxes(tallies)
    assert score.recall >= 0.9
    assert score.precision >= 0.85
    assert score.swamped == 0


def test_labelled_obstacles_of_a_moving_wheelchair_are_found(shared_data: Path) -> None:
    """Labelled objects above 6.5 cm are required; lower ones are neither missed nor false."""
    tallies = judged(shared_data, "wheelchair", SURFACES, least_height_m=0.065)
    score = score_boxes(tallies)
    assert len(tallies) == 3 and sum(t.objects for t in tallies) == 2
    assert score.recall == 1.0
    assert score.on_floor == 0 and score.swamped == 0


def with_shadows(boxes: list[BoxCorners], upside_down: bool) -> Frames:
    """Return a frame in which nothing is measured behind boxes."""
    depth, plane = cast(POSE, boxes), POSE.plane()
    for box in boxes:
        rows, columns = np.nonzero(cast(POSE, [box]) < cast(POSE, []) - 0.001)
        depth[: rows.min(), columns.min() : columns.max() + 1] = 0
    if upside_down:
        depth, plane = depth[::-1, ::-1], plane._replace(roll=plane.roll + np.pi)
    return made(depth[None], plane)


@pytest.mark.parametrize("upside_down", [False, True])
def test_notches_of_the_free_floor_reveal_objects_lower_than_the_step(
    device: object, upside_down: bool
) -> None:
    """Nothing is measured behind a strip 4 cm high: free floor ends at the strip, and continues on
    both sides of it.
    """
    strips = [((-0.1, 2.0, 0.0), (0.1, 2.1, 0.04))]
    given = with_shadows(strips, upside_down)
    detections = found(given)
    scene = detections.scene
    assert scene and count(detections) == 1 and scene.first_notch[0] == 0
    assert metric.distances(detections)[0, 0] == pytest.approx(2050, abs=55)
    assert 20 < scene.bottom_top[0, 0, 0] <= scene.bottom_top[0, 0, 1] < 45
    assert_equal(detect(given, SURFACES), detections)
    # If the floor behind the strip is measured, the strip counts as floor.
    assert count(found(made(cast(POSE, strips)[None], POSE.plane()))) == 0


@pytest.mark.parametrize("upside_down", [False, True])
def test_objects_in_notches_are_numbered_from_left_to_right(
    device: object, upside_down: bool
) -> None:
    strips = [((x, y, 0.0), (x + 0.2, y + 0.1, 0.04)) for x, y in ((-0.6, 1.9), (0.3, 1.6))]
    given = with_shadows(strips, upside_down)
    detections = found(given)
    scene = detections.scene
    assert scene and count(detections) == 2 and scene.first_notch[0] == 0
    middle = np.asarray(scene.contour)[0, :2, :, 0]
    used = [middle[k, : scene.contour_points[0, k]].mean() for k in range(2)]
    assert used[0] < -400 and used[1] > 300
    assert_equal(detect(given, SURFACES), detections)


def test_nothing_nearer_than_the_depth_range_is_free_floor(device: object) -> None:
    """Neither floor nor boxes count there: rays begin at the depth range, or behind the boxes."""
    boxes = [((-0.1, 0.9, 0.0), (0.1, 1.0, 0.08))]
    given = made(cast(POSE, boxes)[None], POSE.plane())
    for nearest_m in (0.15, 1.6):
        config = replace(SURFACES, ground=replace(SURFACES.ground, min_depth_m=nearest_m))
        detections = found(given, config)
        scene = detections.scene
        assert scene and count(detections) == (nearest_m < 1)
        start, stop = np.asarray(scene.free)[0].T * UNIT
        used = stop > 0
        pitch = np.radians(POSE.pitch)
        ahead = start * np.cos(ray_bearings()[0])
        depth = ahead * np.cos(pitch) + POSE.height * np.sin(pitch)
        assert used.sum() > 50
        assert depth[used & (stop > start)].min() > nearest_m - 0.06
        assert_equal(detect(given, config), detections)


def test_a_low_carton_with_a_hole_in_its_depth_is_found() -> None:
    """As on a real pavement, 7 cells of the carton remain left of the hole and 4 right of it."""
    sensor = DepthSensor(enabled=False)
    carton = Box((3.3, 0.0), (0.25, 0.24, 0.075), 0.0, CARTON)
    scene = Scene("made", (carton,), floor=WOOD, ground=Ground(), path=Way(length=0.0))
    mount = {"camera_height_m": 0.52, "camera_pitch_rad": 0.26, "sensor": sensor}
    given = of(simulate_frame(SimConfig(width=640, height=480, **mount), scene, 0))

    def cells_of(given: Frames) -> np.ndarray:
        bare = replace(SURFACES, obstacle=replace(SURFACES.obstacle, min_cells=1))
        cells = detect(given, bare, backend="reference", with_cells=True).cells
        assert cells
        return np.argwhere(cells.keep[0])

    cells = cells_of(given)
    top, left = cells.min(axis=0)
    holes = [(row, left + column) for row in (0, 1) for column in (4, 5, 6, 7)] + [(1, left + 3)]
    for row, column in holes:
        place = (slice(3 * (top + row), 3 * (top + row + 1)), slice(3 * column, 3 * (column + 1)))
        given.depth[0][place] = 0
    parts = cells_of(given)[:, 1] < left + 5.5
    assert len(cells) == 20 and (parts.sum(), (~parts).sum()) == (7, 4)
    part = replace(SURFACES.surface, hole_cells=0)
    before = replace(SURFACES, surface=part, obstacle=replace(SURFACES.obstacle, min_cells=8))
    by_surface = [detect(given, config, backend="reference").scene for config in (before, SURFACES)]
    assert [int(scene.first_notch[0]) for scene in by_surface if scene] == [0, 1]
    detections = found(given)
    assert count(detections) >= 1
    assert metric.distances(detections)[0, 0] == pytest.approx(3175, abs=40)
