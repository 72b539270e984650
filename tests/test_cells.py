"""cells: square blocks of depth pixels, each with a robust depth, a position and a box."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.camera import cell_side
from jaxdet.config import Config, GroundConfig, SurfaceConfig
from jaxdet.errors import CalibrationError
from jaxdet.floor.plane import step_height
from jaxdet.presets import preset
from jaxdet.reference import cells
from jaxdet.reference._cells import cell_boxes
from jaxdet.reference.paper import align
from jaxdet.types import Calibration, Extrinsics, Intrinsics
from tests.scenes import (
    D435,
    D435_COLOR,
    D435_DEPTH,
    D435_MOTION,
    IDENTITY,
    LENSES,
    assert_equal,
    noise_depth,
    rotation,
    small,
    smooth_depth,
    with_lens,
)

TWO = SurfaceConfig(cell_rad=0.02, step_m=0.01, step_per_m=0.0)
"""Configuration with cells of 2 x 2 pixels of CAMERA and a step of 10 mm at any depth."""
CAMERA = Intrinsics(5, 4, 100.0, 100.0, 1.5, 1.5)
THREE = SurfaceConfig(cell_rad=0.0078)


def one_cell(block: object, config: SurfaceConfig = TWO) -> int:
    """Return the depth of a cell with these pixels."""
    depth = np.array(block, np.uint16)[None]
    camera = Intrinsics(depth.shape[2], depth.shape[1], 100.0, 100.0, 0.5, 0.5)
    return int(cells(depth, Calibration(camera), config).z[0, 0, 0])


# by hand


def test_only_complete_cells_are_in_the_grid() -> None:
    depth = np.array(
        [[100, 101, 700, 700, 9], [102, 105, 700, 700, 9], [500, 0, 0, 0, 9], [0, 504, 0, 400, 9]],
        np.uint16,
    )
    grid = cells(depth[None], Calibration(CAMERA), TWO)
    assert grid.z.tolist() == [[[102, 700], [502, 0]]]
    assert grid.x.tolist() == [[[-1, 7], [-5, 0]]]  # (0.5 - 1.5) / 100 z, (2.5 - 1.5) / 100 z
    assert grid.y.tolist() == [[[-1, -7], [5, 0]]]
    assert {a.dtype.name for a in grid} == {"int32"}
    first, last, inside = cell_boxes(grid.z, Calibration(CAMERA), 2)
    assert first.tolist() == [[[[0, 0], [2, 0]], [[0, 2], [0, 0]]]]
    assert last.tolist() == [[[[1, 1], [3, 1]], [[1, 3], [0, 0]]]]
    assert inside.tolist() == [[[True, True], [True, False]]]


@pytest.mark.parametrize(
    ("block", "depth"),
    [
        ([[900, 905], [2000, 2010]], 903),  # lower median 905; 902.5 is rounded up
        ([[900, 2005], [2000, 2010]], 2005),  # mostly background
        ([[900, 910], [911, 890]], 900),  # lower median 900: 911 is 11 mm away
        ([[0, 900], [0, 2000]], 900),  # half of the pixels are enough
        ([[0, 900], [0, 0]], 0),  # less than half are not
        ([[0, 0], [0, 0]], 0),
        ([[1, 1], [1, 2]], 1),
        ([[65535, 65535], [65535, 65534]], 65535),
    ],
)
def test_depth_of_a_cell_is_the_mean_near_its_lower_median(
    block: list[list[int]], depth: int
) -> None:
    assert one_cell(block) == depth


def test_the_step_within_a_cell_grows_with_depth_squared() -> None:
    config = SurfaceConfig(cell_rad=0.02, step_m=0.01, step_per_m=0.01)
    assert one_cell([[1000, 1020], [1021, 1021]], config) == 1016  # step: 20 mm at 1.02 m
    assert one_cell([[3000, 3100], [3100, 3100]], config) == 3075  # step: 106 mm at 3.1 m
    assert one_cell([[2990, 3100], [3100, 3100]], config) == 3100


@pytest.mark.parametrize(
    ("focal", "side", "at_4_m"), [(192.25, 1, 62), (384.5, 3, 54), (769.0, 6, 52)]
)
def test_the_step_height_grows_less_for_cells_with_more_pixels(
    focal: float, side: int, at_4_m: int
) -> None:
    """The height is 5 cm, plus 3 mm per metre of depth divided by the side of a cell [pixel]."""
    config = Config(GroundConfig(step_height_m=0.05, step_height_per_m=0.003), surface=THREE)
    camera = Intrinsics(640, 480, focal, focal, 319.5, 239.5)
    steps = step_height(Calibration(camera), config).table
    assert cell_side(camera, THREE.cell_rad) == side
    assert (steps.shape, steps[0], steps[4000]) == ((65536,), 50, at_4_m)
    apart = Calibration(camera, D435_COLOR, D435_MOTION)
    np.testing.assert_array_equal(step_height(apart, config).table, steps)
    tenths = step_height(Calibration(camera, depth_unit=0.0001), config).table
    assert (tenths[0], tenths[40_000]) == (500, round(500 + 120 / side))


def test_step_height_of_tabletop_grows_with_distance() -> None:
    """The height grows by 4 mm per metre for cells of a Kinect, the camera of the training data."""
    kinect = Calibration(Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5))
    expected = np.rint(8 + 0.004 * np.arange(65536)).astype(np.int64)
    np.testing.assert_array_equal(step_height(kinect, preset("tabletop")).table, expected)


@pytest.mark.parametrize("unit", [0.001, 0.0001, 0.01])
@pytest.mark.parametrize(("focal", "side"), [(192.25, 1), (384.5, 3)])
def test_step_height_includes_at_most_noise_by_depth_and_camera_height(
    unit: float, focal: float, side: int
) -> None:
    ground = GroundConfig(step_height_m=0.05, step_height_per_m=0.0, noise_per_m=0.06)
    camera = Calibration(Intrinsics(640, 480, focal, focal, 319.5, 239.5), depth_unit=unit)
    steps, z = step_height(camera, Config(ground, surface=THREE)), np.arange(400) * 0.01
    for height in (-1.0, 0.0, 0.3, 1.3):
        want = np.maximum(0.05, 0.06 / side * max(height, 0.0) * z)
        noise = steps.most_noise(round(height / unit))
        got = steps.at(np.rint(z / unit).astype(int), noise) * unit
        np.testing.assert_allclose(got, want, rtol=0.005, atol=1.5 * unit)
    # For any height of the floor, the product fits in 32 bits.
    high = steps.at(np.array([65535]), steps.most_noise(1 << 20))
    assert 0 < high[0] <= 65535 * 2


def test_steps_are_in_metres_whatever_the_depth_unit() -> None:
    """The step is in metres, the depths are in depth units."""
    camera = Intrinsics(2, 2, 100.0, 100.0, 0.5, 0.5)
    depth = np.array([[[9000, 9050], [9100, 9140]]], np.uint16)
    fine, coarse = Calibration(camera, depth_unit=0.0001), Calibration(camera)
    assert cells(depth, fine, TWO).z[0, 0, 0] == 9073  # mean of all four depths
    assert cells(depth, coarse, TWO).z[0, 0, 0] == 9050


def test_position_lies_on_the_ray_through_the_centre() -> None:
    """The position is ``P = d K^-1 p`` rounded to the nearest unit, for any colour camera."""
    depth = smooth_depth(1, D435_DEPTH)
    depth[0, :200] = 2000
    grid, side = cells(depth, D435, THREE), cell_side(D435_DEPTH, THREE.cell_rad)
    flat = np.zeros(grid.z.shape[1:], bool)
    flat[: 200 // side] = True
    row, column = np.nonzero(flat)
    middle = np.stack([column, row, 0 * row]) * side + (side - 1) / 2
    middle[2] = 1.0
    points = np.linalg.inv(D435_DEPTH.K) @ middle * 2000
    found = np.stack([grid.x[0][flat], grid.y[0][flat], grid.z[0][flat]])
    assert np.abs(found - points).max() <= 1.0


@pytest.mark.parametrize("color_scale", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.0, 0.74, 0.59)])
def test_box_contains_the_projected_pixels(color_scale: float, turn: tuple) -> None:
    """With a rotated colour camera, aligned pixels may be one pixel outside of their cell's box."""
    motion = Extrinsics(rotation(*turn), (0.0143, 0.0006, 0.0006))
    calibration = small(color_scale=color_scale)._replace(color_from_depth=motion)
    config = SurfaceConfig(cell_rad=4 / calibration.depth.fx)
    rng, slack, held = np.random.default_rng(3), int(any(turn)), 0
    for _ in range(60):
        row, column = rng.integers(0, 15), rng.integers(0, 20)
        depth = np.zeros((1, 60, 80), np.uint16)
        depth[0, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4] = rng.integers(300, 5000)
        hit = np.argwhere(align(depth, calibration).depth[0])[:, ::-1]
        boxes = cell_boxes(cells(depth, calibration, config).z, calibration, 4)
        first, last, inside = (part[0, row, column] for part in boxes)
        if len(hit):
            assert inside
            assert (hit.min(axis=0) >= first - slack).all()
            assert (hit.max(axis=0) <= last + slack).all()
            tall, wide = last - first
            assert max(tall, wide) <= 4 * 1.6 * color_scale + 2
            held += 1
    assert held > 15


def test_cells_outside_of_the_colour_image_have_no_box() -> None:
    """The depth camera has the wider field of view: such cells are measured, but have no box."""
    grid = cells(np.full((1, 480, 640), 1000, np.uint16), D435, THREE)
    assert (grid.z == 1000).all()
    _, _, inside = cell_boxes(grid.z, D435, cell_side(D435_DEPTH, THREE.cell_rad))
    assert not inside[0, 0, 0]
    assert inside[0, 80, 110]
    there = D435_MOTION.T[:3, :3] @ np.stack(grid).reshape(3, -1) + 1000 * D435_MOTION.T[:3, 3:]
    x, y, z = there.reshape(3, *grid.z.shape)
    u = D435_COLOR.fx * x / z + D435_COLOR.cx
    v = D435_COLOR.fy * y / z + D435_COLOR.cy
    deep = (u > 6) & (u < 633) & (v > 6) & (v < 473)
    far = (u < -6) | (u > 646) | (v < -6) | (v > 486)
    assert inside[deep].all()
    assert not inside[far].any()


@pytest.mark.parametrize("lens", ["pinhole", "inverse", "plumb_bob", "rational", "equidistant"])
def test_cells_outside_of_the_lens_model_have_no_box(lens: str) -> None:
    """As in ``align``, rays outside the range of the lens model are not in the colour image."""
    assert lens in LENSES
    calibration = D435._replace(color=with_lens(D435_COLOR, lens))
    depth = np.zeros((1, 480, 640), np.uint16)
    depth[0, :30, :30] = 1000
    assert not align(depth, calibration).depth.any()
    side = cell_side(D435_DEPTH, THREE.cell_rad)
    assert not cell_boxes(cells(depth, calibration, THREE).z, calibration, side)[2].any()


# laws


@given(st.integers(0, 2**32 - 1))
def test_batch_is_the_stack_of_singles(seed: int) -> None:
    calibration = small(41, 31)
    depth = noise_depth(3, calibration.depth, seed)
    whole = cells(depth, calibration, SurfaceConfig(cell_rad=0.05))
    for b in range(3):
        single = cells(depth[b : b + 1], calibration, SurfaceConfig(cell_rad=0.05))
        assert_equal(type(whole)(*(a[b : b + 1] for a in whole)), single)


@given(st.lists(st.integers(0, 3000), min_size=9, max_size=9), st.permutations(range(9)))
def test_the_order_of_the_pixels_of_a_cell_has_no_influence(
    values: list[int], order: list[int]
) -> None:
    config = SurfaceConfig(cell_rad=0.03)
    block = np.array(values)
    mixed = block[order]
    assert one_cell(block.reshape(3, 3), config) == one_cell(mixed.reshape(3, 3), config)


@given(st.integers(0, 2**32 - 1))
def test_the_depth_of_a_cell_is_within_that_of_its_pixels(seed: int) -> None:
    camera = Intrinsics(24, 18, 100.0, 100.0, 11.5, 8.5)
    depth = noise_depth(1, camera, seed)
    z = cells(depth, Calibration(camera), SurfaceConfig(cell_rad=0.03)).z
    blocks = depth.reshape(1, 6, 3, 8, 3).swapaxes(2, 3).reshape(1, 6, 8, 9)
    measured = np.where(blocks > 0, blocks, 65535)
    seen = (blocks > 0).sum(axis=-1) >= 5
    np.testing.assert_array_equal(z > 0, seen)
    assert (z[seen] >= measured.min(axis=-1)[seen]).all()
    assert (z[seen] <= blocks.max(axis=-1)[seen]).all()


def test_a_mirrored_image_has_mirrored_cells() -> None:
    camera = Intrinsics(24, 18, 100.0, 100.0, 11.5, 8.5)
    depth, config = noise_depth(1, camera), SurfaceConfig(cell_rad=0.03)
    one = cells(depth, Calibration(camera), config)
    other = cells(depth[:, :, ::-1], Calibration(camera), config)
    np.testing.assert_array_equal(other.z, one.z[:, :, ::-1])
    assert np.abs(other.x + one.x[:, :, ::-1]).max() <= 1
    first, _, seen = cell_boxes(other.z, Calibration(camera), 3)
    _, last, _ = cell_boxes(one.z, Calibration(camera), 3)
    np.testing.assert_array_equal(first[seen, 0], 23 - last[:, :, ::-1, 0][seen])


# edges


@pytest.mark.parametrize("calibration", [D435, Calibration(D435_COLOR)])
def test_without_depth_all_cells_are_empty(calibration: Calibration) -> None:
    grid = cells(np.zeros((2, 480, 640), np.uint16), calibration, THREE)
    assert not np.concatenate(grid).any()
    assert not cell_boxes(grid.z, calibration, 3)[2].any()


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (639, 479), (7, 5), (1, 1)])
def test_grid_of_any_image_size_has_complete_cells_only(width: int, height: int) -> None:
    camera = Intrinsics(width, height, 640.0, 640.0, width / 2, height / 2)
    side = cell_side(camera, THREE.cell_rad)
    assert side == 5
    motion = Extrinsics(IDENTITY, (0.0, 0.0, 0.0))
    for calibration in (Calibration(camera), Calibration(camera, camera, motion)):
        grid = cells(np.full((1, height, width), 800, np.uint16), calibration, THREE)
        assert grid.z.shape == (1, height // 5, width // 5)
        _, last, inside = cell_boxes(grid.z, calibration, side)
        assert last.shape == (1, height // 5, width // 5, 2)
        assert (grid.z == 800).all() and inside.all()


def test_a_cell_is_at_least_a_pixel() -> None:
    camera = Intrinsics(3, 2, 10.0, 10.0, 1.0, 0.5)
    depth = np.arange(600, 606, dtype=np.uint16).reshape(1, 2, 3)
    grid = cells(depth, Calibration(camera), SurfaceConfig(cell_rad=0.001))
    np.testing.assert_array_equal(grid.z, depth)
    first, last, _ = cell_boxes(grid.z, Calibration(camera), 1)
    np.testing.assert_array_equal(first, last)


def test_an_invalid_calibration_is_an_error() -> None:
    depth = np.ones((1, 10, 10), np.uint16)
    wide = Intrinsics(10, 10, 1.0, 1.0, 5.0, 5.0)
    with pytest.raises(CalibrationError, match="field of view is too wide"):
        cells(depth, Calibration(wide), THREE)
    with pytest.raises(CalibrationError, match="no extrinsics"):
        cell_boxes(np.ones((1, 2, 2), np.int32), Calibration(CAMERA, CAMERA), 2)
