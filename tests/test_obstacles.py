"""obstacles: groups of surfaces, sorted by distance."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.config import ObstacleConfig
from jaxdet.reference._obstacles import contracted, obstacles
from jaxdet.reference._surfaces import renumbered
from jaxdet.reference._view import View, extents

UNIT, CELL, FAR = 0.001, 0.01, 6000
CONFIG = ObstacleConfig(min_size_m=0.05, min_cells=4)
ROWS, COLUMNS = 24, 120


class Picture:
    """Frame of cells: upright objects painted over a level floor 0.4 m below the camera."""

    def __init__(self) -> None:
        row, column = np.indices((ROWS, COLUMNS))
        self.ray_x, self.ray_y = CELL * (column - COLUMNS // 2), CELL * (row - 4) * 1.5
        floor = np.where(self.ray_y > 0, 400 / np.maximum(self.ray_y, 1e-6), 0)
        self.z = np.where(floor < 8000, np.rint(floor), 0).astype(np.int64)
        self.label = np.full(self.z.shape, -1)

    def paint(self, rows: slice, columns: slice, z: int) -> "Picture":
        """Paint another surface, nearer than existing ones."""
        self.z[rows, columns] = z
        self.label[rows, columns] = self.label.max() + 1
        return self

    def hole(self, rows: slice, columns: slice) -> "Picture":
        """Remove measurements."""
        self.z[rows, columns], self.label[rows, columns] = 0, -1
        return self

    @property
    def free(self) -> np.ndarray:
        return (self.z > 0) & (self.label < 0)

    @property
    def view(self) -> View:
        x, y = (np.rint(ray * self.z).astype(np.int64) for ray in (self.ray_x, self.ray_y))
        height = np.where(self.z > 0, 400 - y, 0)
        return View(x, y, self.z, x, self.z, height)

    def found(self, config: ObstacleConfig = CONFIG) -> np.ndarray:
        return obstacles(self.label, self.free, self.view, FAR, UNIT, config)

    def numbers(self, config: ObstacleConfig = CONFIG) -> list[int]:
        """Return the obstacle of each painted surface; assert that all its cells belong to it."""
        label = self.found(config)
        each = [np.unique(label[self.label == n]) for n in range(self.label.max() + 1)]
        assert all(len(one) == 1 for one in each)
        return [int(one[0]) for one in each]


TALL, LOW = slice(2, 20), slice(14, 20)


# by hand


def test_obstacles_are_sorted_by_distance() -> None:
    picture = Picture().paint(TALL, slice(5, 45), 2500).paint(TALL, slice(70, 110), 1500)
    assert picture.numbers() == [1, 0]


def test_obstacles_at_equal_distance_are_sorted_from_left_to_right() -> None:
    picture = Picture().paint(TALL, slice(70, 110), 1500).paint(TALL, slice(5, 45), 1500)
    assert picture.numbers(replace(CONFIG, lateral_gap_m=0.3)) == [1, 0]


def test_an_object_behind_a_pole_is_one_obstacle() -> None:
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2000)
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    assert picture.numbers() == [1, 1, 0]


def test_visible_background_separates_objects() -> None:
    """Without the pole, floor and wall are visible between the two objects."""
    picture = Picture().paint(slice(0, 24), slice(0, 120), 5000)
    picture.paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2000)
    _, left, right = picture.numbers()
    assert left != right
    open_floor = Picture().paint(LOW, slice(30, 55), 2000).paint(LOW, slice(60, 85), 2000)
    left, right = open_floor.numbers()
    assert left != right


def test_two_objects_behind_a_pole_at_different_distances_are_two_obstacles() -> None:
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2600)
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    assert picture.numbers() == [1, 2, 0]


def test_surfaces_too_far_apart_are_not_compared() -> None:
    """Two parts are 0.1 m apart behind a pole; the limit is 0.05 m."""
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2000)
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    assert picture.numbers(replace(CONFIG, lateral_gap_m=0.05)) == [1, 2, 0]


def test_a_slanted_object_behind_a_pole_is_one_obstacle() -> None:
    picture = Picture()
    line = 2000 + 4 * (np.arange(COLUMNS) - 30)
    for columns in (slice(30, 55), slice(60, 85)):
        picture.paint(TALL, columns, 0)
        picture.z[TALL, columns] = line[columns]
    picture.paint(slice(0, 24), slice(55, 60), 1200)
    left, right, _ = picture.numbers()
    assert left == right


def test_narrow_legs_are_one_obstacle_and_wide_objects_are_two() -> None:
    """Of two objects 0.15 m apart with floor between them, legs are one obstacle, boxes are two."""
    gap = 7
    legs = Picture().paint(TALL, slice(40, 46), 2000).paint(TALL, slice(46 + gap, 59), 2000)
    left, right = legs.numbers()
    assert left == right
    wide = Picture().paint(LOW, slice(10, 50), 2000).paint(LOW, slice(50 + gap, 97), 2000)
    left, right = wide.numbers()
    assert left != right


def test_legs_too_far_apart_are_separate_obstacles() -> None:
    apart = Picture().paint(LOW, slice(10, 16), 2000).paint(LOW, slice(76, 82), 2000)
    left, right = apart.numbers()
    assert left != right
    behind = Picture().paint(TALL, slice(30, 36), 2000).paint(TALL, slice(38, 44), 2900)
    left, right = behind.numbers()
    assert left != right


def contracted_slowly(count: int, weights: dict[tuple[int, int], int]) -> list[int]:
    """Perform greedy additive edge contraction on sets."""
    groups = [{node} for node in range(count)]

    def between(a: set[int], b: set[int]) -> int:
        return sum(weights.get((min(i, j), max(i, j)), 0) for i in a for j in b)

    while True:
        each = [(-between(a, b), min(a), min(b)) for a in groups for b in groups if min(a) < min(b)]
        best = min(each, default=(0, 0, 0))
        if best[0] >= 0:
            return [min(next(group for group in groups if n in group)) for n in range(count)]
        a, b = (next(group for group in groups if n in group) for n in best[1:])
        groups = [group for group in groups if group not in (a, b)] + [a | b]


@given(st.lists(st.integers(-40, 40), min_size=28, max_size=28))
def test_contraction_is_greedy_and_additive(weights: list[int]) -> None:
    one, other = np.triu_indices(8, 1)
    links = dict(zip(zip(one.tolist(), other.tolist(), strict=True), weights, strict=True))
    found = contracted(8, one, other, np.array(weights))
    assert found.tolist() == contracted_slowly(8, links)


def test_many_negative_weights_outweigh_a_link() -> None:
    """A chain of strong links is cut if all other weights are negative."""
    one, other = np.array([0, 1, 2, 0, 0, 1]), np.array([1, 2, 3, 2, 3, 3])
    weight = np.array([9, 5, 9, -2, -2, -2])
    assert contracted(4, one, other, weight).tolist() == [0, 0, 2, 2]
    assert contracted(4, one, other, np.maximum(weight, -1)).tolist() == [0, 0, 0, 0]


def test_a_fragment_is_merged_with_the_surface_it_touches() -> None:
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(slice(8, 10), slice(55, 58), 2080)
    assert picture.numbers() == [0, 0]


def test_objects_too_small_or_too_far_are_not_obstacles() -> None:
    small = Picture().paint(slice(10, 12), slice(30, 32), 1000)
    assert small.numbers() == [-1]
    assert small.numbers(replace(CONFIG, min_size_m=0.0)) == [0]
    assert Picture().paint(TALL, slice(30, 60), FAR + 1).numbers() == [-1]
    assert Picture().paint(TALL, slice(30, 60), FAR).numbers() == [0]
    few = Picture().paint(slice(10, 13), slice(30, 40), 2000)
    assert few.numbers(replace(CONFIG, min_cells=30)) == [0]
    assert few.numbers(replace(CONFIG, min_cells=31)) == [-1]


def test_the_walls_of_a_room_are_split_at_its_corner() -> None:
    """One wall is to the left, 2 m long, and one across, 1 m behind the chord of their ends."""
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


def test_extents_are_trimmed_by_a_twentieth() -> None:
    picture = Picture().paint(slice(8, 18), slice(40, 80), 1000).paint(TALL, slice(0, 1), 3000)
    known = extents(picture.label, picture.view)
    assert known.cells.tolist() == [400, 18]
    assert known.rows.tolist() == [10, 18] and known.columns.tolist() == [40, 1]
    assert known.nearest.tolist() == [1000, 3000]
    # Of the cells from -200 to 190, 20 are trimmed at each side.
    assert known.left[0] == -180 and known.right[0] == 170
    assert known.top[0] == 400 - 60 and known.bottom[0] == 400 - 195
    assert known.depth.tolist() == [0, 0]


# laws

spans = st.lists(
    st.tuples(st.integers(0, 14), st.integers(0, 100), st.integers(2, 20), st.integers(800, 5000)),
    min_size=1,
    max_size=6,
)


def drawn(things: list[tuple]) -> Picture:
    """Return a picture of objects painted from far to near."""
    picture = Picture()
    for row, column, size, z in sorted(things, key=lambda one: -one[3]):
        picture.paint(slice(row, row + size), slice(column, column + size), z)
    values = np.unique(picture.label[picture.label >= 0])
    picture.label = np.where(picture.label >= 0, np.searchsorted(values, picture.label), -1)
    return picture


@given(spans)
def test_obstacles_are_numbered_without_gaps_by_their_nearest_point(things: list[tuple]) -> None:
    picture = drawn(things)
    label = picture.found()
    count = label.max() + 1
    assert (label[picture.label < 0] == -1).all()
    nearest = [int(picture.z[label == n].min(initial=1 << 30)) for n in range(count)]
    assert nearest == sorted(nearest) and max(nearest, default=0) <= FAR
    assert all((label == n).any() for n in range(count))


@given(spans)
def test_mirrored_frames_have_mirrored_obstacles(things: list[tuple]) -> None:
    """The obstacles are equal except for the order of ties."""
    picture = drawn(things)
    config = replace(CONFIG, bend_m=0.0)
    label = picture.found(config)
    flipped = obstacles(
        renumbered(picture.label[:, ::-1]),
        picture.free[:, ::-1],
        View(
            *(
                np.ascontiguousarray(a[:, ::-1])
                for a in picture.view._replace(x=-picture.view.x, right=-picture.view.right)
            )
        ),
        FAR,
        UNIT,
        config,
    )[:, ::-1]
    np.testing.assert_array_equal(flipped >= 0, label >= 0)
    both = np.stack([label, flipped])[:, label >= 0]
    assert len(np.unique(both, axis=1).T) == label.max() + 1 == flipped.max() + 1


@given(spans)
def test_only_small_objects_are_removed(things: list[tuple]) -> None:
    picture = drawn(things)
    loose = replace(CONFIG, min_size_m=0.0, min_cells=1)
    np.testing.assert_array_equal(picture.found(loose) >= 0, picture.label >= 0)


# edges


def test_without_surfaces_there_are_no_obstacles() -> None:
    picture = Picture()
    assert (picture.found() == -1).all()
    picture.z[:] = 0
    assert (picture.found() == -1).all()


def test_one_cell_is_too_small_for_an_obstacle() -> None:
    one = np.zeros((1, 1), np.int64)
    view = View(one, one, one + 900, one, one + 900, one + 100)
    assert obstacles(one, one > 0, view, FAR, UNIT, CONFIG).tolist() == [[-1]]
    loose = replace(CONFIG, min_size_m=0.0, min_cells=1)
    assert obstacles(one, one > 0, view, FAR, UNIT, loose).tolist() == [[0]]


def test_obstacles_do_not_depend_on_the_depth_unit() -> None:
    """The same frame has equal obstacles in tenths of a millimetre."""
    picture = Picture().paint(TALL, slice(30, 55), 2000).paint(TALL, slice(60, 85), 2100)
    picture.paint(slice(0, 24), slice(55, 60), 1200).paint(LOW, slice(100, 104), 1800)
    fine = View(*(10 * a for a in picture.view))
    label = obstacles(picture.label, picture.free, fine, 10 * FAR, UNIT / 10, CONFIG)
    np.testing.assert_array_equal(label, picture.found())
