"""nav2 export: the map at the end of a log, read by the rules of nav2's map_server."""

from pathlib import Path

import numpy as np
import pytest

from jaxdet.cli import main
from jaxdet.errors import InputError
from jaxdet.export import export
from jaxdet.export.grid import last_grid
from jaxdet.results.free_floor import RAY_RAD
from jaxdet.results.map_file import FREE, OCCUPIED, UNKNOWN
from jaxdet.results.reading import Results
from tests.export_results import by_hand


def map_server(path: Path) -> tuple[np.ndarray, float, list[float]]:
    """Return states, resolution and origin of a map, by the trinary mode of nav2_map_server."""
    lines = path.read_text().splitlines()
    about = dict(line.split(": ", 1) for line in lines if not line.startswith("#"))
    assert about["mode"] == "trinary" and about["negate"] == "0"
    magic, size, depth, data = (path.parent / about["image"]).read_bytes().split(b"\n", 3)
    assert (magic, depth) == (b"P5", b"255")
    columns, rows = map(int, size.split())
    occupied = (255 - np.frombuffer(data, np.uint8).reshape(rows, columns)) / 255.0
    states = np.full((rows, columns), UNKNOWN, np.int8)
    states[occupied < float(about["free_thresh"])] = FREE
    states[occupied > float(about["occupied_thresh"])] = OCCUPIED
    origin = [float(part) for part in about["origin"].strip("[]").split(",")]
    return states[::-1], float(about["resolution"]), origin


def state_at(folder: Path, frames: list, x: float, y: float) -> int:
    """Return the state of a position in the world after these frames."""
    with Results(by_hand(folder, frames)) as results:
        grid = last_grid(results, results.logs[0])
    assert grid is not None
    column, row = np.floor((np.array([x, y]) - grid.origin) / grid.cell_m).astype(int)
    return int(grid.states[row, column])


AHEAD = [(0.0, 1.5)]


@pytest.mark.parametrize(
    ("frames", "state"),
    [
        ([(AHEAD, 1.4)] * 2, OCCUPIED),
        ([(AHEAD, 1.4)] * 20 + [([], 2.0)] * 8, OCCUPIED),
        ([(AHEAD, 1.4)] * 20 + [([], 2.0)] * 9, FREE),
        ([(AHEAD, 1.4)] * 1 + [([], 2.0)] * 3, FREE),
        ([([], 2.0)] * 50 + [(AHEAD, 1.4)] * 2, FREE),
        ([([], 2.0)] * 50 + [(AHEAD, 1.4)] * 3, OCCUPIED),
        ([(AHEAD, 1.4)] * 20 + [([], 1.2)] * 50, OCCUPIED),
        ([([], 1.2)] * 5, UNKNOWN),
        ([(AHEAD, 2.0)] * 3, OCCUPIED),
        ([([(0.0, 1e9)], 2.0)] * 3, FREE),  # an outline too far for any map
    ],
)
def test_the_latest_observation_decides_whether_a_cell_is_free(
    tmp_path: Path, frames: list, state: int
) -> None:
    assert state_at(tmp_path / "r", frames, 1.5, 0.0) == state


def test_free_floor_is_not_interpolated_over_unknown_rays(tmp_path: Path) -> None:
    frames = [([], 1.5)]
    assert state_at(tmp_path / "a", frames, 1.0, 0.0) == FREE
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxdet.export.shapes.RAY_RAD", RAY_RAD / 2)
        assert state_at(tmp_path / "b", frames, 1.0, 0.0) == UNKNOWN


def test_nav2_loads_the_map_of_a_log(
    driven_results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = driven_results
    out = tmp_path / "maps"
    assert main(["export", str(results), "--to", "nav2", "--output", str(out)]) == 0
    states, cell, origin = map_server(out / "sim.yaml")
    assert "in the frame odom." in (out / "sim.yaml").read_text()
    with Results(results) as read:
        log = read.logs[0]
        grid, counted = last_grid(read, log), read.map(log)
        frames = list(read.frames(log))
    assert grid is not None and counted is not None
    np.testing.assert_array_equal(states, grid.states)
    assert cell == 0.05 and origin[:2] == pytest.approx(grid.origin, abs=1e-9)
    # Counted cells are not unknown, except for rounding at the edges of the free floor.
    counts = (counted.counts > 0) | (counted.free > 0)
    assert ((states != UNKNOWN) != counts).sum() <= 0.01 * counts.sum()
    assert {FREE, OCCUPIED, UNKNOWN} == set(np.unique(states).tolist())
    # The obstacles of the last frame are on the map, and the path of the robot is free.
    for obstacle in frames[-1].obstacles:
        middle = np.reshape(obstacle["corners_world"], (4, 2)).mean(axis=0)
        column, row = np.floor((middle - origin[:2]) / cell).astype(int)
        assert states[row, column] == OCCUPIED
    assert main(["export", str(results), "--to", "nav2", "--output", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_logs_without_poses_have_no_map(aims_results: Path, tmp_path: Path) -> None:
    with Results(aims_results) as results, pytest.raises(InputError, match="no log has a map"):
        export(results, "nav2", tmp_path / "maps", {})
    assert list(tmp_path.iterdir()) == []
