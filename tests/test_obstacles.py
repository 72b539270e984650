"""obstacles: surfaces that belong together, by number and by distance."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.config import ObstacleConfig
from jaxdet.reference._obstacles import View, extents, obstacles

UNIT, CELL, FAR = 0.001, 0.01, 6000
CONFIG = ObstacleConfig(
    depth_gap_m=0.12,
    depth_slope=0.25,
    narrow_m=0.25,
    lateral_gap_m=0.20,
    forward_gap_m=0.20,
    overlap_gap_m=0.35,
    min_size_m=0.05,
    min_cells=4,
)
ROWS, COLUMNS = 24, 120


class Picture:
    """A frame of cells: upright things painted over a level floor 0.4 m below the camera."""

    def __init__(self) -> None:
        row, column = np.indices((ROWS, COLUMNS))
        self.ray_x, self.ray_y = CELL * (column - COLUMNS // 2), CELL * (row - 4) * 1.5
        floor = np.where(self.ray_y > 0, 400 / np.maximum(self.ray_y, 1e-6), 0)
        self.z = np.where(floor < 8000, np.rint(floor), 0).astype(np.int64)
        self.label = np.full(self.z.shape, -1)

    def paint(self, rows: slice, columns: slice, z: int) -> "Picture":
        """One more surface, nearer than what is there."""
        self.z[rows, columns] = z
        self.label[rows, columns] = self.label.max() + 1
        return self

    def hole(self, rows: slice, columns: slice) -> "Picture":
        """Nothing measured."""
        self.z[rows, columns], self.label[rows, columns] = 0, -1
        return self

    @property
    def view(self) -> View:
        x, y = (np.rint(ray * self.z).astype(np.int64) for ray in (self.ray_x, self.ray_y))
        height = np.where(self.z > 0, 400 - y, 0)
        return View(x, y, self.z, x, self.z, height, self.z > 0)

    def found(self, config: ObstacleConfig = CONFIG) -> np.ndarray:
        return obstacles(self.label, self.label >= 0, self.view, FAR, UNIT, config)

    def numbers(self, config: ObstacleConfig = CONFIG) -> list[int]:
        """The obstacle of each surface, in the order painted; all its cells have the same."""
        label = self.found(config)
        each = [np.unique(label[self.label == n]) for n in range(self.label.max() + 1)]
        assert all(len(one) == 1 for one in each)
        return [int(one[0]) for one in each]


TALL, LOW = slice(2, 20), slice(14, 20)


# by hand


def test_by_distance() -> None:
    picture = Picture().paint(TALL, slice(5, 45), 2500).paint(TALL, slice(70, 110), 1500)
    assert picture.numbers() == [1, 0]


def test_at_the_same_distance_from_left_to_right() -> None:
    picture = Picture().paint(TALL, slice(70, 110), 1500).paint(TALL, slice(5, 45), 1500)
    assert picture.numbers() == [1, 0]


def test_a_thing_behind_a_pole_is_one() -> None:
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2000)
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    assert picture.numbers() == [1, 1, 0]


def test_what_one_sees_through_parts() -> None:
    """The same without the pole: floor and wall are seen between the two."""
    picture = Picture().paint(slice(0, 24), slice(0, 120), 5000)
    picture.paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2000)
    _, left, right = picture.numbers()
    assert left != right
    open_floor = Picture().paint(LOW, slice(30, 55), 2000).paint(LOW, slice(60, 85), 2000)
    left, right = open_floor.numbers()
    assert left != right


def test_two_things_behind_a_pole_at_different_distances() -> None:
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2600)
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    assert picture.numbers() == [1, 2, 0]


def test_a_thing_that_hides_too_much() -> None:
    """Five columns at 2 m hide 0.1 m, sixty 1.2 m."""
    picture = Picture().paint(TALL, slice(5, 30), 2000).paint(TALL, slice(90, 115), 2000)
    picture.paint(slice(0, 24), slice(30, 90), 1200)
    left, right, _ = picture.numbers()
    assert left != right
    left, right, _ = picture.numbers(replace(CONFIG, hidden_m=1.5))
    assert left == right


@pytest.mark.parametrize(("hole_m", "same"), [(0.6, True), (0.3, False)])
def test_across_holes(hole_m: float, same: bool) -> None:
    """20 columns at 2 m without depth are 0.42 m from the one surface to the other."""
    picture = Picture().paint(TALL, slice(25, 50), 2000).paint(TALL, slice(70, 95), 2000)
    picture.hole(slice(0, 24), slice(50, 70))
    left, right = picture.numbers(replace(CONFIG, hole_m=hole_m))
    assert (left == right) == same


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_slanted_thing_behind_a_pole(mirrored: bool) -> None:
    """Depths agree within 0.12 m and a fourth of the way between, 0.15 m here."""
    near, far = (slice(60, 85), slice(30, 55)) if mirrored else (slice(30, 55), slice(60, 85))
    picture = Picture().paint(TALL, near, 2000).paint(TALL, far, 2135)
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    left, right, _ = picture.numbers()
    assert left == right


def test_legs_are_one_and_walls_are_not() -> None:
    """Two things 0.15 m apart: narrow ones are one, wide ones stand on their own."""
    gap = 8
    legs = Picture().paint(TALL, slice(40, 46), 2000).paint(TALL, slice(46 + gap, 60), 2000)
    left, right = legs.numbers()
    assert left == right
    left, right = legs.numbers(replace(CONFIG, narrow_m=0.0))
    assert left != right
    wide = Picture().paint(TALL, slice(10, 50), 2000).paint(TALL, slice(50 + gap, 98), 2000)
    left, right = wide.numbers()
    assert left != right


def test_legs_too_far_apart() -> None:
    apart = Picture().paint(TALL, slice(30, 36), 2000).paint(TALL, slice(56, 62), 2000)
    left, right = apart.numbers()
    assert left != right
    behind = Picture().paint(TALL, slice(30, 36), 2000).paint(TALL, slice(38, 44), 2500)
    left, right = behind.numbers()
    assert left != right


def test_what_hangs_belongs_to_what_stands() -> None:
    config, low, high = replace(CONFIG, narrow_m=0.0), slice(12, 22), slice(0, 4)
    hangs = Picture().paint(low, slice(50, 70), 1500).paint(high, slice(60, 75), 1700)
    assert hangs.numbers(config) == [0, 0]
    assert hangs.numbers(replace(config, hanging_m=0.0)) == [0, 1]
    assert hangs.numbers(replace(config, hanging_reach_m=0.15)) == [0, 1]
    away = Picture().paint(low, slice(50, 70), 1500).paint(high, slice(60, 75), 2500)
    assert away.numbers(config) == [0, 1]


def test_a_fragment_joins_what_it_touches() -> None:
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(slice(8, 10), slice(55, 58), 2080)
    assert picture.numbers(replace(CONFIG, narrow_m=0.0)) == [0, 0]


def test_too_small_or_too_far_is_none() -> None:
    small = Picture().paint(slice(10, 12), slice(30, 32), 1000)
    assert small.numbers() == [-1]
    assert small.numbers(replace(CONFIG, min_size_m=0.0)) == [0]
    assert Picture().paint(TALL, slice(30, 60), FAR + 1).numbers() == [-1]
    assert Picture().paint(TALL, slice(30, 60), FAR).numbers() == [0]
    few = Picture().paint(slice(10, 13), slice(30, 40), 2000)
    assert few.numbers(replace(CONFIG, min_cells=30)) == [0]
    assert few.numbers(replace(CONFIG, min_cells=31)) == [-1]


def test_what_is_not_in_the_colour_image_is_not_shown() -> None:
    picture = Picture().paint(TALL, slice(0, 30), 2000).paint(TALL, slice(60, 90), 2500)
    view = picture.view._replace(in_view=np.indices(picture.z.shape)[1] >= 40)
    label = obstacles(picture.label, picture.label >= 0, view, FAR, UNIT, CONFIG)
    np.testing.assert_array_equal(label, np.where(picture.label == 1, 0, -1))


def test_the_walls_of_a_room_are_parted_at_its_corner() -> None:
    """A wall to the left, 2 m long, and one across, 1 m behind the chord of their ends."""
    picture = Picture()
    side = np.rint(-800 / np.minimum(picture.ray_x[0], -0.16)).astype(np.int64)
    line = np.where(np.arange(COLUMNS) < 36, np.minimum(side, 3000), 3000)
    picture.z[:20] = line
    picture.label[:20] = 0
    label = picture.found()
    assert label.max() == 1 and (label[:20] >= 0).all()
    (corner,) = np.unique(np.diff(label[:20], axis=1).nonzero()[1])
    assert abs(corner - np.argmax(line == 3000)) <= 3
    assert picture.found(replace(CONFIG, bend_m=0.0)).max() == 0


def test_extents_pass_over_a_twentieth() -> None:
    picture = Picture().paint(slice(8, 18), slice(40, 80), 1000).paint(TALL, slice(0, 1), 3000)
    known = extents(picture.label, picture.view)
    assert known.cells.tolist() == [400, 18]
    assert known.rows.tolist() == [10, 18] and known.columns.tolist() == [40, 1]
    assert known.nearest.tolist() == [1000, 3000]
    assert known.left[0] == -180 and known.right[0] == 170  # of -200 to 190, 20 cells a side
    assert known.top[0] == 400 - 60 and known.bottom[0] == 400 - 195
    assert known.depth.tolist() == [0, 0]


# laws

spans = st.lists(
    st.tuples(st.integers(0, 14), st.integers(0, 100), st.integers(2, 20), st.integers(800, 5000)),
    min_size=1,
    max_size=6,
)


def drawn(things: list[tuple]) -> Picture:
    """Things painted from far to near."""
    picture = Picture()
    for row, column, size, z in sorted(things, key=lambda one: -one[3]):
        picture.paint(slice(row, row + size), slice(column, column + size), z)
    values = np.unique(picture.label[picture.label >= 0])
    picture.label = np.where(picture.label >= 0, np.searchsorted(values, picture.label), -1)
    return picture


@given(spans)
def test_numbers_go_by_the_nearest_point_without_gaps(things: list[tuple]) -> None:
    picture = drawn(things)
    label = picture.found()
    count = label.max() + 1
    assert (label[picture.label < 0] == -1).all()
    nearest = [int(picture.z[label == n].min(initial=1 << 30)) for n in range(count)]
    assert nearest == sorted(nearest) and max(nearest, default=0) <= FAR
    assert all((label == n).any() for n in range(count))


@given(spans, st.permutations(range(6)))
def test_the_numbers_of_surfaces_are_nothing(things: list[tuple], order: list[int]) -> None:
    """What stands on its own is the same whatever number it had."""
    config = replace(CONFIG, narrow_m=0.0, hanging_m=0.0, min_size_m=0.0)
    picture = drawn(things)
    label = picture.found(config)
    mixed = np.argsort(order[: picture.label.max() + 1])
    picture.label = np.where(picture.label >= 0, np.append(mixed, -1)[picture.label], -1)
    np.testing.assert_array_equal(picture.found(config), label)


@given(spans)
def test_nothing_is_lost_but_what_is_too_small(things: list[tuple]) -> None:
    picture = drawn(things)
    loose = replace(CONFIG, min_size_m=0.0, min_cells=1)
    np.testing.assert_array_equal(picture.found(loose) >= 0, picture.label >= 0)


# edges


def test_nothing() -> None:
    picture = Picture()
    assert (picture.found() == -1).all()
    picture.z[:] = 0
    assert (picture.found() == -1).all()


def test_one_cell() -> None:
    one = np.zeros((1, 1), np.int64)
    view = View(one, one, one + 900, one, one + 900, one + 100, one == 0)
    assert obstacles(one, one == 0, view, FAR, UNIT, CONFIG).tolist() == [[-1]]
    loose = replace(CONFIG, min_size_m=0.0, min_cells=1)
    assert obstacles(one, one == 0, view, FAR, UNIT, loose).tolist() == [[0]]


def test_depth_unit() -> None:
    """The same frame in tenths of a millimetre."""
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2100)
    picture.paint(slice(0, 24), slice(55, 60), 1200).paint(LOW, slice(100, 104), 1800)
    fine = View(*(10 * a for a in picture.view[:-1]), picture.view.in_view)
    label = obstacles(picture.label, picture.label >= 0, fine, 10 * FAR, UNIT / 10, CONFIG)
    np.testing.assert_array_equal(label, picture.found())
