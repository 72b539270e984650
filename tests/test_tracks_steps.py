"""Single steps of tracking, examples by hand; complete tracks: ``tests/test_tracks.py``."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from jaxdet.tracks import TrackConfig
from jaxdet.tracks import rows as tracks_rows
from jaxdet.tracks.links import end_pieces, link_frames, link_tracklets, tracklets_of
from jaxdet.tracks.merge import merge_overlapping
from jaxdet.tracks.motion import STEADY_S, Motion, motion_of
from jaxdet.tracks.observations import Observations
from jaxdet.tracks.occlusion import hidden_shift, mark_hidden_sides
from jaxdet.tracks.outlines import Outlines, displacement, gap, overlap
from jaxdet.tracks.pairs import chain_starts, components, greedy_matching, pairs_in_frames
from jaxdet.tracks.rows import TrackRows
from jaxdet.tracks.track import Piece, piece_of, track_of
from jaxdet.tracks.track_ids import TrackIds
from tests.test_tracks import RATE_HZ, corners_of, follow, sightings


def in_frames(frames: list[list[list[float]]], **other: object) -> Observations:
    """Return outlines by frame as observations."""
    frame = np.repeat(np.arange(len(frames)), [len(boxes) for boxes in frames])
    boxes = np.array([box for boxes in frames for box in boxes], np.float64)
    stamps = other.pop("stamps", frame / RATE_HZ * 1e9)
    return sightings(frame, np.asarray(stamps).astype(np.int64), boxes, **other)


def test_observations_match_a_hand_calculation():
    """The result has columns in image widths, sides at the border, and weights."""
    boxes = [corners_of(0, 2)] * 4
    turned = [corners_of(5, 5, yaw=np.pi / 3)] * 3 + [[np.nan] * 8]
    u_min, u_max = [0, 1, 2, 320], [637, 638, 639, 640]
    seen = in_frames(
        [boxes], u_min=u_min, u_max=u_max, corners_world=turned, distance_m=[0, 3, 6, np.nan]
    )
    assert seen.in_world.tolist() == [True, True, True, False]
    np.testing.assert_allclose(seen.columns, np.stack([u_min, u_max], 1) / 640)
    assert seen.hidden.tolist() == [[True, False], [True, True], [False, True], [False, True]]
    np.testing.assert_allclose(seen.weight, [1, 1 / 2, 1 / 17, 16 / 17])
    right = [[1 / 2, np.sqrt(3) / 2]] * 3 + [[1, 0]]
    np.testing.assert_allclose(seen.rightwards, right, atol=1e-12)
    np.testing.assert_allclose(seen.outline.center, [[5, 5]] * 3 + [[0, 2]])
    rolls = np.array([0.78, 0.79, -2.35, -2.36, np.pi, np.nan])
    ways = in_frames([[corners_of(0, 2)] * 6], roll_rad=rolls).rightwards
    np.testing.assert_allclose(ways, [[w, 0] for w in (1, 0, 0, -1, -1, 1)], atol=1e-12)


SIDE = corners_of(0, 0, (1.0, 0.6))


@pytest.mark.parametrize(
    ("other", "bottoms", "one"),
    [
        (corners_of(0.55, 0, (0.5, 0.6)), (0, 0), False),  # overlap of 0.2 m of 0.5 m
        (corners_of(0.54, 0, (0.5, 0.6)), (0, 0), True),
        (corners_of(0, 0.36, (0.9, 0.3)), (0, 0), False),
        (corners_of(0.84, 0, (0.5, 0.6)), (0, 0.26), True),  # 0.09 m away
        (corners_of(0.84, 0, (0.5, 0.6)), (0, 0.24), False),
        (corners_of(0.84, 0, (0.5, 0.6)), (0.5, 0), False),  # the larger part is above the floor
        (corners_of(0.86, 0, (0.5, 0.6)), (0, 0.26), False),
        (corners_of(0, 0, (1.59, 0.6)), (0, 0), True),
        (corners_of(0, 0, (1.61, 0.6)), (0, 0), False),
        (corners_of(0.61, 0.41, (1.5, 0.3), 0.75 * np.pi), (0, 0), False),  # a gap along its sides
    ],
)
def test_obstacles_are_merged_if_they_overlap_or_one_floats_nearby(other, bottoms, one):
    for turn in (1, -1):
        seen = in_frames([[SIDE, other][::turn]], bottom_m=np.array(bottoms[::turn], float))
        things, thing = merge_overlapping(seen, np.array([9, 4][::turn]), TrackConfig())
        assert (len(things.frame), thing[0] == thing[1]) == ((1, True) if one else (2, False))


@pytest.mark.parametrize(
    ("columns", "distance", "one"),
    [((100, 165), 1, False), ((100, 164), 1, True), ((165, 400), 1, False), ((150, 180), 3, True)],
)
def test_parts_with_a_hidden_foot_are_not_above_the_floor(columns, distance, one):
    """A bucket hides the foot of a post next to a crate, in half of its columns or in fewer."""
    post, crate, bucket = corners_of(0, 2), corners_of(0.35, 2), corners_of(5, 5)
    seen = in_frames(
        [[post, crate, bucket]],
        bottom_m=[0.3, 0.1, 0.0],
        distance_m=[2, 2.5, distance],
        u_min=[150, 190, columns[0]],
        u_max=[180, 300, columns[1]],
    )
    things, thing = merge_overlapping(seen, np.array([4, 9, 6]), TrackConfig())
    assert (thing[0] == thing[1]) == one and len(things.frame) == (2 if one else 3)


def test_an_observation_of_several_obstacles_matches_a_hand_calculation():
    """The rectangle of the observation has the orientation of the obstacle with most cells."""
    boxes = [corners_of(0, 3, (0.4, 0.2)), SIDE, corners_of(0.1, 3.1, (0.2, 0.2), np.pi / 6)]
    seen = in_frames(
        [[*boxes, corners_of(0, 3, (0.1, 0.1))], boxes[:1]],
        bottom_m=[0.2, 0.0, 0.4, np.nan, 0.1],
        top_m=[1.6, 0.5, 1.5, np.nan, 1.4],
        distance_m=[1.5, 1, 3, 6, 2],
        u_min=[0, 100, 290, 300, 7],
        u_max=[300, 200, 310, 330, 9],
        x_min=[-0.2, 5, 0.0, 0.0, 7],
        x_max=[0.1, 6, 0.2, 0.1, 8],
    )
    things, thing = merge_overlapping(seen, np.array([7, 9, 8, 2, 1]), TrackConfig())
    assert thing.tolist() == [0, 1, 0, 0, 2] and things.frame.tolist() == [0, 0, 1]
    assert things.obstacles.tolist() == [3, 1, 1]
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    np.testing.assert_allclose(things.outline.axis[0], [c, s])
    low, high = -0.2 * c - 0.1 * s, 0.1 * c + 0.1 * s + 0.1
    half, shift = (high - low) / 2, (high + low) / 2
    np.testing.assert_allclose(things.outline.half[0], [half, 0.2 * s + 0.1 * c])
    np.testing.assert_allclose(things.outline.center[0], [shift * c, 3 + shift * s])
    np.testing.assert_allclose(things.bottom_m, [0.2, 0, 0.1])
    np.testing.assert_allclose(things.top_m, [1.6, 0.5, 1.4])
    np.testing.assert_allclose(things.distance_m, [1.5, 1, 2])
    np.testing.assert_allclose(things.columns * 640, [[0, 330], [100, 200], [7, 9]])
    np.testing.assert_allclose(things.across_m, [[-0.2, 0.2], [5, 6], [7, 8]])
    assert things.hidden.tolist() == [[True, False], [False, False], [False, False]]
    assert things.weight[0] == 1 / 17


@pytest.mark.parametrize(
    ("columns", "distance", "hidden"),
    [
        ((100, 200), 1, (True, False)),
        ((100, 183), 1, (True, False)),
        ((100, 182), 1, (False, False)),
        ((200, 300), 1, (False, False)),
        ((300, 400), 1, (False, True)),
        ((329, 400), 1, (False, True)),
        ((330, 400), 1, (False, False)),
        ((100, 400), 1, (True, True)),
        ((192, 320), 1, (False, False)),  # exactly in front of the object
        ((100, 400), 2, (False, False)),
    ],
)
def test_sides_next_to_a_nearer_obstacle_are_hidden(columns, distance, hidden):
    """The object is in columns 192 to 320, 2 m away; 1.5 % of the width are 9.6 columns."""
    boxes = [corners_of(0, 0), corners_of(9, 0)]
    for turn in (1, -1):
        u_min, u_max = np.array([(192, 320), columns][::turn]).T
        things = in_frames([boxes], u_min=u_min, u_max=u_max, distance_m=[2, distance][::turn])
        marked = mark_hidden_sides(things).hidden[::turn]
        assert tuple(marked[0]) == hidden and not marked[1].any()


def test_hidden_sides_are_extrapolated():
    """The centre moves by half of the missing width, towards the hidden side."""
    L, R, both, no = (True, False), (False, True), (True, True), (False, False)
    rows = [
        (0, 0.6, no, 0),
        (1, 0.5, no, 0),
        (0, 0.4, no, 0),
        (0, 0.3, R, 0.1),
        (2, 0.4, L, 0),
        (0, 0.5, no, 0),
        (0, 0.2, L, -0.1),  # extended to at most twice the visible width
        (1, 0.5, no, 0),
        (0, 0.7, no, 0),
        (0, 0.2, both, 0),
        (0, 0.6, R, 0),  # wider than the usual width
        (1, 0.3, R, 0),  # two complete ones are too few
        (3, 0.8, no, 0),
        (3, 0.8, no, 0),
        (3, 0.8, no, 0),
        (3, 0.7, R, 0.05),
    ]
    track, width, hidden, shift = zip(*rows, strict=True)
    things = in_frames([[corners_of(0, 2)]] * len(rows), x_min=[-1.0] * len(rows))
    way = np.array([0.6, 0.8])
    things = things._replace(
        across_m=np.stack([-np.ones(len(rows)), np.array(width) - 1], 1),
        hidden=np.array(hidden),
        rightwards=np.tile(way, (len(rows), 1)),
    )
    found = hidden_shift(things, np.array(track), 4)
    np.testing.assert_allclose(found, np.outer(shift, way), atol=1e-12)
    last = things.take(np.array([4]))
    assert (hidden_shift(last, np.array([0]), 1) == 0).all()


def linked(frames: list[list[list[float]]], first: int = 0, **other: object) -> list[int]:
    """Return the previous observation of each observation, found by ``link_frames``."""
    things = in_frames(frames, **other)
    return link_frames(things, np.full(len(things.frame), -1), first, TrackConfig()).tolist()


@pytest.mark.parametrize(
    ("other", "is_linked"),
    [
        (corners_of(0.49, 2), True),  # limit: 0.3 m, plus 0.2 m at 3 m/s
        (corners_of(0.51, 2), False),
        (corners_of(0.36, 2.36), False),  # moved by 0.51 m
        (corners_of(0.34, 2.34), True),
        (corners_of(0.52, 2, (1.54, 0.4)), True),  # the left edge does not move
        (corners_of(0.8, 2, (0.5, 2.0)), False),
        (corners_of(0.5, 2.5, (1, 1), np.pi / 4), False),  # moved by 0.52 m along a side
    ],
)
def test_observations_are_linked_if_their_edges_move_little(other, is_linked):
    one = corners_of(0, 2)
    assert linked([[one], [other]]) == [-1, 0 if is_linked else -1]
    assert linked([[other], [one]]) == [-1, 0 if is_linked else -1]


def test_each_observation_is_linked_at_most_once():
    box, near = corners_of(0, 2), corners_of(0.2, 2)
    assert linked([[box], [], [], [box], [], [], [], [box]]) == [-1, 0, -1]
    assert linked([[box], [box], [box, near]]) == [-1, 0, 1, -1]
    assert linked([[box], [box], [box]], first=2) == [-1, -1, 1]
    assert linked([[box], [box]], stamps=[0, 2.5e9]) == [-1, 0]
    assert linked([[box], [box]], stamps=[0, 2.6e9]) == [-1, -1]
    assert linked([[box], [box]], stamps=[7, 7]) == [-1, -1]
    world = [box, [np.nan] * 8]
    assert linked([[box], [box]], corners_world=world) == [-1, -1]
    assert linked([[box], [box]], corners_world=world[::-1]) == [-1, -1]
    grown, moved = corners_of(0.2, 2, (0.9, 0.4)), corners_of(-0.08, 2)
    assert linked([[box], [grown, moved]]) == [-1, -1, 0]
    line = corners_of(0, 2, (0.5, 0))
    assert linked([[line], [line, box]]) == [-1, 0, -1]


PAIR = corners_of(0, 2), corners_of(0.59, 2)  # a gap of 0.09 m


@pytest.mark.parametrize(
    ("ends", "pair", "begins", "lasts", "cut"),
    [
        (4, PAIR, 3, 9, True),
        (5, PAIR, 3, 9, True),
        (6, PAIR, 3, 9, False),  # both are visible in four frames
        (4, PAIR, 3, 5, True),
        (4, PAIR, 3, 4, False),  # both end in frame 4
        (2, PAIR, 0, 9, False),  # both begin in frame 0
        (4, (corners_of(0, 2), corners_of(0.61, 2)), 3, 9, False),
        (4, (corners_of(0, 2), corners_of(0.59, 2, (0.5, 1.7))), 3, 9, False),
        (4, (corners_of(0, 2, (0.5, 1.7)), corners_of(0.59, 2)), 3, 9, False),
    ],
)
def test_a_tracklet_ends_at_a_split_if_another_fragment_lasts_longer(
    ends, pair, begins, lasts, cut
):
    """One tracklet lasts from frame 0 to ``ends``, the other one from ``begins`` to ``lasts``."""
    shapes, last = (*pair, corners_of(0, 9)), {}
    spans = (0, ends), (begins, lasts), (0, 9)
    there = [[k for k, (a, b) in enumerate(spans) if a <= f <= b] for f in range(10)]
    own, before = np.concatenate(there), []
    for row, which in enumerate(own.tolist()):
        before.append(last.get(which, -1))
        last[which] = row
    things = in_frames([[shapes[k] for k in row] for row in there])
    left = np.where(cut & (own == 0) & (things.frame >= begins), -1, before)
    assert end_pieces(things, np.array(before), 0, TrackConfig()).tolist() == left.tolist()
    # A tracklet that began before the window has no such end.
    for first, ended in ((begins, left.tolist()), (begins + 1, before)):
        row = int(np.searchsorted(things.frame, first))
        assert end_pieces(things, np.array(before), row, TrackConfig()).tolist() == ended


def chains_of(
    *chains: tuple[int, list[list[float]]], **other: object
) -> tuple[Observations, np.ndarray, np.ndarray]:
    """Return observations of outlines in successive frames at 10 frames per second, the previous
    observation of each, and its chain."""
    rows = [(a + k, c, box) for c, (a, boxes) in enumerate(chains) for k, box in enumerate(boxes)]
    rows.sort(key=lambda row: row[:2])
    frame, own = np.array([row[:2] for row in rows]).T
    last, before = {}, []
    for row, which in enumerate(own.tolist()):
        before.append(last.get(which, -1))
        last[which] = row
    boxes = np.array([box for _, _, box in rows])
    return sightings(frame, frame * 10**8, boxes, **other), np.array(before), own


def walk(x: float, mps: float, frames: int) -> list[list[float]]:
    """Return outlines that move along x, 2 m ahead."""
    return [corners_of(x + mps * k / 10, 2) for k in range(frames)]


def test_tracklets_match_a_hand_calculation():
    """Velocities are fitted over 0.5 s, with a weak prior of 0."""
    away = walk(9, 0, 8)
    walker = [*walk(0, 0, 10), *walk(0, 1.0, 10)]
    things, before, _ = chains_of((0, walker), (3, away), (12, walk(5, 0, 1)))
    found = tracklets_of(things, before)
    assert found.length.tolist() == [20, 8, 1]
    assert things.frame[found.start].tolist() == [0, 3, 12]
    assert things.frame[found.end].tolist() == [19, 10, 12]
    spread = np.var(np.arange(6) / 10)
    mps = spread / (spread + 0.01)
    np.testing.assert_allclose(found.velocity[:, 1], [[mps, 0], [0, 0], [0, 0]], atol=1e-9)
    np.testing.assert_allclose(found.velocity[:, 0], 0, atol=1e-9)
    np.testing.assert_allclose(found.position[:, 0], [[0, 2], [9, 2], [5, 2]], atol=1e-9)
    np.testing.assert_allclose(found.position[:, 1], [[0.9, 2], [9, 2], [5, 2]], atol=1e-9)
    # The last observation is cut at the right to 0.3 of 0.5 m.
    hidden, across = things.hidden.copy(), things.across_m.copy()
    hidden[found.end[0]] = False, True
    across[found.end[0], 1] -= 0.2
    cut = tracklets_of(things._replace(hidden=hidden, across_m=across), before)
    np.testing.assert_allclose(cut.position[0, 1], [1.0, 2], atol=1e-9)


def goes_on(*chains: tuple[int, list[list[float]]], first: int = 0, **other: object) -> list[int]:
    """Return the chain that each chain continues, -1 for none."""
    things, before, own = chains_of(*chains, **other)
    after = link_tracklets(things, before, first, TrackConfig())
    starts = [int(np.flatnonzero(own == c)[0]) for c in range(len(chains))]
    kept = np.delete(np.arange(len(own)), starts)
    assert (after[kept] == before[kept]).all()
    assert all(after[s] < 0 or after[s] in tracklets_of(things, before).end for s in starts)
    return [int(own[after[s]]) if after[s] >= 0 else -1 for s in starts]


STANDS, WALKS = walk(0, 0, 10), walk(-0.9, 1.0, 10)  # both end at x = 0 in frame 9


@pytest.mark.parametrize(
    ("one", "other", "begins", "is_linked"),
    [
        (STANDS, walk(0.84, 0, 10), 19, True),  # limit: 0.35 m + 0.5 m/s * 1 s
        (STANDS, walk(0.86, 0, 10), 19, False),
        (STANDS, walk(0.59, 0, 10), 14, True),
        (STANDS, walk(0.61, 0, 10), 14, False),
        (STANDS, walk(0, 0, 10), 34, True),  # a gap of 2.5 s
        (STANDS, walk(0, 0, 10), 35, False),
        (STANDS, walk(0, 0, 2), 19, True),
        (STANDS, walk(0, 0, 1), 19, False),
        (walk(0, 0, 1), walk(0, 0, 9), 19, False),
        (WALKS, walk(1.5, 1.0, 10), 19, True),  # 0.75 m/s for a second
        (WALKS, walk(1.7, 1.0, 10), 19, False),
        (WALKS, walk(-0.2, 1.0, 10), 19, False),
        (WALKS, walk(0.2, 1.0, 10), 9, False),  # both are visible in frame 9
        ([*walk(0, 0, 10), *WALKS], walk(1.5, 1.0, 10), 29, True),
        (WALKS, [*walk(1.5, 1.0, 10), *walk(2.4, 0, 10)], 19, True),
        (WALKS, walk(1.5, 0, 10), 19, False),
        (STANDS, walk(1.5, 1.0, 10), 19, False),
    ],
)
def test_tracklets_continue_over_gaps_if_position_and_speed_fit(one, other, begins, is_linked):
    assert goes_on((0, one), (begins, other)) == [-1, 0 if is_linked else -1]


def test_the_best_tracklet_is_continued():
    here, aside, far = walk(0, 0, 10), walk(0.1, 0, 10), walk(50, 0, 31)
    broad = [corners_of(0, 2, (1, 0.8))] * 10
    assert goes_on((0, here), (15, broad), (15, aside)) == [-1, -1, 0]
    # Other tracklets start earlier, and end after the new one starts.
    assert goes_on((0, far), (0, far), (3, here), (20, here)) == [-1, -1, -1, 2]
    _, _, own = chains_of((0, here), (15, here))
    begins = int(np.flatnonzero(own)[0])
    assert goes_on((0, here), (15, here), first=begins) == [-1, 0]
    assert goes_on((0, here), (15, here), first=begins + 1) == [-1, -1]
    world = np.array([*here, *here])
    world[own == 1] = np.nan
    assert goes_on((0, here), (15, here), corners_world=world) == [-1, -1]


def way_of(boxes: list[list[float]], config: TrackConfig | None = None, **other: object) -> Motion:
    """Return the fitted motion of an object with an outline per frame."""
    things = in_frames([[box] for box in boxes], **other)
    stamps = (np.arange(len(boxes)) / RATE_HZ * 1e9).astype(np.int64)
    return motion_of(things, np.zeros(1, np.int64), stamps, 0, config or TrackConfig())


def between(low: np.ndarray | float, high: np.ndarray | float, frames: int = 60) -> list[list]:
    """Return outlines 0.4 m deep with given ends along x per frame."""
    ends = np.broadcast_arrays(low, high, np.zeros(frames))[:2]
    return [corners_of((a + b) / 2, 2, (b - a, 0.4)) for a, b in zip(*ends, strict=True)]


STEPS = np.linspace(0, 1, 60)
JUMPS = np.arange(60) % 2 - 0.5


@pytest.mark.parametrize(
    ("low", "high", "moves"),
    [
        (0.34 * STEPS, 0.5 + 0.34 * STEPS, True),
        (0.28 * STEPS, 0.5 + 0.28 * STEPS, False),
        (0.18 * STEPS, 0.5 + 0.6 * STEPS, True),
        (0.12 * STEPS, 0.5 + 0.6 * STEPS, False),  # only one end moves enough
        (0.7 * STEPS + 0.8 * JUMPS, 1 + 0.7 * STEPS + 0.8 * JUMPS, True),
        (0.33 * STEPS + 0.8 * JUMPS, 1 + 0.33 * STEPS + 0.8 * JUMPS, False),
        # Longer than 1.6 m.
        (0.44 * STEPS, 2 + 0.44 * STEPS, True),
        (0.38 * STEPS, 2 + 0.38 * STEPS, False),
        (-1.0 * STEPS, 1.7 + STEPS, False),
        (-1.6 * STEPS, 1.7 + 3.2 * STEPS, False),
        (0.32 * STEPS + 0.4 * JUMPS, 1.7 + 0.32 * STEPS, False),  # jumps in half of them
        (1.0 * STEPS + 0.4 * JUMPS, 2 + STEPS + 0.4 * JUMPS, True),
        (0.5 * STEPS + 0.4 * JUMPS, 2 + 0.5 * STEPS + 0.4 * JUMPS, False),
        (3.0 * STEPS + 0.6 * JUMPS, 2 + 3 * STEPS + 0.6 * JUMPS, False),
    ],
)
def test_objects_are_moving_if_all_of_their_sides_move(low, high, moves):
    motion = way_of(between(low, high))
    assert motion.moving.tolist() == [moves] and motion.velocity.any() == moves


def test_the_minimum_distance_of_moving_objects_is_a_setting():
    pushed = between(0.8 * STEPS, 2 + 0.8 * STEPS)
    assert way_of(pushed).moving.all()
    assert not way_of(pushed, TrackConfig(moving_m=1.0)).moving.any()
    aside = [corners_of(0.24 * s, 2 + 0.24 * s) for s in STEPS]
    assert way_of(aside).moving.all()


def test_objects_with_mostly_implausible_speeds_are_not_moving():
    for stands, runs in ((20, 40), (40, 20)):
        x = [0.0] * stands + [4 * f / RATE_HZ for f in range(runs)]
        assert way_of([corners_of(at, 2) for at in x]).moving.tolist() == [stands > runs]


def test_noise_of_distant_observations_is_not_motion():
    far = np.arange(60) % 10 == 7
    boxes = between(STEPS + 1.5 * far, 2 + STEPS + 1.5 * far)
    assert way_of(boxes, distance_m=np.where(far, 15.0, 0.5)).moving.all()
    assert not way_of(boxes, distance_m=np.full(60, 0.5)).moving.any()


def test_an_outlier_hardly_moves_the_trajectory():
    boxes = [corners_of(f / RATE_HZ, 2 + 0.5 * (f == 15)) for f in range(30)]
    motion = way_of(boxes, distance_m=np.where(np.arange(30) == 15, 15.0, 0.5))
    np.testing.assert_allclose(motion.position[:, 1], 2, atol=0.002)
    np.testing.assert_allclose(motion.velocity, [[1, 0]] * 30, atol=0.02)


def test_trajectories_are_interpolated_in_gaps():
    """A person is hidden for 1 s and reappears 1 m to the left."""
    things = in_frames([[corners_of(f / RATE_HZ, 2.0 + (f > 15))] for f in range(31)])
    things = things.take(np.abs(things.frame - 15.5) > 7)
    stamps = (np.arange(-5, 31) / RATE_HZ * 1e9).astype(np.int64)
    motion = motion_of(things, np.zeros(1, np.int64), stamps, -5, TrackConfig())
    assert motion.position.shape == (31, 2)
    assert np.abs(motion.velocity[[8, 23], 1]).max() < 0.5
    np.testing.assert_allclose(motion.position[15, 1], 2 + 7 / 15, atol=0.02)


def test_trajectories_of_several_tracks_equal_separate_ones():
    ways = [walk(0, 1.0, 20), between(0.0, 2.0, 9), walk(3, 0, 1), walk(4, -2.0, 12)]
    alone = [way_of(way) for way in ways]
    things = in_frames([[box] for way in ways for box in way])
    things = things._replace(frame=np.concatenate([np.arange(len(way)) for way in ways]))
    stamps = (np.arange(20) / RATE_HZ * 1e9).astype(np.int64)
    first = np.cumsum([0, *map(len, ways[:-1])])
    together = motion_of(things, first, stamps, 0, TrackConfig())
    assert together.first.tolist() == first.tolist()
    for name in ("position", "velocity", "moving"):
        parts = np.concatenate([getattr(motion, name) for motion in alone])
        np.testing.assert_allclose(getattr(together, name), parts, atol=1e-12)


def test_local_lines_are_fitted_to_frames_at_any_times():
    """Frames within 0.7 s are used, or else the adjacent ones."""
    seconds = np.array([0, 1, 2.5, 3.0, 3.1, 5.0])
    through = [(0, 1), (0, 1, 2), (2, 3, 4), (2, 3, 4), (2, 3, 4), (4, 5)]
    x = np.array([[0, 1, 1, 2, 1.5, 3], [9, 7, 7.5, 5, 5, 2]])
    things = in_frames([[corners_of(at, 2)] for at in x.ravel()], distance_m=np.zeros(12))
    things = things._replace(frame=np.tile(np.arange(6), 2))
    config = TrackConfig(max_speed_mps=50.0)
    motion = motion_of(things, np.array([0, 6]), (seconds * 1e9).astype(np.int64), 0, config)
    for way, place, velocity in zip(x, *(np.split(a, 2) for a in motion[1:3]), strict=True):
        for k, chosen in enumerate(map(list, through)):
            t, at = seconds[chosen] - seconds[chosen].mean(), way[chosen]
            slope = (t * at).mean() / ((t * t).mean() + STEADY_S**2)
            assert velocity[k, 0] == pytest.approx(slope)
            line = at.mean() + slope * (seconds[k] - seconds[chosen].mean())
            assert place[k, 0] == pytest.approx(line)


def test_numbers_of_tracks_match_a_hand_calculation():
    """Tracks are numbered in the order of their first observations, once they are certain."""
    numbers = TrackIds(3)

    def add(*chains: int, obstacles: tuple[int, ...] = ()) -> list[list[int]]:
        numbers.add(np.array(chains), np.array(obstacles or chains))
        return [of.tolist() for of in numbers.take()]

    assert add(0, 1, 0) == [] == add(0, 2)
    assert add(1, 1) == [[0, 1, 0]]
    numbers.end([2])
    assert [of.tolist() for of in numbers.take()] == [[0, -1], [1, 1]]
    numbers.end([0, 1])
    assert not numbers.take() and not numbers.ids
    assert add(3, 3, 3, obstacles=(3, 3, 3, 3)) == [[2, 2, 2, 2]]
    numbers.add(np.zeros(0, np.int64), np.zeros(0, np.int64))
    (none,) = numbers.take()
    assert none.dtype == np.int32 and not len(none)
    assert numbers.ids == {3: 2} and numbers.is_track(3)
    # A finished chain is kept while its observations wait for other chains.
    assert add(3, 4, 4) == [] and numbers.is_track(3)
    numbers.end([3])
    assert numbers.take() == [] and add(4) == [[2, 3, 3], [3]]
    assert numbers.ids == {4: 3}


def test_a_piece_of_a_track_matches_a_hand_calculation():
    boxes = [corners_of(0, 2, (w, 0.3)) for w in (0.2, 0.6, 0.5)]
    seen = in_frames([[box] for box in boxes], top_m=[1.0, np.nan, 1.5])
    numbers, stamps = np.arange(70, 74), np.arange(5, 9) * 10**8
    way = np.array([[0, 2], [0.1, 2], [0.8, 3], [0.3, 5]])
    stands = piece_of(seen, numbers, stamps, way, np.zeros(4))
    assert stands[:8] == (True, 70, 73, 5 * 10**8, 8 * 10**8, 3, 3, False)
    np.testing.assert_allclose(stands[8:11], [0.5, 0.3, 1.25])
    assert stands.path.tolist() == [[0.2, 2.5]] and stands.speed.tolist() == [0]
    moves = piece_of(seen, numbers, stamps, way, np.array([0, 1, 0, 0.5]))
    assert moves.moving and moves.path is way and moves.speed.tolist() == [0, 1, 0, 0.5]
    blind = piece_of(seen._replace(top_m=np.full(3, np.nan)), numbers, stamps, way, np.zeros(4))
    assert np.isnan(blind.top_m)


def test_a_track_of_several_pieces_matches_a_hand_calculation():
    """A standing piece has a point per frame; sizes are weighted by observations."""

    def piece(first: int, frames: int, seen: int, top_m: float, *speed: float) -> Piece:
        count, moving = len(speed), any(speed)
        path, speeds = np.full((count, 2), float(first)), np.array(speed, np.float32)
        about = (
            True,
            first,
            first + frames - 1,
            first * 10,
            (first + frames - 1) * 10,
            seen,
            2 * seen,
        )
        return Piece(*about, moving, first / 10, 0.5, top_m, frames, path, speeds)

    still, later = piece(10, 3, 1, np.nan, 0), piece(13, 2, 2, 1.5, 0)
    walks = piece(15, 2, 1, 1.2, 1, 4)
    track = track_of(7, [still, later, walks])
    assert track[:9] == (7, True, 10, 16, 100, 160, 4, 8, True)
    np.testing.assert_allclose(track[9:14], [1 / 7 * 5, 4, 1.275, 0.5, 1.4])
    assert track.path[:, 0].tolist() == [10, 10, 10, 13, 13, 15, 15]
    assert track.speed.tolist() == [0, 0, 0, 0, 0, 1, 4]
    stands = track_of(0, [still, later])
    assert not stands.moving and stands.mean_speed_mps == 0 == stands.max_speed_mps
    assert stands.path.tolist() == [[12, 12]] and stands.speed.tolist() == [0]
    assert stands.top_m == 1.5 and np.isnan(track_of(0, [still]).top_m)


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_greedy_matching_takes_the_cheapest_pairs_first(seed):
    """Matches equal those of a loop; with one pair per row they are the optimal assignment."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 12))
    a, b = rng.integers(0, 6, (2, count))
    b = b + 6
    cost = rng.integers(0, 5, count).astype(float)
    taken, used = [], set()
    for k in np.lexsort((b, a, cost)).tolist():
        if a[k] not in used and b[k] not in used:
            taken.append(k)
            used |= {int(a[k]), int(b[k])}
    assert greedy_matching(a, b, cost, 12).tolist() == sorted(taken)
    apart = 10.0 * np.abs(np.subtract.outer(np.arange(4), rng.permutation(4)))
    rows, columns = np.divmod(np.arange(16), 4)
    best = greedy_matching(rows, columns + 4, apart.ravel(), 8)
    assert (columns[best] == linear_sum_assignment(apart)[1]).all()


def test_pairs_chains_and_components_match_a_hand_calculation():
    a, b = pairs_in_frames(np.array([0, 0, 0, 2, 3, 3]))
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == [(0, 1), (0, 2), (1, 2), (4, 5)]
    assert chain_starts(np.array([-1, 0, -1, 1, 2, 3])).tolist() == [0, 0, 2, 0, 2, 0]
    assert components(6, np.array([4, 1]), np.array([5, 4])).tolist() == [0, 1, 2, 3, 1, 1]
    assert components(3, np.array([1, 0]), np.array([2, 2])).tolist() == [0, 0, 0]
    assert components(5, np.array([3, 2, 1]), np.array([4, 3, 2])).tolist() == [0, 1, 1, 1, 1]


def test_rectangles_of_outlines_match_a_hand_calculation():
    a = Outlines.of_corners(np.array([corners_of(0, 0, (2, 1)), corners_of(0, 0, (2, 1))]))
    b = Outlines.of_corners(np.array([corners_of(1, 0, (2, 1)), corners_of(3, 0, (2, 1))]))
    np.testing.assert_allclose(overlap(a, b), [0.5, -0.5])
    np.testing.assert_allclose(gap(a, b), [-1 + 0, 1], atol=1e-12)
    np.testing.assert_allclose(displacement(a, b), [1, 3])
    grown = Outlines.of_corners(
        np.array([corners_of(0.5, 0, (3, 1)), corners_of(0, 0, (3, 3), 0.3)])
    )
    np.testing.assert_allclose(displacement(a, grown), [0, 0], atol=1e-12)
    np.testing.assert_allclose(a.area, 2)
    # The ends moved by 0.6 and -0.4 m.
    wider = Outlines.of_corners(np.array([corners_of(0.1, 0, (3, 1))]))
    np.testing.assert_allclose(displacement(a.take(np.array([0])), wider), 0.1)
    # They overlap along the sides of the first, but not along those of the second.
    low = Outlines.of_corners(np.array([corners_of(0, 0, (1, 0.6)), corners_of(0, 0, (1, 0.6))]))
    across = 0.5 + 0.27 / np.sqrt(2), 0.3 + 0.27 / np.sqrt(2)
    turned = Outlines.of_corners(
        np.array([corners_of(*across, (1.5, 0.3), 0.75 * np.pi), corners_of(0.1, 0, (0.5, 0.2))])
    )
    for one, other in ((low, turned), (turned, low)):
        np.testing.assert_allclose(gap(one, other)[0], 0.12)
        np.testing.assert_allclose(overlap(one, other), [-0.12 / 0.3, 1])
    line = Outlines.of_corners(np.array([corners_of(0, 0, (0, 0.6))]))
    for way, reach in (((1.0, 0.0), 0), ((0.0, 1.0), 0.3)):
        np.testing.assert_allclose(line.reach(np.array([way])), reach)
    point = Outlines.of_corners(np.array([[1.0, 2.0] * 4]))
    assert np.hypot(*point.axis.T) == 1
    assert (point.center == [[1, 2]]).all() and (point.half == 0).all() and point.area == 0


def test_rows_of_tracks_are_written_in_order_of_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(tracks_rows, "PART_ROWS", 2)
    (stands, walks), _ = follow([[corners_of(2, 1), corners_of(3, f / 9)] for f in range(9)])
    path, log = tmp_path / "rows", SimpleNamespace(name="a log", camera="left")
    with TrackRows(path, log) as rows:
        rows.add([walks._replace(number=2), stands._replace(number=0, top_m=np.nan)])
        rows.add([])
        rows.add([walks._replace(number=1, in_world=False)])
        parts = [part.to_pylist() for part in rows.ordered()]
        assert (len(rows), rows.moving, rows.in_world) == (3, 2, 2) and path.exists()
    assert not path.exists() and [len(part) for part in parts] == [2, 1]
    none, one, two = [*parts[0], *parts[1]]
    assert [row["track"] for row in (none, one, two)] == [0, 1, 2]
    assert (none["log"], none["camera"], none["top_m"]) == ("a log", "left", None)
    assert (one["in_world"], two["in_world"]) == (False, True)
    assert two["path"] == walks.path.ravel().tolist() and two["speed_mps"] == walks.speed.tolist()
