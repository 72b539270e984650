"""Obstacles compared with a known map and added to it."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet.cli import main
from jaxdet.export.html.trajectories import track_rows
from jaxdet.export.shapes import label
from jaxdet.results.map_file import FREE, OCCUPIED, UNKNOWN, Grid, read_map, write_map
from jaxdet.results.reading import Results
from jaxdet.results.rows import Lists
from jaxdet.tracks import TrackConfig, track_results
from jaxdet.verify import verify
from tests.export_results import by_hand
from tests.test_export_grid import map_server

LEFT, RIGHT = (-0.5, 1.5), (0.5, 1.5)
"""An object on the map and a new one: right and forward of a camera that looks along X [m]."""
FRAMES: list = [([LEFT, RIGHT], 1.4)] * 6
ANY = ["--min-frames", "1"]


def save_map(folder: Path, yaw: float = 0.0) -> Path:
    """Write a map of a room of 6 x 6 m, unknown beyond 4 m, with the left object and a cabinet."""
    grid = Grid(np.full((60, 60), FREE, np.int8), (-1.0, -3.0), 0.1, yaw)
    grid.states[:, 50:] = UNKNOWN
    for x, y in (1.45, -LEFT[0]), (0.55, 0.05):
        column, row = np.floor(grid.places(np.array([x, y]))).astype(int)
        grid.states[row - 1 : row + 2, column - 1 : column + 2] = OCCUPIED
    write_map(folder / "known.pgm", grid, "by hand", "map")
    return folder / "known.yaml"


def state_at(grid: Grid, x: float, y: float) -> int:
    column, row = np.floor(grid.places(np.array([x, y]))).astype(int)
    return int(grid.states[row, column])


@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_obstacles_and_tracks_record_whether_they_are_on_the_map(
    tmp_path: Path, yaw: float, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, known = by_hand(tmp_path / "r", FRAMES), save_map(tmp_path, yaw)
    assert main(["track", str(folder), "--map", str(known), "--map-frame", "map", *ANY]) == 0
    assert "2 tracks, 0 moving, 1 not in the map" in capsys.readouterr().out
    links = pq.read_table(folder / "track_links.parquet")["in_map"].to_pylist()
    assert links == [True, False] * 6
    assert pq.read_table(folder / "tracks.parquet")["in_map"].to_pylist() == [True, False]
    with Results(folder) as results:
        (log,) = results.logs
        shown = track_rows(results, log, 0)
        labels = [label(o) for o in next(results.frames(log)).obstacles]
    assert shown is not None and shown["new"] == 1
    assert [row[-1] for row in shown["rows"]] == [True, False]
    assert [text.endswith("   new") for text in labels] == [False, True]
    # The results contain a copy of the map, so they can be verified without the original.
    known.unlink()
    assert not [f for f in verify(folder, sample=0).findings if f.check == "tracks"]
    np.testing.assert_allclose(read_map(folder / "known_map.yaml").yaw, yaw)
    # Tracking without a map removes the comparison.
    track_results(folder, TrackConfig(min_frames=1))
    assert not list(folder.glob("known_map*"))
    assert pq.read_table(folder / "track_links.parquet")["in_map"].null_count == 12


def test_obstacles_without_a_contour_are_compared_by_their_front_edge(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "r", [([LEFT, RIGHT], 1.4, {"contour": Lists.nulls(2)})] * 6)
    track_results(folder, TrackConfig(min_frames=1), known=read_map(save_map(tmp_path)))
    links = pq.read_table(folder / "track_links.parquet")
    assert links["in_map"].to_pylist() == [True, False] * 6
    assert links["persistence"].null_count == 12


def test_unknown_cells_behind_an_occupied_line_belong_to_the_same_object(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "r", FRAMES)
    grid = Grid(np.full((120, 120), FREE, np.int8), (-1.0, -3.0), 0.05)
    column, row = np.floor(grid.places(np.array([1.5, -LEFT[0]]))).astype(int)
    grid.states[row - 8 : row + 9, column - 7] = OCCUPIED  # 35 cm in front of the left object
    for behind, expected in ((FREE, False), (UNKNOWN, True)):
        grid.states[row - 8 : row + 9, column - 6 : column + 12] = behind
        track_results(folder, TrackConfig(min_frames=1), known=grid)
        links = pq.read_table(folder / "track_links.parquet")["in_map"].to_pylist()
        assert links == [expected, False] * 6


def test_verify_finds_a_changed_copy_of_the_map(tmp_path: Path) -> None:
    folder, known = by_hand(tmp_path / "r", FRAMES), save_map(tmp_path)
    track_results(folder, TrackConfig(min_frames=1), known=read_map(known))
    grid = read_map(folder / "known_map.yaml")
    write_map(folder / "known_map.png", grid._replace(states=0 * grid.states), "a", "map")
    found = verify(folder, sample=0).findings
    assert any("known_map" in finding.where for finding in found)


@pytest.mark.parametrize("yaw", [0.0, 0.3])
@pytest.mark.parametrize("tracked", [False, True])
def test_new_obstacles_are_added_to_the_map(tmp_path: Path, yaw: float, tracked: bool) -> None:
    folder, known = by_hand(tmp_path / "r", FRAMES), save_map(tmp_path, yaw)
    if tracked:
        track_results(folder, TrackConfig(min_frames=1))
    command = ["export", str(folder), "--to", "nav2", "--map", str(known), "--output"]
    assert main([*command, str(tmp_path / "added")]) == 0
    assert main([*command, str(tmp_path / "cleared"), "--clear"]) == 0
    before = read_map(known)
    added, cleared = (read_map(tmp_path / name / "hand.yaml") for name in ("added", "cleared"))
    if yaw == 0:
        np.testing.assert_array_equal(map_server(tmp_path / "added/hand.yaml")[0], added.states)
    assert state_at(before, 1.5, -0.5) == FREE
    assert state_at(added, 1.5, -0.5) == state_at(cleared, 1.5, -0.5) == OCCUPIED
    # The content of the map is kept, except for the cabinet, where floor was visible.
    assert state_at(added, 0.55, 0.05) == OCCUPIED and state_at(cleared, 0.55, 0.05) == FREE
    assert state_at(cleared, 1.45, 0.5) == state_at(added, 1.45, 0.5) == OCCUPIED
    assert (added.states == before.states).mean() > 0.97
    np.testing.assert_array_equal(cleared.states == UNKNOWN, before.states == UNKNOWN)
    assert (added.yaw, added.cell_m, added.origin) == (before.yaw, before.cell_m, before.origin)


def test_a_map_grows_to_contain_obstacles_outside_of_it(tmp_path: Path) -> None:
    folder = by_hand(tmp_path / "r", FRAMES)
    grid = Grid(np.full((10, 10), FREE, np.int8), (0.0, 0.0), 0.02, 0.5)
    write_map(tmp_path / "small.pgm", grid, "by hand", "map")
    command = ["export", str(folder), "--to", "nav2", "--map", str(tmp_path / "small.yaml")]
    assert main([*command, "--output", str(tmp_path / "out")]) == 0
    grown = read_map(tmp_path / "out/hand.yaml")
    assert state_at(grown, 1.5, 0.5) == state_at(grown, 1.5, -0.5) == OCCUPIED
    for x, y in np.random.default_rng(0).uniform(0.01, 0.19, (20, 2)).tolist():
        place = grid.world(np.array([x, y]) / 0.02)
        assert state_at(grown, *place.tolist()) == FREE


def test_conflicting_flags_are_clear_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, known = str(by_hand(tmp_path / "r", FRAMES)), str(save_map(tmp_path))
    far = Grid(np.full((4, 4), FREE, np.int8), (1e6, 0.0), 0.05)
    write_map(tmp_path / "far.pgm", far, "by hand", "map")
    out = ["--output", str(tmp_path / "out")]
    nav2 = ["export", folder, "--to", "nav2", *out]
    cases = {
        "the poses are in map, but the map is in site": ["track", folder, "--map", known],
        "pass it as --map FILE": ["track", folder],
        "poses are in map, but the map is in site; run": [*nav2, "--map", known],
        "--clear and --map-frame need a map": nav2,
    }
    for text, command in cases.items():
        assert main([*command, "--map-frame", "site"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert text in line
    assert main(["export", folder, "--to", "html", "--map", known, *out]) == 2
    assert "--to html does not use --map; use --to nav2" in capsys.readouterr().err
    assert main([*nav2, "--map", str(tmp_path / "far.yaml")]) == 1
    assert "--map: obstacles are too far from the map" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
