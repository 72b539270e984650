"""free_floor: visible extent of the floor, and the reason of its end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.reference._free import NEIGHBOURS, FloorView, floor_ahead, free_floor
from jaxdet.reference._notches import notches, with_notches
from jaxdet.types import FreeEnd

FAR, GAP, DROP = 4000, 500, 60
WIDE = 2 * NEIGHBOURS + 1


def column(*cells: tuple[int, int] | str | None) -> dict[str, list[int]]:
    """Return a column of cells, given from the nearest to the farthest.

    A cell is ``(forward, height)`` [mm], an obstacle the text of its distance forward such as
    ``"1600"``, and a hole None. Cells within 30 mm of the plane are floor; those and all lower ones
    are ``low``.
    """
    out: dict[str, list[int]] = {"label": [], "low": [], "floor": [], "forward": [], "height": []}
    for cell in reversed(cells):
        thing = isinstance(cell, str)
        forward, height = (int(cell), 300) if isinstance(cell, str) else cell or (0, 0)
        out["label"].append(0 if thing else -1)
        out["low"].append(cell is not None and not thing and height <= 30)
        out["floor"].append(out["low"][-1] and height >= -30)
        out["forward"].append(forward)
        out["height"].append(height)
    return out


def found(*columns: dict[str, list[int]]) -> tuple[np.ndarray, list[FreeEnd]]:
    """Return lines and ends of adjacent columns, each 1 mm to the right of the previous one.

    They are followed by columns without measurements, as a drop depends on neighbouring columns.
    """
    empty = column(*[None] * len(columns[0]["label"]))
    return narrow(*columns, *[empty] * WIDE, count=len(columns))


def narrow(*columns: dict[str, list[int]], count: int) -> tuple[np.ndarray, list[FreeEnd]]:
    """Return lines and ends of the first ``count`` columns of an image of these columns only."""
    arrays = {k: np.array([c[k] for c in columns]).T for k in columns[0]}
    right = np.broadcast_to(np.arange(len(columns)), arrays["label"].shape)
    drop = np.full(right.shape, DROP)
    view = FloorView(
        arrays["label"],
        arrays["low"].astype(bool),
        arrays["floor"].astype(bool),
        right,
        arrays["forward"],
        arrays["height"],
        drop,
    )
    line, end = free_floor(view, FAR, GAP)
    assert line.dtype == end.dtype == np.int32
    return line[:count], [FreeEnd(int(e)) for e in end[:count]]


def floor(*forward: int) -> list[tuple[int, int]]:
    return [(y, 0) for y in forward]


# by hand


def test_floor_ends_at_the_end_of_the_range() -> None:
    line, end = found(column(*floor(500, 900, 1400, 1900, 2400, 2900, 3400, 3600), None))
    assert end == [FreeEnd.RANGE]
    assert line.tolist() == [[[0, 500], [0, 3600]]]


def test_floor_ends_at_an_obstacle() -> None:
    line, end = found(column(*floor(500, 900, 1300), "1500", "1500", "1500"))
    assert end == [FreeEnd.OBSTACLE]
    assert line.tolist() == [[[0, 500], [0, 1500]]]


def test_floor_behind_an_obstacle_is_not_free() -> None:
    line, end = found(column(*floor(500, 900), "1200", *floor(1400, 1800)))
    assert end == [FreeEnd.OBSTACLE] and line[0, 1].tolist() == [0, 1200]


def test_the_nearest_obstacle_of_the_column_ends_the_floor() -> None:
    """An object that hangs above the floor is nearer than the floor that is seen below it."""
    line, end = found(column(*floor(500, 900, 1300, 1700), "1800", "1000"))
    assert end == [FreeEnd.OBSTACLE] and line[0].tolist() == [[0, 500], [0, 1000]]


def test_floor_ends_for_an_unknown_reason_at_gaps_that_are_too_long() -> None:
    line, end = found(column(*floor(500, 900, 1300), None, None))
    assert end == [FreeEnd.UNKNOWN] and line[0].tolist() == [[0, 500], [0, 1300]]
    line, end = found(column(*floor(500, 900, 1300), None, *floor(1801, 2000)))
    assert end == [FreeEnd.UNKNOWN] and line[0, 1].tolist() == [0, 1300]
    line, end = found(column(*floor(500, 900, 1300), None, "1801"))
    assert end == [FreeEnd.UNKNOWN] and line[0, 1].tolist() == [0, 1300]


def test_a_hole_shorter_than_the_gap_is_ignored() -> None:
    line, end = found(column(*floor(500, 900, 1300), None, *floor(1800, 2000), None, None))
    assert end == [FreeEnd.UNKNOWN] and line[0, 1].tolist() == [0, 2000]


def test_a_column_with_only_an_obstacle_has_no_free_floor() -> None:
    line, end = found(column(None, "900", "910"), column(None, None, None))
    assert end == [FreeEnd.OBSTACLE, FreeEnd.UNKNOWN]
    assert line.tolist() == [[[0, 900], [0, 900]], [[0, 0], [0, 0]]]


@pytest.mark.parametrize("down", [(0, 8192, 0), (0, -8192, 0), (5000, -5000, 0), (8192, 0, 0)])
def test_free_floor_does_not_depend_on_the_roll_of_the_camera(down: tuple[int, int, int]) -> None:
    """The image of a camera upside down is rotated by 180°; on its side, free floor is unknown."""
    cells = column(*floor(500, 900, 1400, 1900, 2400, 2900, 3400, 3600), None)
    arrays = {k: np.array([v, v]).T for k, v in cells.items()}
    right, drop = np.array([[-7, 7]] * 9), np.full((9, 2), DROP)
    names = "label", "low", "floor", "forward", "height"
    label, low, known, ahead, height = (arrays[name] for name in names)
    view = FloorView(label, low > 0, known > 0, right, ahead, height, drop)
    if down[1] < 0:
        view = FloorView(*(a[::-1, ::-1] for a in view))
    line, end = floor_ahead(view, np.array(down), FAR, GAP)
    if down[0] > abs(down[1]):
        assert not line.any() and not end.any()
    else:
        assert line.tolist() == [[[x, 500], [x, 3600]] for x in (-7, 7)]
        assert end.tolist() == [FreeEnd.RANGE] * 2


STEP_DOWN = column(*floor(500, 900, 1300), (2000, -300), (2200, -300), (2400, -305), None)


def test_floor_ends_at_a_step_down() -> None:
    line, end = found(*[STEP_DOWN] * WIDE)
    assert end == [FreeEnd.DROP] * WIDE
    assert line[3].tolist() == [[3, 500], [3, 1300]]


def test_a_wall_below_a_step_may_reach_the_height_of_the_floor() -> None:
    """Cells of a wall in a lower room are at the height of the floor, as far as those below."""
    wall = column(*floor(500, 900, 1300), (4200, -300), (4400, -290), (4600, -280), (3900, 0))
    _, end = found(*[wall] * WIDE)
    assert end == [FreeEnd.DROP] * WIDE


def test_a_narrow_drop_counts_as_a_reflection() -> None:
    """If at most half of a column and its neighbours drop, the reason of the end is unknown."""
    plain = column(*floor(500, 900, 1300, 1700, 2100, 2500), None)
    _, end = found(*[plain] * NEIGHBOURS, *[STEP_DOWN] * NEIGHBOURS, *[plain] * NEIGHBOURS)
    assert FreeEnd.DROP not in end
    assert end[NEIGHBOURS : 2 * NEIGHBOURS] == [FreeEnd.UNKNOWN] * NEIGHBOURS
    _, end = found(*[plain] * NEIGHBOURS, *[STEP_DOWN] * (NEIGHBOURS + 1), *[plain] * NEIGHBOURS)
    assert FreeEnd.DROP in end


@pytest.mark.parametrize(
    "beyond",
    [
        ((1500, -300), (1700, -300)),  # too few cells
        ((1500, -40), (1700, -80), (1900, -130)),  # a gradual descent: a bowed far floor
        ((1500, -300), (1501, -500), (1502, -700)),  # an upright surface: a mirrored object
        ((1500, -300), "1600", (1700, -300)),  # an obstacle in between
        ((1500, -300), (1600, -300), (1700, -300), (1750, 0), (1900, 0)),  # floor continues beyond
        ((7000, -900), (7400, -940), (7900, -980), (2000, 0)),  # floor above the cells, but nearer
    ],
)
def test_reflections_bowed_floor_and_few_cells_are_not_a_drop(
    beyond: tuple,
) -> None:
    _, end = found(*[column(*floor(500, 900, 1300), *beyond)] * WIDE)
    assert FreeEnd.DROP not in end


# laws

cells = st.one_of(
    st.none(),
    st.integers(400, 5000).map(str),
    st.tuples(st.integers(400, 5000), st.sampled_from([0, 10, -20, -35, -80, -300, 200])),
)
pictures = st.lists(
    st.lists(cells, min_size=8, max_size=8).map(lambda c: column(*c)), min_size=1, max_size=30
)


@given(pictures)
def test_lines_begin_at_the_nearest_row_and_end_before_obstacles(columns: list) -> None:
    line, end = found(*columns)
    for c, (one, why) in enumerate(zip(columns, end, strict=True)):
        (_, first), (_, last) = line[c].tolist()
        blocked = [y for y, n in zip(one["forward"], one["label"], strict=True) if n >= 0]
        limit = min(blocked, default=FAR)
        if why == FreeEnd.OBSTACLE:
            assert last == limit and blocked
        elif any(line[c, :, 1]):
            assert max(first, last) < limit
        if why == FreeEnd.RANGE:
            assert FAR - last <= GAP and not blocked
        seen = [y for y, f in zip(one["forward"], one["floor"], strict=True) if f and y < limit]
        assert first == (seen[-1] if seen else min(blocked, default=0))


@given(pictures)
def test_mirrored_columns_have_mirrored_lines(columns: list) -> None:
    line, end = found(*columns)
    other, turned = found(*columns[::-1])
    assert turned == end[::-1]
    np.testing.assert_array_equal(other[::-1, :, 1], line[:, :, 1])


@given(pictures)
def test_columns_are_independent_except_for_drops(columns: list) -> None:
    line, end = found(*columns)
    for c, one in enumerate(columns):
        alone, (why,) = found(one)
        np.testing.assert_array_equal(alone[0, :, 1], line[c, :, 1])
        assert why == end[c] or {why, end[c]} <= {FreeEnd.UNKNOWN, FreeEnd.DROP}


def test_without_cells_there_is_no_free_floor() -> None:
    line, end = found(column(None), column(None))
    assert not line.any() and end == [FreeEnd.UNKNOWN] * 2


@pytest.mark.parametrize("count", [1, 2, 2 * NEIGHBOURS])
def test_narrow_grids_are_supported(count: int) -> None:
    line, end = narrow(*[column(*floor(500, 900), "1200")] * count, count=count)
    assert end == [FreeEnd.OBSTACLE] * count and line.shape == (count, 2, 2)


# notches


@pytest.mark.parametrize(
    ("ahead", "ends", "want"),
    [
        ([900, 500, 550, 950], "uuuu", [-1, 0, 0, -1]),
        ([900, 500, 550, 850], "uuuu", [-1, -1, -1, -1]),  # not deeper than the minimum
        ([900, 500, 550, 950], "uudu", [-1, -1, -1, -1]),  # the floor ends at a drop
        ([900, 500, 0, 950], "uuuu", [-1, -1, -1, -1]),  # one column has no visible floor
        ([500, 100, 100, 500, 900, 590, 950, 900], "uuuuuuuu", [-1, 0, 0, -1, -1, 1, -1, -1]),
        ([900, 500, 500], "uuu", [-1, -1, -1]),  # at the edge of the image
        ([500, 900, 500], "uuu", [-1, -1, -1]),
        ([900, 500, 950], "rur", [-1, 0, -1]),
        ([900], "u", [-1]),
    ],
)
def test_deep_notches_are_found(ahead: list[int], ends: str, want: list[int]) -> None:
    kinds = {"u": FreeEnd.UNKNOWN, "d": FreeEnd.DROP, "r": FreeEnd.RANGE}
    end = np.array([kinds[e] for e in ends])
    assert notches(end, np.array(ahead), 300).tolist() == want
    assert notches(end[::-1], np.array(ahead[::-1]), 300)[::-1].max() == max(want)


def test_enough_cells_behind_a_notch_are_an_obstacle() -> None:
    label = np.array([[-1, -1, -1, 0, -1], [-1, -1, -1, -1, -1], [-1, -1, -1, -1, -1]])
    notch, ahead = np.array([0, -1, 1, 1, 2]), np.array([500, 900, 500, 600, 400])
    forward = np.array(
        [[600, 600, 800, 700, 450], [550, 550, 801, 700, 420], [500, 500, 499, 600, 410]]
    )
    high = np.array([[1, 1, 1, 1, 1], [1, 1, 1, 1, 0], [1, 1, 1, 1, 0]], bool)
    found = with_notches(label, notch, ahead, forward, high, 300, 3)
    assert found.tolist() == [[1, -1, 2, 0, -1], [1, -1, -1, 2, -1], [1, -1, -1, 2, -1]]
    assert (with_notches(label, notch, ahead, forward, high, 300, 4) == label).all()
    none = np.full(5, -1)
    assert (with_notches(label, none, ahead, forward, high, 300, 1) == label).all()
