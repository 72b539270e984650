"""Tracks by hand: crossings, occlusions, fragments, motion; and tables in a results folder.

Single steps are tested in ``tests/test_tracks_steps.py``.
"""

import dataclasses
import shutil
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from jaxdet.cli import main
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import ConfigError, InputError
from jaxdet.io import find_logs
from jaxdet.sim import SimConfig, write_log
from jaxdet.tracks import Track, TrackConfig, Tracker, track_results
from jaxdet.tracks import folder as tracks_folder
from jaxdet.tracks import rows as tracks_rows
from jaxdet.tracks.observations import Observations, observations_of
from jaxdet.tracks.outlines import Outlines
from jaxdet.tracks.tracker import PIECE_FRAMES
from tests.runs import only_log, run_logs

RATE_HZ = 15.0
PERSON = (0.5, 0.4)


def corners_of(x: float, y: float, size: tuple[float, float] = PERSON, yaw: float = 0.0) -> list:
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    c, s = np.cos(yaw), np.sin(yaw)
    return (half @ np.array([[c, s], [-s, c]]) + (x, y)).ravel().tolist()


def in_picture(boxes: np.ndarray) -> dict[str, np.ndarray]:
    """Return the first and last image column (of 640), and the range of x, of each outline."""
    right, forward = boxes[:, ::2], boxes[:, 1::2]
    u = np.clip(320 + 400 * right / np.maximum(forward, 0.1), 0, 639)
    low, high = right.min(axis=1, initial=99), right.max(axis=1, initial=-99)
    return {
        "u_min": u.min(1, initial=999),
        "u_max": u.max(1, initial=0),
        "x_min": low,
        "x_max": high,
    }


def sightings(
    frame: np.ndarray, stamps: np.ndarray, boxes: np.ndarray, **other: object
) -> Observations:
    """Return observations of outlines ``(N, 8)`` in frames ``(N,)`` by an upright camera at the
    origin, optionally with other columns and rolls."""
    count = len(boxes)
    columns = {
        "corners_ground": boxes,
        "corners_world": boxes,
        "bottom_m": np.zeros(count, np.float32),
        "top_m": np.full(count, 1.7, np.float32),
        "distance_m": np.hypot(boxes[:, ::2], boxes[:, 1::2]).min(axis=1, initial=99),
        "z_min": np.full(count, 1.5),
        **in_picture(boxes),
        "roll_rad": np.zeros(count),
    } | {name: np.asarray(values) for name, values in other.items()}
    return observations_of(frame, stamps, columns.pop("roll_rad"), columns, 640)


def follow(
    frames: list[list[list[float]]],
    *,
    poses: bool | np.ndarray = True,
    roll_rad: float = 0.0,
    rate_hz: float = RATE_HZ,
    window: int = 10_000,
    bottom: dict[tuple[int, int], float] | None = None,
    config: TrackConfig | None = None,
) -> tuple[list[Track], list[list[int]]]:
    """Track outlines given by frame; return the tracks and the track of each outline."""
    tracker, tracks, of = Tracker(config or TrackConfig()), [], [np.zeros(0, np.int32)]
    stamps = (np.arange(len(frames)) / rate_hz * 1e9).astype(np.int64) + 10**9
    for start in range(0, max(len(frames), 1), window):
        part = frames[start : start + window]
        rows = [(start + f, i, box) for f, boxes in enumerate(part) for i, box in enumerate(boxes)]
        frame = np.array([f for f, _, _ in rows], np.int64)
        boxes = np.array([box for _, _, box in rows], np.float32).reshape(-1, 8)
        low = [(bottom or {}).get((f, i), 0.0) for f, i, _ in rows]
        known = np.broadcast_to(poses, len(frames))[frame]
        columns: dict[str, np.ndarray] = {
            "corners_world": np.where(known[:, None], boxes, np.nan),
            "bottom_m": np.array(low, np.float32),
            "roll_rad": np.full(len(rows), roll_rad),
        }
        if abs(roll_rad) > np.pi / 2:
            columns |= in_picture(boxes * np.tile((-1, 1), 4))
        seen = sightings(frame, stamps[frame], boxes, **columns)
        size = Outlines.of_corners(boxes).area
        stop = min(start + window, len(frames))
        tracker.add(np.arange(start, stop), stamps[start:stop], seen, size)
        for found, decided in zip((tracks, of), tracker.take(), strict=True):
            found += decided
    tracker.finish()
    for found, decided in zip((tracks, of), tracker.take(), strict=True):
        found += decided
    tracks.sort()
    assert [track.number for track in tracks] == [*range(len(tracks))]
    ends = np.cumsum([len(boxes) for boxes in frames])[:-1]
    return tracks, [part.tolist() for part in np.split(np.concatenate(of), ends)]


def test_a_standing_and_a_walking_object_have_separate_tracks():
    frames = [[corners_of(2, 1), corners_of(3, -1 + f / RATE_HZ)] for f in range(30)]
    (stands, walks), of = follow(frames)
    assert of == [[0, 1]] * 30
    assert not stands.moving and stands.mean_speed_mps == 0 and stands.path.shape == (1, 2)
    np.testing.assert_allclose(stands.path, [[2, 1]], atol=1e-6)
    assert walks.moving and walks.path.shape == (30, 2) and walks.in_world
    np.testing.assert_allclose(walks.path[:, 1], -1 + np.arange(30) / RATE_HZ, atol=5e-3)
    np.testing.assert_allclose(walks.speed, 1.0, atol=0.02)
    assert (walks.first_frame, walks.last_frame, walks.frames, walks.obstacles) == (0, 29, 30, 30)
    np.testing.assert_allclose((walks.length_m, walks.width_m, walks.top_m), (0.5, 0.4, 1.7))


def test_swapped_sides_of_an_outline_do_not_disturb_a_track():
    """AB is the longer side in some frames and the shorter one in others."""
    long, wide = corners_of(2, 0, (1.0, 0.4)), corners_of(2, 0, (0.4, 1.0), np.pi / 2)
    (cart,), _ = follow([[long] if f % 2 else [wide] for f in range(10)])
    np.testing.assert_allclose((cart.length_m, cart.width_m), (1.0, 0.4), rtol=1e-6)
    frames = []
    for f in range(30):
        size, yaw = ((2.0, 0.4), 0.0) if f % 2 else ((0.4, 2.0), np.pi / 2)
        frames.append([corners_of(f / RATE_HZ, 2, size, yaw)])
    (lorry,), _ = follow(frames)
    assert lorry.moving and lorry.length_m == pytest.approx(2.0)


def test_crossing_people_keep_their_tracks():
    """Two people pass each other at a distance of 0.6 m and change their order."""
    frames = []
    for f in range(45):
        along = f / RATE_HZ - 1.5
        pair = [corners_of(2.0, along), corners_of(2.6, -along)]
        frames.append(pair if f % 2 else pair[::-1])
    tracks, of = follow(frames)
    assert len(tracks) == 2 and all(track.moving for track in tracks)
    first = of[0][::-1]
    assert all((row if f % 2 else row[::-1]) == first for f, row in enumerate(of))


@pytest.mark.parametrize(("hidden_s", "count"), [(2.4, 1), (2.6, 2)])
def test_an_object_hidden_for_too_long_has_a_new_track(hidden_s, count):
    """The object reappears at the same position."""
    box, hidden = [corners_of(2, 0)], round(hidden_s * RATE_HZ)
    tracks, of = follow([box] * 10 + [[]] * (hidden - 1) + [box] * 10)
    assert len(tracks) == count and of[0] == [0] and of[-1] == [count - 1]


def test_a_person_hidden_by_a_pillar_keeps_the_track():
    """The person is hidden for 1 s; the trajectory has a point in each frame."""
    frames = []
    for f in range(60):
        y = f / RATE_HZ - 2
        boxes = [corners_of(2, 0, (0.4, 0.4))]
        frames.append(boxes if abs(y) < 0.5 else [*boxes, corners_of(3, y)])
    (pillar, person), of = follow(frames)
    assert not pillar.moving and person.moving and person.frames < 50
    assert person.path.shape == (60, 2)
    np.testing.assert_allclose(person.path[:, 1], np.arange(60) / RATE_HZ - 2, atol=0.02)
    assert [of[0][1], of[59][1]] == [1] * 2


def part_of(x: float, low: float = -np.inf, high: float = np.inf) -> list:
    """Return the visible part of a person 0.5 m wide at (x, 2), between two limits."""
    left, right = max(x - 0.25, low), min(x + 0.25, high)
    return [corners_of((left + right) / 2, 2, (right - left, 0.4))] if right - left > 0.05 else []


@pytest.mark.parametrize("roll_rad", [0.7, np.nan, np.pi, -2.4])
def test_trajectories_are_not_bent_at_the_borders_of_the_image(roll_rad):
    """The left border of the image hides a part at first, the right one at last. The trajectory is
    that of the complete body, at any roll of the camera."""
    edge = 319 / 400 * 1.8  # intersection of the nearer side with the border
    x = -1.8 + np.arange(54) / RATE_HZ
    (walks,), _ = follow([part_of(at, -edge, edge) for at in x], roll_rad=roll_rad)
    first = walks.first_frame
    assert first > 0 and walks.last_frame < 53 and walks.moving
    off = walks.path[:, 0] - x[first : first + len(walks.path)]
    assert np.abs(off).max() < 0.16 and np.abs(off[6:-6]).max() < 0.04
    assert np.abs(walks.speed - 1).max() < 0.12


def test_trajectories_are_not_bent_by_partial_occlusion():
    """Hidden parts are extrapolated, so neither the direction nor the speed changes."""
    x = -1.2 + np.arange(36) / RATE_HZ
    half = 0.2 * 2 / 1.5
    frames = []
    for at in x:
        sides = part_of(at, high=-half) + part_of(at, low=half)
        frames.append([corners_of(0, 1.5, (0.4, 0.1)), *sides])
    (pillar, walks), of = follow(frames)
    assert not pillar.moving and of[0] == [0, 1] and of[-1] == [0, 1]
    assert np.abs(walks.path[:, 0] - x[: len(walks.path)]).max() < 0.06
    assert np.abs(walks.speed - 1).max() < 0.15


def test_an_outline_merged_with_another_object_hardly_moves_the_trajectory():
    """One outline contains both objects in a few frames."""
    frames = [[corners_of(2, f / RATE_HZ)] for f in range(30)]
    frames[15] = [corners_of(2.35, 1.2, (1.1, 0.9))]
    (walks,), _ = follow(frames)
    np.testing.assert_allclose(walks.path[:, 0], 2, atol=0.01)
    np.testing.assert_allclose(walks.speed, 1, atol=0.05)


def test_a_walking_person_hidden_for_too_long_has_a_new_track():
    frames = [[corners_of(2, 0)] if f < 20 or f > 60 else [] for f in range(80)]
    tracks, of = follow(frames)
    assert len(tracks) == 2 and of[0] == [0] and of[79] == [1]


def test_fragments_of_an_object_are_one_track():
    """Legs with overlapping outlines and an arm above the floor belong to one person; a low object
    at the same position is separate."""
    body, leg, arm = (
        corners_of(2, 0),
        corners_of(2.05, 0.05, (0.2, 0.2)),
        corners_of(1.7, 0, (0.1, 0.1)),
    )
    frames = [[body, leg, arm]] * 10
    (person,), of = follow(frames, bottom={(f, 2): 0.8 for f in range(10)})
    assert of == [[0, 0, 0]] * 10 and person.obstacles == 30 and person.frames == 10
    tracks, of = follow(frames)
    assert len(tracks) == 2 and of == [[0, 0, 1]] * 10


def test_a_track_continues_with_the_fragment_that_lasts():
    """An object splits into two fragments, and the first one disappears. Its track continues with
    the other, and objects nearby keep their tracks."""
    frames = []
    for f in range(30):
        y = f / RATE_HZ
        near, far = corners_of(2, y, (0.3, 0.3)), corners_of(2, y + 0.29, (0.6, 0.28))
        frames.append([near] if f < 15 else [near, far] if f == 15 else [far])
    (walks,), of = follow(frames)
    assert walks.moving and (walks.first_frame, walks.last_frame) == (0, 29)
    assert of == [[0]] * 15 + [[-1, 0]] + [[0]] * 14
    apart = [[*boxes[:-1], corners_of(2.6, boxes[-1][1] + 0.3)] for boxes in frames[15:]]
    tracks, _ = follow([*frames[:15], *apart])
    assert len(tracks) == 2


def test_a_static_object_that_gradually_becomes_visible_is_not_moving():
    """The visible part of the object grows at one end."""
    frames = [[corners_of(2, 0.25 + f / 40, (0.5, 0.5 + f / 20))] for f in range(30)]
    (shelf,), _ = follow(frames)
    assert not shelf.moving


def test_an_implausibly_fast_object_is_not_moving():
    """The object shifts by 0.3 m in each of four observations at 15 Hz."""
    frames = [[corners_of(0.3 * f, 3.0)] for f in range(4)]
    (track,), _ = follow(frames)
    assert not track.moving and not track.mean_speed_mps
    (track,), _ = follow(frames, config=TrackConfig(max_speed_mps=6.0))
    assert track.moving and 4.0 < track.mean_speed_mps < 5.0


def test_a_track_fitted_in_pieces_equals_one_fitted_as_a_whole():
    """One object stands for five pieces, then walks; another walks all the time. Their trajectories
    are those of tracks that are not divided into pieces."""
    count = 5 * PIECE_FRAMES + 100
    swing = np.sin(np.arange(count) / 40)
    frames = []
    for f in range(count):
        y = 1 + max(0, f - 5000) / RATE_HZ * 0.8
        stands = [corners_of(2, y)] * (f % 7 != 3)
        frames.append([*stands, corners_of(4, float(swing[f])), corners_of(6, 0)])
    tracks, of = follow(frames, window=256)
    assert of == [[0, 1, 2] if f % 7 != 3 else [1, 2] for f in range(count)]
    assert [track.moving for track in tracks] == [True, True, False]
    for track in tracks:
        assert (track.frames, track.last_frame) == (sum(track.number in t for t in of), count - 1)
        assert track.path.shape == (count if track.moving else 1, 2)
        np.testing.assert_allclose((track.length_m, track.width_m), (0.5, 0.4), rtol=1e-6)
    np.testing.assert_allclose(tracks[0].path[:4096], [[2, 1]] * 4096, atol=1e-6)
    np.testing.assert_allclose(tracks[0].speed[5050:], 0.8, atol=0.02)
    np.testing.assert_allclose(tracks[1].path[:, 1], swing, atol=0.03)
    np.testing.assert_allclose(tracks[2].path, [[6, 0]], atol=1e-6)


def test_pieces_are_fitted_like_a_complete_track():
    """Pieces are also fitted after a gap, and while other tracks are not in pieces yet."""
    frames = []
    for f in range(4000):
        seldom = [corners_of(4, float(np.sin(f / 400)))] * (f % 42 < 8 and f > 600)
        frames.append([*seldom, corners_of(2, float(np.sin(f / 40)))])
    (whole, of), (parts, of_parts) = (follow(frames, window=window) for window in (10_000, 256))
    assert of == of_parts
    for one, other in zip(whole, parts, strict=True):
        assert one.moving and one[:6] == other[:6]
        np.testing.assert_allclose(one.path, other.path, atol=1e-9)
        np.testing.assert_allclose(one.speed, other.speed, atol=1e-6)


def test_a_gap_in_a_track_may_be_longer_than_a_piece():
    """The track continues if the settings allow such gaps."""
    box, other = corners_of(2, 0), corners_of(4, 0)
    count = 4 * PIECE_FRAMES
    frames = [[other, box] if f < 9 or f > count - 9 else [other] for f in range(count)]
    tracks, of = follow(frames, window=256, config=TrackConfig(max_gap_s=1000.0))
    assert len(tracks) == 2 and of[0] == of[-1] == [0, 1]
    assert tracks[1].frames == 17 and tracks[1].last_frame == count - 1


def test_tracks_are_numbered_in_order_over_many_windows():
    """A track with rare observations delays the numbers of later ones."""
    frames, expected = [], []
    for f in range(200):
        visit = 5 <= f % 20 < 13
        frames.append([corners_of(0, 2), *[corners_of(2 + f // 20, 2)] * visit])
        expected.append([0, *[1 + f // 20] * visit])
    tracks, of = follow(frames, window=20)
    assert of == expected and len(tracks) == 11
    frames = [[corners_of(0, 2)] * (f % 30 < 2) + [corners_of(2, 2)] * (f < 12) for f in range(180)]
    config = TrackConfig(min_frames=10)
    tracks, of = follow(frames, window=20, config=config)
    assert [track.frames for track in tracks] == [12, 12]
    assert of == [[0] * (f % 30 < 2) + [1] * (f < 12) for f in range(180)]


@pytest.mark.parametrize("seen", [(19,), (18, 20), (17, 19)])
def test_an_object_that_returns_at_the_end_of_a_window_keeps_its_track(seen):
    """The object is observed once or twice near the end of the first window."""
    frames, expected = [], []
    for f in range(60):
        there = f < 8 or f in seen or f > 21
        frames.append([corners_of(0, 2), *[corners_of(3, 2 + f / RATE_HZ)] * there])
        expected.append([0, *[1] * there])
    tracks, of = follow(frames, window=20)
    assert of == expected and len(tracks) == 2
    assert tracks[1].frames == sum(map(len, frames)) - 60


def test_memory_of_tracking_with_a_standing_camera_is_bounded():
    """The bound holds for objects that are always visible and for intermittently visible ones."""
    config, tracker = TrackConfig(), Tracker(TrackConfig())
    window, boxes = 512, np.array([corners_of(2 * k, 0) for k in range(6)], np.float32)
    kept, rows = [], 0
    for start in range(0, 40 * window, window):
        frame = start + np.arange(window)
        stamps = (frame / RATE_HZ * 1e9).astype(np.int64)
        # One of six objects is visible in every second period of 4 s, another most of the time.
        there = np.ones((window, 6), bool)
        there[:, 5] = frame // 60 % 2 > 0
        there[:, 4] = frame % (6 * window) > 60
        at, which = np.nonzero(there)
        found = np.full(len(at), 1, np.float32)
        columns = dict.fromkeys(("bottom_m", "top_m", "distance_m", "z_min"), found)
        columns |= in_picture(boxes[which])
        columns |= dict.fromkeys(("corners_ground", "corners_world"), boxes[which])
        seen = observations_of(frame[at], stamps[at], np.zeros(len(at)), columns, None)
        tracker.add(frame, stamps, seen, np.ones(len(at), np.int64))
        assert tracker.observations is not None
        tracks, decided = tracker.take()
        rows += sum(map(len, decided))
        pieces = [piece for part in tracker.pieces.values() for piece in part]
        ids, frames = tracker.track_ids, tracker.observations.frame
        state = (frames, tracker.stamps, ids.ids, ids._counts, ids._rows)
        state += tracker.begin, tracker.pieces
        kept.append([*map(len, state), sum(len(piece.path) for piece in pieces)])
        # If more than 2,048 frames wait, all but the last 1,024 form a piece.
        assert {piece.num_frames for piece in tracker.pieces.get(0, ())} <= {3 * window}
        assert all(track.path.shape == (1, 2) for track in tracks)
    limit = 6 * (2 * PIECE_FRAMES + window + RATE_HZ * (config.smooth_s + config.max_gap_s))
    assert np.max(kept, axis=0)[0] <= limit
    assert (np.max(kept[20:], axis=0)[:-1] <= np.max(kept[10:20], axis=0)[:-1]).all()
    assert kept[-1][-1] <= 6 * 40  # a point per piece of standing objects
    tracker.finish()
    tracks, decided = tracker.take()
    assert len(tracks) == 6 and rows + sum(map(len, decided)) > 40 * window * 5


@pytest.mark.parametrize("rate_hz", [0.45, 1.0, 1.42])
def test_speeds_in_frames_seconds_apart_are_those_between_adjacent_frames(rate_hz):
    """The interval exceeds ``smooth_s``, so speeds are those to the adjacent frames."""
    frames = [[corners_of(4, f / rate_hz - 3), corners_of(6, 0)] for f in range(12)]
    (walks, stands), _ = follow(frames, rate_hz=rate_hz)
    np.testing.assert_allclose(walks.speed, 1, atol=0.01)
    np.testing.assert_allclose(walks.path[:, 1], np.arange(12) / rate_hz - 3, atol=0.01)
    assert walks.moving and not stands.moving


def test_a_walking_person_who_was_hidden_keeps_the_track_at_a_low_frame_rate():
    """The person is hidden for four frames, 2.2 s, and reappears far away."""
    frames = [[corners_of(4, f / 1.8 - 4)] * (not 5 < f < 9) for f in range(15)]
    [walker], _ = follow(frames, rate_hz=1.8)
    assert walker.frames == 12 and walker.moving
    np.testing.assert_allclose(walker.path[:, 1], np.arange(15) / 1.8 - 4, atol=0.05)


def test_few_observations_are_not_a_track():
    frames = [[corners_of(2, 0)] * (f < 3) for f in range(30)]
    assert follow(frames) == ([], [[-1]] * 3 + [[]] * 27)
    legs = [corners_of(2, 0), corners_of(2, 0.1)]
    assert follow([legs] * 3) == ([], [[-1, -1]] * 3)


def test_without_poses_tracks_are_in_the_camera_frame():
    frames = [[corners_of(2, f / RATE_HZ)] for f in range(20)]
    (track,), _ = follow(frames, poses=False)
    assert not track.in_world and track.moving


def test_without_frames_or_obstacles_there_are_no_tracks():
    assert follow([]) == ([], [[]])
    assert follow([[], []]) == ([], [[], []])


def random_frames(seed: int, frames: int) -> list[list[list[float]]]:
    """Return outlines of walking people, some of them hidden now and then."""
    rng = np.random.default_rng(seed)
    start, speed = rng.uniform(-3, 3, (5, 2)), rng.uniform(-1, 1, (5, 2))
    found = []
    for f in range(frames):
        places = start + speed * f / RATE_HZ + rng.normal(0, 0.02, (5, 2))
        found.append([corners_of(*place) for place in places if rng.random() < 0.8])
    return found


@pytest.mark.parametrize("seed", range(3))
def test_tracks_are_reproducible_and_nearly_independent_of_windows(seed):
    """Tracks continue from window to window; only gaps may be resolved in another order."""
    frames = random_frames(seed, 120)
    whole, of = follow(frames)
    again, same = follow(frames)
    assert same == of
    for one, other in zip(whole, again, strict=True):
        assert one[:-2] == other[:-2] and (one.path == other.path).all()
    parts, of_parts = follow(frames, window=50)
    assert len(parts) == len(whole) and of_parts == of


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(TrackConfig)])
def test_settings_out_of_range_are_errors(field):
    name, whole = field.replace("_", "-"), isinstance(getattr(TrackConfig(), field), int)
    with pytest.raises(ConfigError, match=f"{name} is out of range"):
        TrackConfig(**{field: -1})
    problem = ": expected an integer, got float" if whole else " is out of range"
    with pytest.raises(ConfigError, match=f"{name}{problem}"):
        TrackConfig(**{field: float("inf")})
    with pytest.raises(ConfigError, match=f"{name}: expected .*, got bool"):
        TrackConfig(**{field: False})
    if field.endswith("_m"):
        with pytest.raises(ConfigError, match=f"{name} is out of range"):
            TrackConfig(**{field: 100.0})


def test_settings_at_the_limits_of_their_ranges_are_accepted():
    TrackConfig(overlap=1.0, floats_m=0.0, touch_m=0.0, max_gap_frames=1, min_frames=1)
    zero = {"gate_m", "overlap", "max_speed_mps", "max_gap_s", "long_m", "moving_m", "noise_m"}
    for name in sorted(zero | {"smooth_s"}):
        with pytest.raises(ConfigError, match="is out of range"):
            TrackConfig(**{name: 0.0})
    for name in ("max_gap_frames", "min_frames"):
        with pytest.raises(ConfigError, match="is out of range"):
            TrackConfig(**{name: 0})
    with pytest.raises(ConfigError, match="overlap is out of range"):
        TrackConfig(overlap=1.01)


def results(folder: Path, name: str, sim: SimConfig, far_m: float = 4.0, **run: object) -> Path:
    """Return results of a simulated log."""
    write_log(folder / f"{name}.mcap", sim)
    out = folder / name
    config = Config(ground=GroundConfig(max_depth_m=far_m))
    how = {"pictures": 0, "preset": "wheeled", **run}
    run_logs(folder / f"{name}.mcap", out, config, **how)
    return only_log(out)


SIM = SimConfig("moving", 12, 3, 8.0, 160, 120, camera_height_m=0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return results(tmp_path_factory.mktemp("tracks"), "log", SIM)


@pytest.mark.parametrize(
    ("odometry_hz", "source", "why"), [(0, "auto", "no poses"), (50, "none", "no floor")]
)
def test_the_reason_for_tracks_in_the_camera_frame_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture, odometry_hz: float, source: str, why: str
):
    sim = dataclasses.replace(SIM, odometry_hz=odometry_hz, frames=4)
    write_log(tmp_path / "log.mcap", sim)
    config = Config(ground=GroundConfig(source=source))
    run_logs(tmp_path / "log.mcap", tmp_path / "out", config, pictures=0)
    assert main(["track", str(tmp_path / "out")]) == 0
    assert f"in the camera's frame ({why});" in capsys.readouterr().out


def test_tables_of_tracks_agree_with_the_obstacles(folder: Path, capsys: pytest.CaptureFixture):
    obstacles = (folder / "obstacles.parquet").read_bytes()
    assert main(["track", str(folder)]) == 0
    assert "tracks" in capsys.readouterr().out
    assert (folder / "obstacles.parquet").read_bytes() == obstacles
    tracks, links = (
        pq.read_table(folder / "tracks.parquet"),
        pq.read_table(folder / "track_links.parquet"),
    )
    keys = ["log", "camera", "frame", "obstacle"]
    assert links.select(keys).equals(pq.read_table(folder / "obstacles.parquet", columns=keys))
    rows = tracks.to_pylist()
    assert len(rows) > 1 and [row["track"] for row in rows] == list(range(len(rows)))
    counts = links["track"].value_counts().to_pylist()
    counted = {c["values"]: c["counts"] for c in counts if c["values"] is not None}
    assert counted == {row["track"]: row["num_obstacles"] for row in rows}
    for row in rows:
        frames = row["last_frame"] - row["first_frame"] + 1
        assert len(row["path"]) == 2 * len(row["speed_mps"]) == 2 * (frames if row["moving"] else 1)
        assert row["num_frames"] <= frames and row["in_world"]
    assert all(f.metadata[b"description"] for f in tracks.schema)
    assert (folder / "tracks.png").exists() and not list(folder.glob(".jaxdet*"))


def test_repeated_runs_write_identical_bytes(folder: Path, tmp_path: Path):
    """Neither repetition nor the batch size of the run matters."""
    track_results(folder)
    other = results(tmp_path, "log", SIM, batch_size=5)
    track_results(other)
    for name in ("tracks.parquet", "track_links.parquet", "tracks.png"):
        before = (folder / name).read_bytes()
        assert (other / name).read_bytes() == before
        track_results(folder)
        assert (folder / name).read_bytes() == before


def split(log: Path, count: int, to: Path) -> None:
    """Split the messages of a log into ``count`` files, in the order of their times."""
    to.mkdir()
    with log.open("rb") as file:
        messages = list(make_reader(file).iter_messages())
    for k, part in enumerate(np.array_split(np.arange(len(messages)), count)):
        with (to / f"log_{k}.mcap").open("wb") as file:
            writer, channels = Writer(file), {}
            writer.start("ros2")
            for schema, channel, message in (messages[i] for i in part):
                if channel.id not in channels:
                    assert schema is not None
                    about = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(
                        channel.topic, channel.message_encoding, about, dict(channel.metadata)
                    )
                times = message.log_time, message.publish_time
                writer.add_message(channels[channel.id], times[0], message.data, times[1])
            writer.finish()


def test_tables_do_not_depend_on_the_split_of_the_log(folder: Path, tmp_path: Path):
    split(folder.parents[1] / "log.mcap", 5, tmp_path / "log")
    out = tmp_path / "out"
    config = Config(ground=GroundConfig(max_depth_m=4.0))
    (tmp_path / "log" / "metadata.yaml").write_text(
        "  relative_file_paths:\n" + "".join(f"  - log_{number}.mcap\n" for number in range(5))
    )
    [log] = find_logs([str(tmp_path / "log")])
    assert len(log.paths) == 5
    run_logs([log], out, config, pictures=0, preset="wheeled")
    out = only_log(out)
    track_results(out)
    track_results(folder)
    for name in ("tracks.parquet", "track_links.parquet"):
        assert (out / name).read_bytes() == (folder / name).read_bytes()


def test_other_settings_replace_the_tracks(folder: Path, tmp_path: Path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    (found,) = track_results(copy, TrackConfig(min_frames=1000))
    assert found.tracks == found.linked == 0 < found.obstacles and not found.blind
    assert pq.read_table(copy / "tracks.parquet").num_rows == 0
    links = pq.read_table(copy / "track_links.parquet")
    assert links["track"].null_count == links.num_rows > 0


def test_logs_without_obstacles_or_poses_are_tracked(tmp_path: Path):
    empty = results(tmp_path, "empty", dataclasses.replace(SIM, scene="empty", frames=2), 1.0)
    (found,) = track_results(empty)
    assert found.tracks == found.obstacles == 0
    assert pq.read_table(empty / "tracks.parquet").num_rows == 0
    blind = results(tmp_path, "blind", dataclasses.replace(SIM, frames=6, odometry_hz=0))
    (found,) = track_results(blind)
    assert found.tracks and not found.in_world and not (blind / "tracks.png").exists()


def edited(path: Path, column: str, values: list) -> None:
    """Replace the values of a column of a table."""
    table = pq.read_table(path)
    at = table.schema.get_field_index(column)
    new = pa.array(values, table.schema.field(at).type)
    table = table.set_column(at, table.schema.field(at), new)
    pq.write_table(table.replace_schema_metadata(pq.read_metadata(path).metadata), path)


def check_track(track: dict[str, Any], own: list[dict[str, Any]]) -> None:
    """Assert that a row of ``tracks.parquet`` agrees with its obstacles."""
    assert track["num_obstacles"] == len(own) and track["camera"] == own[0]["camera"]
    assert track["num_frames"] == len({row["frame"] for row in own})
    for name, row in (("first", own[0]), ("last", own[-1])):
        assert track[f"{name}_frame"] == row["frame"]
        assert track[f"{name}_stamp_ns"] == row["stamp_ns"]
    assert track["length_m"] >= track["width_m"] and track["top_m"] > 0
    assert track["mean_speed_mps"] == pytest.approx(np.mean(track["speed_mps"]), rel=1e-6)
    assert track["max_speed_mps"] == max(track["speed_mps"])


def test_each_log_is_reported_with_its_tracks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One log has no poses; those of the other are missing at its start and end."""
    for name, hz in (("a", 50.0), ("b", 0.0)):
        sim = dataclasses.replace(SIM, frames=12, odometry_hz=hz)
        write_log(tmp_path / f"{name}.mcap", sim)
    out = tmp_path / "out"
    run_logs(tmp_path, out, pictures=0)

    def table(name: str) -> list[dict]:
        return [row for log in "ab" for row in pq.read_table(out / log / name).to_pylist()]

    frames = pq.read_table(out / "a" / "frames.parquet").to_pylist()
    places = [r["camera_position_world"] if r["frame"] > 1 else None for r in frames]
    edited(out / "a" / "frames.parquet", "camera_position_world", places)
    rows = pq.read_table(out / "a" / "obstacles.parquet").to_pylist()
    corners = [row["corners_world"] if 4 < row["frame"] < 11 else None for row in rows]
    edited(out / "a" / "obstacles.parquet", "corners_world", corners)
    rows = table("obstacles.parquet")
    drawn = []
    plain = tracks_folder.draw_map

    def draw_map(image: np.ndarray, label: str, paths: list) -> np.ndarray:
        drawn.append((label, [(path.ravel().tolist(), moves) for path, moves in paths]))
        return plain(image, label, paths)

    monkeypatch.setattr(tracks_folder, "draw_map", draw_map)
    monkeypatch.setattr(tracks_rows, "PART_ROWS", 2)
    found = track_results(out, TrackConfig(min_frames=2, moving_m=0.02))
    all_tracks = table("tracks.parquet")
    links = [link["track"] for link in table("track_links.parquet")]
    assert [log.log for log in found] == ["a", "b"]
    for log in found:
        tracks = [track for track in all_tracks if track["log"] == log.log]
        of = [(r, t) for r, t in zip(rows, links, strict=True) if r["log"] == log.log]
        assert [track["track"] for track in tracks] == [*range(log.tracks)]
        assert log.moving == sum(track["moving"] for track in tracks)
        assert log.in_world == sum(track["in_world"] for track in tracks)
        assert log.obstacles == len(of) and log.linked == sum(t is not None for _, t in of)
        for track in tracks:
            own = [row for row, t in of if t == track["track"]]
            check_track(track, own)
            assert track["in_world"] == (log.log == "a" and own[0]["frame"] > 4)
    a, b = found
    assert a.linked < a.obstacles
    assert 0 < a.moving < a.tracks and 2 < a.in_world < a.tracks and not b.in_world
    assert (a.blind, b.blind) == (("the world's z is not up", "no poses"), ("no poses",))
    ways = [(t["path"], t["moving"]) for t in all_tracks if t["in_world"]]
    assert drawn == [("a", ways)] and not list(out.rglob("*.arrow"))


def test_observations_come_from_the_tables(folder: Path, tmp_path: Path, monkeypatch):
    """Each window begins after the previous one."""
    copy = shutil.copytree(folder, tmp_path / "copy")
    frames = pq.read_table(copy / "frames.parquet").to_pandas()
    rows = pq.read_table(copy / "obstacles.parquet").to_pandas()
    rolls = [3.1 if f % 3 else None for f in range(len(frames))]
    edited(copy / "frames.parquet", "camera_roll_rad", rolls)
    seen, sizes, plain = [], [], tracks_folder.observations_of

    class Spy(Tracker):
        def add(self, frames: np.ndarray, stamps: np.ndarray, obs: Observations, size: np.ndarray):
            sizes.append((frames.tolist(), stamps.tolist(), size.tolist()))
            super().add(frames, stamps, obs, size)

    def observations_of(*given: Any) -> Observations:
        seen.append(given)
        return plain(*given)

    monkeypatch.setattr(tracks_folder, "WINDOW_FRAMES", 5)
    monkeypatch.setattr(tracks_folder, "Tracker", Spy)
    monkeypatch.setattr(tracks_folder, "observations_of", observations_of)
    track_results(copy, TrackConfig(min_frames=7))  # tracks continue into the second window
    assert [len(part) for part, *_ in sizes] == [5, 5, 2]
    links = pq.read_table(copy / "track_links.parquet").to_pandas()
    assert links["frame"].tolist() == rows["frame"].tolist() and links["track"].notna().any()
    assert links["obstacle"].tolist() == rows["obstacle"].tolist()
    numbers, stamps, size = ([*chain(*parts)] for parts in zip(*sizes, strict=True))
    assert numbers == frames["frame"].tolist() and stamps == frames["stamp_ns"].tolist()
    assert size == rows["num_points"].tolist()
    frame, stamp, roll = (np.concatenate(parts) for parts in list(zip(*seen, strict=True))[:3])
    assert frame.tolist() == rows["frame"].tolist() and stamp.tolist() == rows["stamp_ns"].tolist()
    np.testing.assert_array_equal(roll, np.array(rolls, np.float32)[frame])
    assert {width for *_, width in seen} == {SIM.width}
    for name in ("corners_ground", "corners_world", "top_m", "u_max"):
        got = np.concatenate([columns[name] for *_, columns, _ in seen])
        np.testing.assert_array_equal(got, np.stack(rows[name].to_list()))


def test_metadata_of_tracks_names_their_settings_and_files(folder: Path, tmp_path: Path):
    """The manifest lists the files of the tracks."""
    copy, config = shutil.copytree(folder, tmp_path / "copy"), TrackConfig(min_frames=7, gate_m=0.2)
    track_results(copy, config)
    assert tracks_folder.tracking(copy) == config
    names = ("obstacles", "tracks", "track_links")
    about = [pq.read_metadata(copy / f"{name}.parquet").metadata for name in names]
    obstacles, *own = ({k: v for k, v in one.items() if k != b"ARROW:schema"} for one in about)
    assert all(one.items() > obstacles.items() for one in own)
    table, key = pq.read_table(copy / "tracks.parquet"), tracks_folder.TRACKING_KEY
    wrong = "{", "[1]", '{"speed": 1}', '{"gate_m": -1}', '{"gate_m": "1"}'
    for own in (None, {"jaxdet.format": "2"}, *({key: value} for value in wrong)):
        pq.write_table(table.replace_schema_metadata(own), copy / "tracks.parquet")
        with pytest.raises(InputError, match="the tracking parameters are missing or invalid"):
            tracks_folder.tracking(copy)
    (copy / "tracks.parquet").unlink()
    with pytest.raises(InputError, match="the tracking parameters are missing or invalid"):
        tracks_folder.tracking(copy)
    theirs = ["tracks.parquet", "track_links.parquet", "tracks.png", "tracks_a.png"]
    others = ["tracks_a.npz", "track_a.png", "map_a.png", "frames.parquet"]
    assert list(filter(tracks_folder.is_track_file, theirs + others)) == theirs


def test_damaged_folders_are_errors(folder: Path, tmp_path: Path):
    with pytest.raises(InputError, match="no such folder"):
        track_results(tmp_path / "none")
    copy = shutil.copytree(folder, tmp_path / "copy")
    track_results(copy)
    table = pq.read_table(copy / "obstacles.parquet")
    pq.write_table(pa.concat_tables([table, table]), copy / "obstacles.parquet")
    before = (copy / "tracks.parquet").read_bytes()
    with pytest.raises(InputError):
        track_results(copy)
    assert (copy / "tracks.parquet").read_bytes() == before and not list(copy.glob(".jaxdet*"))
