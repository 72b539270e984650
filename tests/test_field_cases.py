"""The cases of ``shared/cases/field``: obstacles equal those of the log they were made of."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from jaxdet.cli import main

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases" / "field"
COLUMNS = ("distance_m", "corners_ground", "corners_world", "camera_position_world")
Made = Callable[[str], Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Makes a case once; skips where it is absent or needs what is not installed."""
    folders: dict[str, Path] = {}

    def make(name: str) -> Path:
        scripts = [*CASES.glob(f"{name}-*/make.py")] if CASES.is_dir() else []
        if not scripts:
            pytest.skip("no shared cases next to the project")
        if name not in folders:
            folder = tmp_path_factory.mktemp(f"case{name}")
            command = [sys.executable, str(scripts[0]), str(folder)]
            subprocess.run(command, check=True, capture_output=True)
            folders[name] = folder
        return folders[name]

    return make


def run(log: Path, folder: Path, *flags: str) -> Path:
    results = folder / log.stem
    assert main(["run", str(log), "-o", str(results), "--pictures", "0", "-q", *flags]) == 0
    return results


def columns(results: Path, table: str, camera: str = "") -> dict[str, list]:
    found = pq.read_table(next(results.glob(f"*/{table}.parquet")))
    rows = [row for row in found.to_pylist() if not camera or row["camera"] == camera]
    return {name: [row[name] for row in rows] for name in COLUMNS if name in found.column_names}


@pytest.mark.parametrize(
    ("case", "file", "base", "flags"),
    [
        ("02", "no_optical_frame_in_tf.mcap", "base.mcap", ()),
        ("02", "optical_frame_in_tf_too.mcap", "base.mcap", ()),
        ("04", "colour_21_percent.mcap", "base.mcap", ()),
        ("05", "bayer.mcap", "base.mcap", ()),
        ("09", "bag_db3", "base.mcap", ()),
        ("09", "bag_mcap", "base.mcap", ()),
        ("11", "depth_body_frame.mcap", "raw.mcap", ()),
        ("14", "boot_1970.mcap", "base.mcap", ("--start", "0.2s")),
    ],
)
def test_a_case_is_as_the_log_it_was_made_of(made, tmp_path, case, file, base, flags):
    folder = made(case)
    found, expected = (run(folder / name, tmp_path, *flags) for name in (file, base))
    for table in ("obstacles", "frames"):
        assert columns(found, table) == columns(expected, table)


@pytest.mark.parametrize("log", ["two_equal_robots", "two_robots"])
def test_robots_of_one_log_are_as_alone(made, tmp_path, log):
    folder = made("01")
    found, expected = (run(folder / f"{name}.mcap", tmp_path) for name in (log, "robot1"))
    for table in ("obstacles", "frames"):
        assert columns(found, table, "robot1") == columns(expected, table)
    if log == "two_robots":
        other = run(folder / "robot2.mcap", tmp_path)
        ground = columns(found, "obstacles", "robot2")["corners_ground"]
        assert ground == columns(other, "obstacles")["corners_ground"]


@pytest.mark.parametrize("flags", [(), ("--log.no-depth-aligned",)])
def test_aligned_depth_of_half_the_size(made, tmp_path, flags):
    results = run(made("07") / "aligned_half.mcap", tmp_path, *flags)
    found = pq.read_table(next(results.glob("*/obstacles.parquet"))).to_pylist()
    assert len(found) == 108
    nearest: dict[int, float] = {}
    for row in found:
        nearest[row["frame"]] = min(row["distance_m"], nearest.get(row["frame"], 99.0))
    assert sorted(nearest.values())[len(nearest) // 2] == pytest.approx(1.263, abs=2e-3)


@pytest.mark.parametrize(
    ("case", "file", "text"),
    [
        ("03", "disparity.mcap", "holds disparity in pixels, not depth in metres"),
        ("12", "jpeg_depth.mcap", "recorded as JPEG (8 bits, lossy), its distances are lost"),
    ],
)
@pytest.mark.parametrize("command", ["info", "run"])
def test_what_is_no_depth_is_refused(made, tmp_path, capsys, case, file, text, command):
    output = ["-o", str(tmp_path / "out")] if command == "run" else []
    assert main([command, str(made(case) / file), *output]) == 1
    assert text in capsys.readouterr().err
