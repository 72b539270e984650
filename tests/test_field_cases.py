"""Failing inputs of ``shared/cases/field``: obstacles equal those of the original log."""

import runpy
import sys
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from shutil import copy
from typing import Any

import pyarrow.parquet as pq
import pytest

from jaxdet.cli import main

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases" / "field"
COLUMNS = ("distance_m", "corners_ground", "corners_world", "camera_position_world")
Made = Callable[[str], Path]
Run = Callable[..., Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Return a function that makes the logs of a case once; skip if the cases are absent."""
    if not CASES.is_dir():
        pytest.skip("no shared cases next to the project")
    sys.path.insert(0, str(CASES / "_lib"))
    import fl

    @cache
    def simulated(*flags: str) -> Path:
        path = tmp_path_factory.mktemp("simulated") / "log.mcap"
        size = ["--width", str(fl.WIDTH), "--height", str(fl.HEIGHT)]
        assert main(["sim", str(path), "--quiet", *size, *flags]) == 0
        return path

    def simulate(path: Path, *flags: str) -> Any:
        copy(simulated(*flags), path)
        return fl.read(path)

    @cache
    def make(name: str) -> Path:
        (script,) = CASES.glob(f"{name}-*/make.py")
        folder = tmp_path_factory.mktemp(f"case{name}")
        runpy.run_path(str(script))["main"](folder)
        return folder

    fl.simulate = simulate  # simulates in this process, once per log
    return make


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a function that returns the results of a log, and runs each log only once."""

    known: dict[tuple, Path] = {}

    def run(log: Path, *flags: str) -> Path:
        files = [log] if log.is_file() else sorted(log.iterdir())
        key = (sha256(b"".join(path.read_bytes() for path in files)).digest(), *flags)
        if key not in known:
            known[key] = tmp_path_factory.mktemp("results") / log.stem
            how = ["-o", str(known[key]), "--pictures", "0", "-q", *flags]
            assert main(["run", str(log), *how]) == 0
        return known[key]

    return run


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
def test_obstacles_equal_those_of_the_original_log(made, run, case, file, base, flags):
    folder = made(case)
    found, expected = (run(folder / name, *flags) for name in (file, base))
    for table in ("obstacles", "frames"):
        assert columns(found, table) == columns(expected, table)


@pytest.mark.parametrize("log", ["two_equal_robots", "two_robots"])
def test_two_robots_in_a_log_give_the_results_of_separate_logs(made, run, log):
    folder = made("01")
    found, expected = (run(folder / f"{name}.mcap") for name in (log, "robot1"))
    for table in ("obstacles", "frames"):
        assert columns(found, table, "robot1") == columns(expected, table)
    if log == "two_robots":
        other = run(folder / "robot2.mcap")
        ground = columns(found, "obstacles", "robot2")["corners_ground"]
        assert ground == columns(other, "obstacles")["corners_ground"]


@pytest.mark.parametrize("flags", [(), ("--log.no-depth-aligned",)])
def test_aligned_depth_of_half_the_size_is_used(made, run, flags):
    results = run(made("07") / "aligned_half.mcap", *flags)
    found = pq.read_table(next(results.glob("*/obstacles.parquet"))).to_pylist()
    assert len(found) == 108
    nearest: dict[int, float] = {}
    for row in found:
        nearest[row["frame"]] = min(row["distance_m"], nearest.get(row["frame"], 99.0))
    assert sorted(nearest.values())[len(nearest) // 2] == pytest.approx(1.263, abs=2e-3)


@pytest.mark.parametrize(
    ("case", "file", "text"),
    [
        ("03", "disparity.mcap", "the topic has disparity in pixels, not depth in metres"),
        ("12", "jpeg_depth.mcap", "recorded as JPEG (8 bits, lossy), so its distances are lost"),
    ],
)
@pytest.mark.parametrize("command", ["info", "run"])
def test_images_that_are_not_depth_are_refused(made, tmp_path, capsys, case, file, text, command):
    output = ["-o", str(tmp_path / "out")] if command == "run" else []
    assert main([command, str(made(case) / file), *output]) == 1
    assert text in capsys.readouterr().err
