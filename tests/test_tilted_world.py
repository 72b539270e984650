"""Poses in a world whose z axis is not vertical, such as that of some SLAM systems."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from jaxdet.errors import InputError
from jaxdet.export import export
from jaxdet.floor.plane import down_vector
from jaxdet.results.metric import tilted
from jaxdet.results.reading import Results
from jaxdet.tracks import track_results
from jaxdet.verify import verify
from tests.export_results import run, sim_log
from tests.rewritten import move_world
from tests.test_export_rerun import recording_of

FRAMES = 6


@pytest.fixture
def turned(tmp_path: Path) -> Callable[[float], Path]:
    """Return a function that runs a drive in a world rotated about its x axis."""

    def made(degrees: float) -> Path:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
        log = move_world(sim_log(tmp_path / "log.mcap", frames=FRAMES), T)
        return run(log, tmp_path / "out")

    return made


def test_a_world_tilted_like_a_ramp_has_positions(turned: Callable[[float], Path]) -> None:
    folder = turned(20)
    corners = pq.read_table(folder / "obstacles.parquet")["corners_world"]
    assert len(corners) and not corners.null_count
    (log,) = json.loads((folder / "summary.json").read_text())["logs"]
    assert log["map"] and not log["tilted_frames"] and not log["warnings"]


@pytest.mark.parametrize("degrees", [40, 180])
def test_a_world_without_vertical_z_has_no_positions(
    turned: Callable[[float], Path], tmp_path: Path, degrees: float
) -> None:
    folder = turned(degrees)
    frames = pq.read_table(folder / "frames.parquet")
    corners = pq.read_table(folder / "obstacles.parquet")["corners_world"]
    assert len(corners) and corners.null_count == len(corners)
    assert not frames["camera_position_world"].null_count and not frames["free_to_m"].null_count
    (log,) = json.loads((folder / "summary.json").read_text())["logs"]
    assert log["map"] is None and log["tilted_frames"] == FRAMES
    (warning,) = (text for text in log["warnings"] if not text.startswith("no map"))
    assert warning.startswith(f"{FRAMES} of {FRAMES} frames have no place in the world")
    assert "more than 30°" in warning and "z points up" in warning
    (found,) = track_results(folder)
    assert found.tracks and not found.in_world and found.blind == ("the world's z is not up",)
    report = verify(folder, sample=2)
    assert report.findings == report.notes == [] and report.frames_again == 2
    with Results(folder) as results, pytest.raises(InputError, match="no log has a map"):
        export(results, "nav2", tmp_path / "nav2", {})
    assert "translation" not in recording_of(folder, tmp_path / "rerun")["/world/floor"]


def test_the_tilt_of_the_world_does_not_depend_on_the_mount() -> None:
    """The normal of the floor in the world decides, not the orientation of the camera."""
    pitch, roll = np.radians([[0, 40, -10, 70, 40], [0, 0, 25, -20, 180]])
    lean = np.radians([0, 29, -29, 31, -31])
    down = down_vector(pitch, roll)
    turns = []
    for axis, angle in zip(down, lean, strict=True):
        level = Rotation.align_vectors([[0, 0, -1]], [axis])[0]
        turns.append((Rotation.from_euler("x", angle) * level).as_quat())
    assert tilted(np.array(turns), pitch, roll).tolist() == [False] * 3 + [True] * 2
    turns[3][:] = np.nan
    pitch[4] = np.nan
    assert not tilted(np.array(turns), pitch, roll).any()
