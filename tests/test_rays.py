"""rays: free floor along fixed bearings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.config import GroundConfig
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.floor.rays import TILE, TURN, half_turn, ray_directions, tile_corners
from jaxdet.reference._rays import NONE, Standing, bearings, blocks, rays
from jaxdet.types import RAYS, FreeEnd, Intrinsics

CAMERA = Intrinsics(640, 480, 380.0, 380.0, 319.5, 239.5)
HALF = half_turn(CAMERA, 3)
AHEAD = RAYS // 2
NOTHING = np.full(RAYS, NONE)


def fan(
    stop: list[int], end: list[int], start: int = 500, behind: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the free floor of columns a cell apart, from ``start`` to ``stop`` forward [mm].

    The columns meet ``behind`` behind the foot, as for a camera that looks down.
    """
    slope = np.tan((np.arange(len(stop)) - (len(stop) - 1) / 2) * 0.0079)
    ahead = np.array([[start] * len(stop), stop])
    places = np.stack([slope * (ahead + behind), ahead], axis=-1)
    return np.rint(places).astype(np.int32).transpose(1, 0, 2), np.array(end, np.int32)


def block(*places: tuple[int, int], wide: int = 1) -> np.ndarray:
    """Return the ranges of obstacles at these positions, on their rays and ``wide`` neighbours."""
    nearest = NOTHING.copy()
    for right, forward in places:
        ray = AHEAD + round(np.degrees(np.arctan2(right, forward)) * 4)
        near = nearest[ray - wide : ray + wide + 1]
        near[:] = np.minimum(near, int(np.hypot(right, forward)))
    return nearest


def found(
    columns: tuple[np.ndarray, np.ndarray], stands: np.ndarray = NOTHING
) -> tuple[np.ndarray, np.ndarray]:
    free, end = rays(*columns, stands, HALF)
    assert free.dtype == end.dtype == np.int32 and free.shape == (RAYS, 2)
    return free, end


ROWS, COLUMNS = 19, 31
CELLS = np.rint(
    np.stack(np.meshgrid(np.arange(COLUMNS) - 15, np.arange(ROWS) - 9)) * 0.0079 * (1 << 20)
).astype(np.int64)
"""Rays of a small camera, level and 0.25 m above the floor."""
FLOOR_AT = 250 / (9 * 0.0079)
"""Depth of the floor in row 18 [mm]."""


def stands_of(
    pixel: dict[tuple[int, int], int],
    z: dict[tuple[int, int], int] | None = None,
    frame: np.ndarray | None = None,
) -> np.ndarray:
    """Return the ranges of obstacles from depths by (row, column): of pixels, and of cells above
    the step height."""
    if frame is None:
        frame = floor_frames(flat_plane(np.array([0.25]), np.zeros(1), np.zeros(1)), 0.001)[0]
    pixels, depths = np.zeros((2, ROWS, COLUMNS), np.int64)
    for values, to in ((pixel, pixels), (z or {}, depths)):
        for place, depth in values.items():
            to[place] = depth
    standing = Standing(pixels, depths, depths > 0)
    return blocks(standing, frame, CELLS, GroundConfig(), 0.001)


# by hand


@given(st.integers(-9000, 9000), st.integers(-9000, 9000))
def test_bearings_equal_arctan2(right: int, forward: int) -> None:
    units = int(bearings(np.array([right]), np.array([forward]))[0])
    apart = units - np.arctan2(right, forward) * TURN / (2 * np.pi)
    assert abs((apart + TURN / 2) % TURN - TURN / 2) <= 1 or right == forward == 0


def test_the_angle_of_half_a_cell_used_here_is_that_of_a_d435() -> None:
    assert pytest.approx(1.5 / 380, rel=0.02) == HALF / (1 << 13)


def test_corners_of_tiles_lie_between_their_cells() -> None:
    corners = tile_corners(CELLS)
    rows = [*range(0, ROWS, TILE), ROWS]
    assert corners.shape == (2, len(rows), COLUMNS + 1)
    np.testing.assert_allclose(corners[0, 0], (np.arange(COLUMNS + 1) - 15.5) * 8283.75, atol=2)
    np.testing.assert_allclose(corners[1, :, 0], (np.array(rows) - 9.5) * 8283.75, atol=2)
    assert tile_corners(np.ones((2, 1, 1), np.int64)).tolist() == [[[1, 1]] * 2] * 2


def test_rays_ahead_and_to_the_right_have_exact_directions() -> None:
    ahead, edges = ray_directions()
    assert ahead[AHEAD].tolist() == [0, 8192] and ahead[AHEAD + RAYS // 4].tolist() == [8192, 0]
    assert edges[AHEAD, 0] < 0 < edges[AHEAD + 1, 0]


def test_columns_of_a_level_camera_are_rays() -> None:
    free, end = found(fan([3000] * 41, [FreeEnd.RANGE] * 41))
    seen = np.flatnonzero(free[:, 1])
    assert seen.tolist() == list(range(seen[0], seen[-1] + 1))
    bearing = np.radians((seen - AHEAD) / 4)
    np.testing.assert_allclose(free[seen[2:-2], 0] * np.cos(bearing[2:-2]), 500, atol=2)
    np.testing.assert_allclose(free[seen[2:-2], 1] * np.cos(bearing[2:-2]), 3000, atol=8)
    assert (end[seen[2:-2]] == FreeEnd.RANGE).all()
    assert np.ptp(bearing) == pytest.approx(41 * 0.0079, abs=0.011)


def test_a_shorter_column_extends_halfway_to_its_neighbours() -> None:
    stop, end = [3000] * 41, [FreeEnd.RANGE] * 41
    stop[20], end[20] = 1000, FreeEnd.UNKNOWN
    free, why = found(fan(stop, end))
    short = np.flatnonzero((free[:, 1] > 0) & (free[:, 1] < 1100)) - AHEAD
    assert short.min() < 0 < short.max() and 2 <= len(short) <= 4
    assert (why[short + AHEAD] == FreeEnd.UNKNOWN).all()


def test_a_ray_of_a_pitched_camera_leaves_its_column() -> None:
    """Farther out the ray enters a column whose floor ends nearer, at an obstacle."""
    columns = 81
    stop, end = [3000] * columns, [FreeEnd.RANGE] * columns
    stop[60:70], end[60:70] = [1000] * 10, [FreeEnd.OBSTACLE] * 10
    free, why = found(fan(stop, end, behind=500))
    meets = np.flatnonzero((free[:, 1] > 1100) & (free[:, 1] < 2800))
    meets = meets[np.abs(meets - AHEAD - 44) < 20]  # other rays leave the image at its sides
    assert len(meets) >= 4 and (why[meets] == FreeEnd.UNKNOWN).all()
    bearing = np.radians((meets - AHEAD) / 4)
    right, forward = free[meets, 1] * np.array([np.sin(bearing), np.cos(bearing)])
    line = np.tan((60 - 40 - 0.5) * 0.0079)  # between the columns 59 and 60
    np.testing.assert_allclose(right / (forward + 500), line, atol=0.006)


def test_obstacles_on_the_floor_end_rays() -> None:
    free, end = found(fan([3000] * 41, [FreeEnd.RANGE] * 41), block((0, 1500)))
    ends = np.flatnonzero(end == FreeEnd.OBSTACLE) - AHEAD
    assert ends.tolist() == [-1, 0, 1] and (free[ends + AHEAD, 1] == 1500).all()
    behind, _ = found(fan([3000] * 41, [FreeEnd.RANGE] * 41), block((0, 3500)))
    assert behind[AHEAD, 1] == 3000


def test_a_ray_without_visible_floor_ends_at_an_obstacle() -> None:
    columns = np.zeros((41, 2, 2), np.int32), np.zeros(41, np.int32)
    free, end = found(columns, block((100, 1600), wide=0))
    at = AHEAD + round(np.degrees(np.arctan2(100, 1600)) * 4)
    assert np.flatnonzero(free.any(axis=1)).tolist() == [at] and end[at] == FreeEnd.OBSTACLE
    assert free[at].tolist() == [1603, 1603]


def test_the_nearest_pixel_of_a_tile_blocks_its_sectors() -> None:
    stands = stands_of({(9, 15): 2000, (10, 15): 1500, (9, 20): 1800})
    ahead = np.flatnonzero(stands < NONE) - AHEAD
    aside = np.degrees(np.arctan([4.5 * 0.0079, 5.5 * 0.0079])) * 4
    assert ahead.tolist() == [-1, 0, 1, *range(round(aside[0]), round(aside[1]) + 1)]
    assert (stands[AHEAD - 1 : AHEAD + 2] == 1500).all()
    assert stands[AHEAD + 9] == int(np.hypot(1800, 5 * 0.0079 * 1800))


def test_a_pixel_on_the_floor_does_not_block_rays() -> None:
    place, floor = (18, 15), round(FLOOR_AT)
    assert (stands_of({place: round(floor * 0.97)}) == NONE).all()
    assert stands_of({place: round(floor * 0.6)})[AHEAD] == round(floor * 0.6)


def test_a_cell_blocks_rays_if_its_nearest_pixel_is_too_near_or_on_the_floor() -> None:
    place, floor = (18, 15), round(FLOOR_AT)
    assert stands_of({place: 20}, {place: 2000})[AHEAD] == 2000
    assert stands_of({place: 1900}, {place: 2000})[AHEAD] == 1900
    assert stands_of({place: floor}, {place: floor})[AHEAD] == floor


def test_all_pixels_block_rays_if_the_floor_is_unknown() -> None:
    frame = floor_frames(unknown_plane(1), 0.001)[0]
    assert stands_of({(18, 15): 3900}, frame=frame)[AHEAD] == 3900


def test_an_object_above_the_foot_blocks_all_sectors() -> None:
    down = flat_plane(np.array([0.9]), np.array([np.pi / 2]), np.zeros(1))
    stands = stands_of({(9, 15): 700}, frame=floor_frames(down, 0.001)[0])
    assert (stands < 20).all()


def test_floor_on_both_sides_of_the_foot_begins_at_the_foot() -> None:
    free, end = found(fan([3000] * 41, [FreeEnd.RANGE] * 41, start=-400, behind=5000))
    assert (free[:, 0] == 0).all() and (free[:, 1] > 0).all()
    assert free[0, 1] == pytest.approx(400, abs=2) and free[AHEAD, 1] == pytest.approx(3000, abs=2)
    assert end[0] == FreeEnd.UNKNOWN


def test_without_columns_and_obstacles_no_floor_is_free() -> None:
    free, end = found((np.zeros((9, 2, 2), np.int32), np.zeros(9, np.int32)))
    assert not free.any() and not end.any()


# laws

lengths = st.lists(st.integers(600, 4000), min_size=2, max_size=60)
points = st.lists(
    st.tuples(st.integers(-2000, 2000), st.integers(300, 4000)), min_size=1, max_size=20
)


@given(lengths, points, st.integers(0, 800))
def test_no_ray_passes_an_obstacle_point(stop: list[int], places: list, behind: int) -> None:
    free, _ = found(fan(stop, [FreeEnd.RANGE] * len(stop), behind=behind), block(*places))
    for right, forward in places:
        ray = AHEAD + round(np.degrees(np.arctan2(right, forward)) * 4)
        assert free[ray, 1] <= np.hypot(right, forward) + 2
