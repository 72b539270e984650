"""Persistence: of the frames that measure a position, the fraction in which it is occupied."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet.export.grid import last_grid
from jaxdet.results.map_file import FREE, OCCUPIED
from jaxdet.results.reading import Results
from jaxdet.results.rows import Lists
from jaxdet.tracks import TrackConfig, places, track_results
from jaxdet.tracks.folder import lasting_map
from jaxdet.verify import verify
from tests.export_results import by_hand

ANY = TrackConfig(min_frames=1)
AHEAD = [(0.0, 1.5)]
FOUND, FLOOR, SHORT = (AHEAD, 1.4), ([], 2.0), ([], 1.0)
BEFORE_IT = ([(0.0, 0.8)], 0.7)
NO_POSE = {"camera_position_world": np.full((1, 3), np.nan)}
NO_FLOOR = {"floor_source": np.array(["none"], object)}


def rows_of(folder: Path, name: str) -> list[dict[str, Any]]:
    return pq.read_table(folder / f"{name}.parquet").to_pylist()


def shares_of(folder: Path, frames: list, ends: int = 0) -> list[tuple]:
    """Return persistence and fraction of floor of each obstacle, rounded."""
    track_results(by_hand(folder, frames, ends), ANY)
    links = rows_of(folder, "track_links")
    values = [(link["persistence"], link["floor_seen"]) for link in links]
    return [tuple(v if v is None else round(v, 3) for v in pair) for pair in values]


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ([FOUND] * 4, (1.0, 0.0)),
        ([FOUND] * 4 + [FLOOR] * 4, (0.5, 0.5)),
        ([FOUND] + [FLOOR] * 9, (0.1, 0.9)),
        ([FOUND] + [SHORT] * 9, (1.0, 0.0)),  # position not measured
        ([FOUND] + [FLOOR] + [BEFORE_IT] * 8, (0.5, 0.5)),  # hidden by a nearer object
        ([FLOOR] * 9 + [FOUND] * 3, (1.0, 0.0)),  # placed there later
        ([FLOOR] * 9 + [FOUND] * 3 + [FLOOR], (0.75, 0.25)),
        ([FOUND] + [(*FLOOR, NO_POSE), (*FLOOR, NO_FLOOR)] * 4, (1.0, 0.0)),
    ],
)
def test_persistence_is_a_fraction_of_the_frames_that_measure_the_position(
    tmp_path: Path, frames: list, expected: tuple[float, float]
) -> None:
    shares = shares_of(tmp_path / "r", frames)
    places_ahead = [link for frame in frames for link in frame[0]]
    assert [s for s, place in zip(shares, places_ahead, strict=True) if place == AHEAD[0]] == (
        [expected] * sum(frame[0] == AHEAD for frame in frames)
    )


def test_an_object_too_small_for_an_obstacle_counts_neither_as_found_nor_as_floor(
    tmp_path: Path,
) -> None:
    assert shares_of(tmp_path / "r", [FOUND, ([], 1.4)], ends=1) == [(0.5, 0.0)]
    assert shares_of(tmp_path / "s", [FOUND, ([], 1.2)], ends=1) == [(1.0, 0.0)]  # hides it


def test_noise_of_a_far_contour_is_not_floor(tmp_path: Path) -> None:
    """A contour that is 18 cm farther away counts as the same at 3.9 m, but not at 1 m."""
    for away, near in ((3.9, True), (1.0, False)):
        frames = [([(0.0, away + 0.1)], away), ([(0.0, away + 0.28)], away + 0.18)] * 2
        first = shares_of(tmp_path / f"{away:g}", frames)[0]
        assert first == ((1.0, 0.0) if near else (0.5, 0.5))


def test_persistence_is_null_without_poses(tmp_path: Path) -> None:
    for name, other in (("pose", NO_POSE), ("floor", NO_FLOOR)):
        assert shares_of(tmp_path / name, [(*FOUND, other)] * 3) == [(None, None)] * 3


def test_moving_objects_count_at_their_own_positions(tmp_path: Path) -> None:
    """A crossing object is found in all frames but one, which shows floor in its place."""
    ways = [[(x, 1.5)] for x in np.linspace(-0.5, 0.5, 12).tolist()]
    frames: list = [(way, 1.4) for way in ways]
    frames[5] = ([], 2.0)
    folder = by_hand(tmp_path / "r", frames + [FLOOR] * 30)
    track_results(folder, TrackConfig(max_gap_frames=1))
    (track,) = rows_of(folder, "tracks")
    assert track["moving"] and track["num_frames"] == 11
    assert track["persistence"] == pytest.approx(11 / 12)
    assert track["floor_seen"] == pytest.approx(1 / 12)
    assert max(link["persistence"] for link in rows_of(folder, "track_links")) < 0.3


def test_a_standing_track_has_the_persistence_of_all_its_obstacles(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "r", [FOUND] * 6 + [FLOOR] * 2)
    track_results(folder, ANY)
    (track,) = rows_of(folder, "tracks")
    assert (track["persistence"], track["floor_seen"]) == (0.75, 0.25)
    assert track["in_map"] is None


def state_at_its_place(folder: Path) -> int:
    with Results(folder) as results:
        grid = last_grid(results, results.logs[0])
    assert grid is not None
    column, row = np.floor(grid.places(np.array([1.5, 0.0]))).astype(int)
    return int(grid.states[row, column])


def test_obstacles_through_which_floor_was_visible_are_not_on_maps(tmp_path: Path) -> None:
    """A phantom appears now and then, and in the last frame."""
    folder = by_hand(tmp_path / "r", [FOUND] + [FLOOR] * 9 + [FOUND] * 3)

    def at_its_place() -> tuple[int, int]:
        with Results(folder) as results:
            image = lasting_map(results, results.logs[0])
        assert image is not None
        column, row = np.floor((np.array([1.5, 0.0]) - image.origin) / image.cell_m).astype(int)
        return state_at_its_place(folder), int(image.counts[row, column] > 0)

    assert at_its_place() == (OCCUPIED, 1)
    track_results(folder, ANY)
    assert at_its_place() == (FREE, 0)
    track_results(folder, TrackConfig(min_frames=1, most_floor=0.8))
    assert at_its_place() == (OCCUPIED, 1)


def test_corners_of_rectangles_without_a_contour_are_not_on_maps(tmp_path: Path) -> None:
    """The contour is far from the rectangle, as for a bent contour, whose rectangle has a corner
    where nothing was measured.
    """
    aside = np.array([-0.6, 1.4, -0.5, 1.4, -0.4, 1.4], np.float32)
    bent = {"contour": Lists.of_lengths(aside, np.array([6]), np.array([False]))}
    for name, frame, expected in (("bent", (*FOUND, bent), FREE), ("plain", FOUND, OCCUPIED)):
        folder = by_hand(tmp_path / name, [FLOOR, frame, frame])
        assert state_at_its_place(folder) == OCCUPIED
        track_results(folder, ANY)
        assert state_at_its_place(folder) == expected


def test_neither_chunks_nor_repetition_change_the_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = by_hand(tmp_path / "r", [FOUND, FLOOR, BEFORE_IT, FOUND, SHORT, FLOOR] * 4)
    track_results(folder, ANY)
    names = "tracks.parquet", "track_links.parquet", "tracks.png"
    before = {name: (folder / name).read_bytes() for name in names}
    for frames in (1, 5):
        monkeypatch.setattr(places, "CHUNK_FRAMES", frames)
        track_results(folder, ANY)
        assert {name: (folder / name).read_bytes() for name in names} == before
    assert not [f for f in verify(folder, sample=0).findings if f.check == "tracks"]
