"""Tables of results: schema, nulls, reproducible bytes, errors."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet.errors import OutputError
from jaxdet.results import writer
from jaxdet.results.json_files import write_json
from jaxdet.results.rows import Lists
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.summary import problems
from jaxdet.results.tables import Tables
from jaxdet.results.writer import TableWriter
from tests.conftest import ROOT


def frame_rows(start: int, stop: int) -> dict:
    n = np.arange(start, stop)
    count = n.astype(np.int32)
    return {
        **{name: np.full(n.size, "a", object) for name in ("log", "camera")},
        "frame": n,
        "stamp_ns": n * 10,
        "color_stamp_ns": np.ma.masked_equal(np.where(n % 2, n * 10, -1), -1),
        "log_time_ns": np.ma.masked_equal(n * 10 + 3, 13),
        "status": np.where(n % 2, "ok", "no_color").astype(object),
        "num_obstacles": count,
        "overflow": n % 3 == 0,
        "camera_height_m": np.where(n % 5, 0.6, np.nan),
        "camera_pitch_rad": np.where(n % 5, 0.3, np.nan),
        "camera_roll_rad": np.where(n % 5, -0.1, np.nan),
        "camera_frame": np.full(n.size, "camera", object),
        "world_frame": np.ma.array(np.full(n.size, "map", object), mask=n % 2 == 1),
        "camera_position_world": np.where(n[:, None] % 2, n[:, None] / 3 + np.zeros(3), np.nan),
        "camera_orientation_world": np.where(n[:, None] % 2, np.eye(4)[3], np.nan),
        "floor_source": np.where(n % 2, "frame", "tf").astype(object),
        "floor_refused": np.ma.array(np.full(n.size, "far", object), mask=n % 2 == 1),
        **{f"free_{name}": lists(n, np.float32) for name in ("bearing_rad", "from_m", "to_m")},
        "free_end": lists(n, np.int8),
        "drop_m": np.where(n % 4, np.nan, 1.5),
    }


def lists(numbers: np.ndarray, dtype: type) -> Lists:
    """Return one list per number ``n``: it has ``n`` elements equal to ``n``.

    The list is null if ``n`` is divisible by 3.
    """
    null = numbers % 3 == 0
    length = np.where(null, 0, numbers)
    return Lists.of_lengths(np.repeat(numbers, length).astype(dtype), length, null)


def obstacle_rows(start: int, stop: int) -> dict:
    n = np.arange(start, stop)
    rows: dict = {name: n.astype(np.float32) for name in OBSTACLES_SCHEMA.names}
    for name in ("obstacle", "num_points", "u_min", "u_max", "v_min", "v_max"):
        rows[name] = n.astype(np.int32)
    corners = np.repeat(n[:, None], 8, axis=1).astype(np.float32)
    world = np.where(n[:, None] % 2, corners, np.nan)
    rows |= {"log": np.full(n.size, "a", object), "camera": np.full(n.size, "c", object)}
    rows |= {"frame": n, "stamp_ns": n, "box_image": np.full(n.size, "depth", object)}
    rows["evidence"] = np.full(n.size, "surface", object)
    return rows | {
        "vertices": (n % 2).astype(np.int8),
        "corners_ground": corners,
        "corners_world": world,
        "bottom_m": np.where(n % 2, 0.1, np.nan),
        "contour": lists(n, np.float32),
    }


def write(folder: Path, batch: int, rows: int = 50) -> None:
    folder.mkdir(exist_ok=True)
    with TableWriter(folder) as writer:
        for start in range(0, rows, batch):
            stop = min(start + batch, rows)
            writer.add(Tables.of(frame_rows(start, stop), obstacle_rows(start, stop)))
        writer.close({}, {})
    write_json(folder / "summary.json", {"b": "é"})


def test_tables_survive_a_round_trip_with_nulls(tmp_path: Path) -> None:
    write(tmp_path, 7)
    frames = pq.read_table(tmp_path / "frames.parquet", page_checksum_verification=True)
    obstacles = pq.read_table(tmp_path / "obstacles.parquet", page_checksum_verification=True)
    assert frames.schema.equals(FRAMES_SCHEMA)
    assert obstacles.schema.equals(OBSTACLES_SCHEMA)
    assert frames["color_stamp_ns"].to_pylist()[:4] == [None, 10, None, 30]
    assert frames["camera_height_m"].to_pylist()[:2] == [None, pytest.approx(0.6)]
    assert obstacles["corners_world"].to_pylist()[:2] == [None, [1.0] * 8]
    assert obstacles["corners_ground"].to_pylist()[2] == [2.0] * 8
    assert frames["world_frame"].to_pylist()[:2] == ["map", None]
    assert frames["camera_position_world"].to_pylist()[:2] == [None, [1 / 3] * 3]
    assert frames["camera_orientation_world"].to_pylist()[:2] == [None, [0.0, 0.0, 0.0, 1.0]]
    assert frames["floor_refused"].to_pylist()[:2] == ["far", None]
    assert frames["free_end"].to_pylist()[:4] == [None, [1], [2, 2], None]
    assert frames["drop_m"].to_pylist()[:2] == [1.5, None]
    assert obstacles["contour"].to_pylist()[:3] == [None, [1.0], [2.0, 2.0]]
    assert obstacles["bottom_m"].to_pylist()[:2] == [None, pytest.approx(0.1)]
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == {"b": "é"}


def test_bytes_of_tables_do_not_depend_on_the_batch_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "ROWS_PER_GROUP", 16)
    for batch in (1, 7, 16, 50):
        write(tmp_path / str(batch), batch)
    for name in ("frames.parquet", "obstacles.parquet"):
        assert len({(tmp_path / str(b) / name).read_bytes() for b in (1, 7, 16, 50)}) == 1
        assert pq.ParquetFile(tmp_path / "1" / name).num_row_groups == 4


def test_empty_tables_are_written(tmp_path: Path) -> None:
    write(tmp_path, 5, rows=0)
    assert pq.read_table(tmp_path / "obstacles.parquet").num_rows == 0


def test_rows_do_not_change_in_a_round_trip(tmp_path: Path) -> None:
    rows = Tables.of(frame_rows(5, 10), obstacle_rows(5, 10))
    rows.save(tmp_path / "rows")
    for mine, want in zip(Tables.load(tmp_path / "rows"), rows, strict=True):
        assert mine.num_rows and mine.equals(want) and mine.schema.equals(want.schema)


def test_rows_are_written_without_pandas(tmp_path: Path) -> None:
    code = """
import sys
from pathlib import Path
from tests.test_results import frame_rows, obstacle_rows
from jaxdet.results.writer import Inputs
from jaxdet.results.tables import Tables
tables, path = Tables.of(frame_rows(0, 9), obstacle_rows(0, 9)), Path(sys.argv[1])
tables.save(path)
assert Tables.load(path).frames.num_rows == 9
rows = Inputs()
rows.add(tables.frames)
assert "pandas" not in sys.modules
"""
    found = subprocess.run([sys.executable, "-c", code, str(tmp_path / "rows")], cwd=ROOT)
    assert found.returncode == 0


def test_a_missing_folder_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="can't be written"):
        TableWriter(tmp_path / "missing")


def test_lost_frames_are_reported_as_a_problem():
    lost = "a, frames 5 to 9: worker_crashed (out of memory)"
    log = {"log": "a", "error": None, "frames": 10, "frame_errors": [], "lost": [lost]}
    log["cameras_left_out"] = []
    log["status"] = {"ok": 5, "worker_crashed": 5}
    assert problems({"logs": [log]}) == [lost]


def test_a_problem_names_its_log(monkeypatch):
    """The log is named even if the error is about another file, such as ground truth."""
    monkeypatch.chdir("/")
    log = {"log": "day", "paths": ["/logs/day_0.mcap"], "error": "logs/day_0.mcap: is torn"}
    folder = {"log": "room", "paths": ["/logs/room"], "error": "logs/room/rgb/1.png: is torn"}
    truth = {"log": "b", "paths": ["/logs/b.mcap"], "error": "a.mcap: the truth is of others"}
    found = problems({"logs": [log, folder, truth]})
    assert found == [log["error"], folder["error"], f"b: {truth['error']}"]
