"""Runs of parts of a log, and of logs with several cameras."""

import json
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxdet import engine
from jaxdet.cli import info, progress
from jaxdet.cli.main import main
from jaxdet.export.shapes import topic
from jaxdet.io import LogOptions, find_logs, open_log
from jaxdet.results.reading import Results
from jaxdet.results.summary import Summary
from jaxdet.sim import SimConfig, write_log
from tests.camera_logs import join_cameras
from tests.runs import run_log

TABLES = ("frames.parquet", "obstacles.parquet")
SIM = SimConfig(frames=12, width=160, height=120, rate_hz=5)


@pytest.fixture(scope="module")
def sim_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sim") / "sim.mcap"
    write_log(path, SIM)
    return path


@pytest.fixture(scope="module")
def two_cameras(sim_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log with the cameras rear and front; front has another scene and fewer frames."""
    folder = tmp_path_factory.mktemp("two")
    write_log(folder / "other.mcap", replace(SIM, frames=9, seed=5))
    return join_cameras({"rear": sim_log, "front": folder / "other.mcap"}, folder / "two.mcap")


def run(log: Path, output: Path, options: LogOptions | None = None, **run: Any) -> Summary:
    how = {"pictures": 0, **run}
    return run_log(log, output / "log", log=options, **how)


def tables(folder: Path) -> list[pa.Table]:
    return [pq.read_table(folder / "log" / name) for name in TABLES]


def rows_of(table: pa.Table, column: str, values: Collection) -> pa.Table:
    return table.filter(pa.array([value in values for value in table[column].to_pylist()]))


@pytest.fixture(scope="module")
def both(two_cameras: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of both cameras, with a picture of each."""
    folder = tmp_path_factory.mktemp("both")
    summary = run(two_cameras, folder, pictures=1)
    assert [(log.log, log.camera) for log in summary.logs] == [("two", "front"), ("two", "rear")]
    return folder / "log"


@pytest.fixture(scope="module")
def whole(sim_log: Path, tmp_path_factory: pytest.TempPathFactory) -> list[pa.Table]:
    folder = tmp_path_factory.mktemp("whole")
    run(sim_log, folder)
    return tables(folder)


@pytest.mark.parametrize(
    "part, numbers",
    [
        ({"start": "0.9", "stop": "2.0"}, range(5, 10)),
        ({"every": 5}, range(0, 12, 5)),
        ({"start": "1.0", "every": 2}, range(6, 12, 2)),
    ],
)
def test_rows_of_a_part_equal_those_of_the_complete_log(sim_log, whole, tmp_path, part, numbers):
    summary = run(sim_log, tmp_path, LogOptions(**part), batch_size=2, pictures=2)
    assert summary.frames == len(numbers)
    for found, all_rows in zip(tables(tmp_path), whole, strict=True):
        assert found.equals(rows_of(all_rows, "frame", numbers))
        assert found.num_rows >= len(numbers)
    ends = {f"{number:06d}.png" for number in (numbers[0], numbers[-1])}
    assert {path.name for path in (tmp_path / "log" / "pictures").iterdir()} == ends
    written = json.loads((tmp_path / "log" / "config.json").read_text(encoding="utf-8"))
    assert {name: written["log"][name] for name in part} == part


def test_a_part_run_by_several_workers_has_the_rows_of_the_complete_log(sim_log, whole, tmp_path):
    summary = run(sim_log, tmp_path, LogOptions(start="0.1", every=2), batch_size=1, workers=2)
    assert summary.workers == 2 and summary.frames == 5
    for found, all_rows in zip(tables(tmp_path), whole, strict=True):
        assert found.equals(rows_of(all_rows, "frame", range(2, 12, 2)))


def test_an_unusable_camera_is_reported(sim_log, tmp_path, capsys):
    """Frames of that camera have no rows."""
    path = join_cameras(
        dict.fromkeys(("front", "rear", "side"), sim_log),
        tmp_path / "log.mcap",
        without=lambda topic: topic.startswith("/side") and topic.endswith("camera_info"),
    )
    command = ["run", str(path), "--pictures", "0", "--quiet"]
    assert main([*command, "--output", str(tmp_path / "out")]) == 1
    printed = (
        "jaxdet: error: log: left out: camera side, see the warning; --camera takes others alone"
    )
    assert capsys.readouterr().err == f"{printed}\n"
    summary = json.loads((tmp_path / "out" / "log" / "summary.json").read_text("utf-8"))
    assert [log["cameras_left_out"] for log in summary["logs"]] == [["side"], ["side"]]
    assert main([*command, "--output", str(tmp_path / "one"), "--camera", "front"]) == 0


def test_all_cameras_of_a_log_are_run(both, two_cameras, whole, tmp_path):
    for camera in ("front", "rear"):
        run(two_cameras, tmp_path / camera, LogOptions(camera=camera))
    for number, name in enumerate(TABLES):
        found = pq.read_table(both / name)
        assert found.schema.names[:3] == ["log", "camera", "frame"]
        cameras = found["camera"].to_pylist()
        assert cameras == sorted(cameras) and set(cameras) == {"front", "rear"}
        for camera in ("front", "rear"):
            alone = pq.read_table(tmp_path / camera / "log" / name)
            assert rows_of(found, "camera", (camera,)).equals(alone)
        drop = ["log", "camera"]
        assert alone.drop(drop).equals(whole[number].drop(drop))
    assert {path.name for path in (both / "pictures").iterdir()} == {
        "front_000000.png",
        "rear_000000.png",
    }
    assert {path.name for path in both.glob("map_*.npz")} == {
        "map_front.npz",
        "map_rear.npz",
    }


def test_results_of_several_cameras_are_read_back(both, two_cameras):
    with Results(both) as results:
        assert [log.label for log in results.logs] == ["two, front", "two, rear"]
        assert [log.file_name for log in results.logs] == ["two@front", "two@rear"]
        log = results.log("two, rear")
        assert [path.stem for path in results.pictures(log).values()] == ["rear_000000"]
        assert results.map(log) is not None
        rows = [frame.row for frame in results.frames(log)]
        assert [(row["camera"], row["frame"]) for row in rows] == [("rear", n) for n in range(12)]
        with open_log(find_logs([str(two_cameras)])[0], results.options_of(log)) as opened:
            assert opened.camera == "rear"
            assert opened.stamps_ns.tolist() == [row["stamp_ns"] for row in rows]


def test_results_of_one_of_several_cameras_name_it(two_cameras, tmp_path):
    """Topics and file names contain the camera, so exports of several cameras can be combined."""
    run(two_cameras, tmp_path, LogOptions(camera="rear"))
    with Results(tmp_path / "log") as results:
        (log,) = results.logs
        assert (log.label, log.file_name) == ("two, rear", "two@rear")
        assert results.log("two") == results.log("two, rear") == log
        assert topic(log, "obstacles") == "/jaxdet/rear/obstacles"


def test_info_and_progress_name_the_cameras(two_cameras, sim_log, tmp_path, capsys):
    assert info.main([str(two_cameras)]) == 0
    lines = capsys.readouterr().out.splitlines()
    heads = [line for line in lines if line.startswith("two, ")]
    assert [head.split(":")[0] for head in heads] == ["two, front", "two, rear"]
    front = [line for line in lines if line.startswith("  front: /front/camera/")]
    assert any("/front/camera/color/image_raw" in line for line in front)
    assert info.main([str(two_cameras), "--camera", "rear", "--json", "--every", "5"]) == 0
    about = json.loads(capsys.readouterr().out)["logs"]
    assert [log["camera"] for log in about] == ["rear"]
    assert about[0]["description"]["part"].startswith("3 of 12 frames, 0 to 10, multiples of 5, ")
    given = ["--output", str(tmp_path / "out"), "--pictures", "0"]
    assert main(["run", str(two_cameras), *given, "--stop", "0.5"]) == 0
    printed = capsys.readouterr()
    assert "two, front\n  frames     3" in printed.out and "two, rear\n" in printed.out
    assert "two, front: 3/3 frames" in printed.err
    given[1] = str(tmp_path / "none")
    assert main(["run", str(sim_log), *given, "--start", "100"]) == 1
    assert (
        "no depth image matches --start 100; the log has 12 depth images" in capsys.readouterr().err
    )


def test_info_continues_after_a_failed_camera(two_cameras, capsys):
    """The camera front has no frame in this range."""
    assert info.main([str(two_cameras), "--json", "--start", "1.9"]) == 1
    printed = capsys.readouterr()
    front, rear = json.loads(printed.out)["logs"]
    assert front["camera"] == "front" and "no depth image matches" in front["error"]
    assert rear["camera"] == "rear" and rear["frames"] == 12
    assert printed.err.count("\n") == 1


@pytest.mark.parametrize("logs", [1, 3])
def test_progress_is_one_bar_of_frames_or_of_logs(monkeypatch, logs):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    seen = []
    with progress.reporting(False) as show:
        assert show is not None
        for label, total, done, ended in (
            ("two", 0, 0, 0),
            ("two, front", 9, 9, 0),
            ("two, rear", 12, 5, 1),
        ):
            doing = "" if done else "opening"
            given = label, 0, logs, done, total, 0, None, "", {}, doing, ended, 0
            show(engine.Progress(*given))
            cells = [cell.cell_contents for cell in show.__closure__ or ()]  # include the bars
            tasks = next(cell.tasks for cell in cells if hasattr(cell, "tasks"))
            seen = [(task.description, task.completed, task.total) for task in tasks]
    assert seen == ([("two, rear", 5, 12)] if logs == 1 else [("logs", 1, 3)])
