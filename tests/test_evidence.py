"""pairs: features of pairs of surfaces, compared with an implementation by loops."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.affinity import LENGTHS, PAIR_FEATURES
from jaxdet.config import ObstacleConfig
from jaxdet.reference._evidence import MOST_BETWEEN, facing, pairs
from jaxdet.reference._view import View

GAP = 40
UNIT = 0.001
CONFIG = ObstacleConfig()


def facing_slowly(label: np.ndarray, floor: np.ndarray, z: np.ndarray, along: np.ndarray) -> dict:
    """Compute the facing cells of each pair line by line, cell by cell."""
    found: dict[tuple[int, int], list[int]] = {}
    for row in range(len(label)):
        cells = [int(n) for n in label[row]]
        for end in range(len(cells)):
            own = cells[end]
            if own < 0 or (end + 1 < len(cells) and cells[end + 1] == own):
                continue
            runs, met = 0, set()
            for start in range(end + 1, len(cells)):
                there = cells[start]
                if there < 0 or (there == cells[start - 1] and start > end + 1):
                    continue
                if there == own or runs > MOST_BETWEEN:
                    break
                if there not in met:
                    votes = _one(label[row], floor[row], z[row], along[row], end, start)
                    total = found.setdefault((min(own, there), max(own, there)), [0] * 6)
                    for k, vote in enumerate(votes):
                        total[k] += vote
                met.add(there)
                runs += 1
    return found


def _one(
    label: np.ndarray, floor: np.ndarray, z: np.ndarray, along: np.ndarray, end: int, start: int
) -> list[int]:
    between = [int(z[c]) for c in range(end + 1, start) if label[c] >= 0]
    low, high = sorted((int(z[end]), int(z[start])))
    through = bool(floor[end + 1 : start].any()) or any(d > high + GAP for d in between)
    hidden = not through and any(d < low - GAP // 2 for d in between)
    holes = not through and not hidden and start > end + 1
    apart = abs(int(along[start]) - int(along[end]))
    agree = (hidden or holes) and high - low <= GAP + apart // 10
    return [1, through, hidden, holes, agree, 0 if through else high - low]


frames = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@given(frames, st.integers(1, 5), st.integers(1, 40))
def test_facing_cells_equal_those_found_by_loops(
    rng: np.random.Generator, rows: int, columns: int
) -> None:
    label = np.repeat(rng.integers(-1, 6, (rows, columns)), 2, axis=1)
    depth = np.where(label >= 0, 1000 + rng.integers(0, 4, label.shape) * 45, 0)
    floor = (label < 0) & (rng.random(label.shape) < 0.1)
    along = np.cumsum(rng.integers(0, 200, label.shape), axis=1)
    found = facing(label, floor, depth, along, GAP)
    expected = facing_slowly(label, floor, depth, along)
    for one, other in zip(*np.triu_indices(int(label.max()) + 1, 1), strict=True):
        votes = [int(table[one, other]) for table in found]
        assert votes == expected.get((int(one), int(other)), [0] * 6)


def test_facing_cells_match_a_hand_calculation() -> None:
    """A pole stands in front of a wall, which is visible next to it."""
    label = np.array([[0, 0, 1, 2, -1, 3], [0, 0, -1, 2, -1, -1]])
    z = np.array([[900, 900, 700, 905, 1500, 910], [900, 900, 0, 1000, 0, 0]])
    floor = z == 1500
    found = facing(label, floor, z, z * 0, GAP)
    assert found.places[0, 2] == 2 and found.hidden[0, 2] == 1 and found.holes[0, 2] == 1
    assert found.agree[0, 2] == 1 and found.steps[0, 2] == 105
    assert found.through[2, 3] == 1 and found.places[0, 1] == 1 and found.steps[0, 1] == 200


def upright(columns: list[tuple[int, int, int]]) -> tuple[np.ndarray, View]:
    """Return upright objects ``(first column, width, z)``, 10 rows high, 10 mrad per column."""
    shape = (12, 120)
    label, z = np.full(shape, -1), np.zeros(shape, np.int64)
    for number, (first, width, depth) in enumerate(columns):
        label[1:11, first : first + width] = number
        z[1:11, first : first + width] = depth
    row, column = np.indices(shape)
    x = (column - 60) * z // 100
    return label, View(x, row * z // 100, z, x, z, 300 - 20 * row)


def seen_of(things: list[tuple[int, int, int]], config: ObstacleConfig = CONFIG) -> list[dict]:
    label, view = upright(things)
    found = pairs(label, (view.z > 0) & (label < 0), view, UNIT, config)
    return [dict(zip(PAIR_FEATURES, one.tolist(), strict=True)) for one in found.features]


def test_features_of_a_pair_match_a_hand_calculation() -> None:
    """Objects of 20 and 10 columns at 1 m and 1.1 m, with 10 columns without depth between them."""
    (seen,) = seen_of([(30, 20, 1000), (60, 10, 1100)])
    assert seen["gap"] == int(np.hypot(110, 100)) and seen["ahead"] == 100
    assert seen["step"] == 100 and seen["through"] == 0
    assert seen["agree"] == 10 and seen["agree_share"] == 100 and seen["hidden_share"] == 0
    assert seen["cells_less"] == 100 and seen["cells_more"] == 200
    assert seen["width_less"] == 99 and seen["width_more"] == 170
    assert seen["bottom_less"] == 100 and seen["top_more"] == 280
    assert seen["nearest"] == 1000 and seen["overlap"] < 0
    assert seen["behind"] == 100 and seen["rows"] == 10 and seen["columns"] == 0
    assert seen["through_share"] == seen["through_share_in_columns"] == 0


def test_lesser_and_greater_surface_are_ordered_by_size() -> None:
    """Both surfaces have equally many cells; the narrower and nearer surface is the lesser."""
    one, other = ([(20, 10, 1000), (60, 10, 1500)], [(60, 10, 1500), (20, 10, 1000)])
    assert seen_of(one) == seen_of(other)
    (seen,) = seen_of(one)
    assert seen["cells_less"] == seen["cells_more"] and seen["width_less"] < seen["width_more"]


def test_features_do_not_depend_on_the_depth_unit() -> None:
    """One object is above another, without depth between them, in units of 1 mm and 0.1 mm."""
    label, view = upright([(30, 20, 1000)])
    label[4:7], view.z[4:7] = -1, 0
    label[7:] = np.where(label[7:] == 0, 1, label[7:])
    found = pairs(label, view.z < 0, view, UNIT, CONFIG)
    seen = dict(zip(PAIR_FEATURES, found.features[0].tolist(), strict=True))
    assert seen["between_in_columns"] == 20 and seen["through_in_columns"] == 0
    fine = View(*(10 * a for a in view))
    tenths = pairs(label, view.z < 0, fine, UNIT / 10, CONFIG).features[0]
    scale = np.where([name in LENGTHS for name in PAIR_FEATURES], 10, 1)
    np.testing.assert_array_equal(tenths, found.features[0] * scale)
    floor = np.zeros(label.shape, bool)
    floor[5, 30:50] = True
    through = pairs(label, floor, view, UNIT, CONFIG).features[0]
    assert through[PAIR_FEATURES.index("through_in_columns")] == 20


def test_surfaces_too_far_apart_are_not_pairs() -> None:
    things = [(5, 20, 1000), (90, 20, 1000)]
    assert len(seen_of(things)) == 1
    assert not seen_of(things, replace(CONFIG, lateral_gap_m=0.5))
    assert not seen_of([(5, 20, 1000), (40, 20, 2000)])


def test_without_surfaces_there_are_no_pairs() -> None:
    label, view = upright([])
    assert pairs(label, (view.z > 0) & (label < 0), view, UNIT, CONFIG).features.shape == (
        0,
        len(PAIR_FEATURES),
    )
