"""Reading of results: all rows in order, in chunks of any size, and no incomplete results."""

import errno
import json
import os
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import jaxdet
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import InputError
from jaxdet.io import LogOptions
from jaxdet.results import reading, writer
from jaxdet.results.manifest import read_manifest, write_manifest
from jaxdet.results.names import camera_name, export_name, log_name
from jaxdet.results.reading import Results
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.writer import CONFIG_KEY, INPUTS_KEY, VERSION_KEY
from jaxdet.sim import SimConfig, write_log
from tests.made_results import make_results
from tests.runs import run_logs

CONFIG = Config(ground=GroundConfig(max_depth_m=3.5))
OPTIONS = LogOptions(pair_tolerance_s=0.1, color_intrinsics=(150.0, 150.0, 79.5, 59.5))


def write_results(folder: Path) -> Path:
    """Write results of three logs, the second failed, in row groups of seven rows."""
    for name, frames in (("a", 9), ("b", 4)):
        write_log(folder / f"{name}.mcap", SimConfig(frames=frames, width=160, height=120))
    (folder / "ab.mcap").write_bytes(b"no log")
    how = {"batch_size": 4, "pictures": 2, "preset": "wheeled"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "ROWS_PER_GROUP", 7)
        run_logs(folder, folder / "out", CONFIG, log=OPTIONS, **how)
    return folder / "out"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_results(tmp_path_factory.mktemp("reading"))


def test_reading_holds_one_row_group_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The number of row groups does not matter."""
    monkeypatch.setattr(writer, "ROWS_PER_GROUP", 1024)
    with Results(make_results(tmp_path / "out", {"a": 40 * 1024})) as results:
        before = pa.total_allocated_bytes()
        chunks = results.chunks(None, ["frame", "stamp_ns"], ["distance_m"], 1024)
        held = [pa.total_allocated_bytes() - before for _ in chunks]
    assert len(held) == 40 and max(held) < 500_000


def test_chunks_may_be_requested_with_other_columns(tmp_path: Path) -> None:
    with Results(make_results(tmp_path / "out", {"a": 20, "b": 20})) as results:
        first, second = results.logs
        for columns in (["stamp_ns"], ["status"], ["status", "stamp_ns"]):
            list(results.chunks(first, ["status"], ["distance_m"]))
            (chunk,) = results.chunks(second, columns, columns[:0])
            always = ["log", "camera", "frame", "num_obstacles"]
            assert chunk.frames.column_names == [*always, *columns]
            assert chunk.obstacles.column_names == always[:3]


def copied(folder: Path, to: Path) -> Path:
    """Return a copy of the results with only log b."""
    return Path(shutil.copytree(folder / "b", to))


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_chunks_add_up_to_the_tables(folder: Path, size: int) -> None:
    with Results(folder) as results:
        assert [log.name for log in results.logs] == ["a", "b"]
        whole = list(results.chunks(size=size))
        parts = [chunk for log in results.logs for chunk in results.chunks(log, size=size)]
    for number, name in enumerate(("frames", "obstacles")):
        each = [pq.read_table(folder / log / f"{name}.parquet") for log in "ab"]
        for chunks in (whole, parts):
            found = pa.concat_tables([chunk[number] for chunk in chunks])
            assert found.equals(pa.concat_tables(each))
    with Results(folder) as results:
        frames, obstacles = results.tables()
    assert frames.num_rows == 13
    assert len(obstacles) == sum(chunk.obstacles.num_rows for chunk in whole)
    assert whole[0].obstacles.num_rows == whole[0].first[-1]


def test_chunks_have_the_requested_columns(folder: Path) -> None:
    with Results(folder) as results:
        (chunk,) = results.chunks(results.log("b"), ["stamp_ns"], ["distance_m"])
    assert chunk.frames.column_names == ["log", "camera", "frame", "num_obstacles", "stamp_ns"]
    assert chunk.obstacles.column_names == ["log", "camera", "frame", "distance_m"]


def test_frames_are_iterated_with_their_obstacles(folder: Path) -> None:
    with Results(folder) as results:
        frames = list(results.frames())
        assert len(frames) == 13 == sum(log.num_frames for log in results.logs)
    for row, obstacles in frames:
        assert len(obstacles) == row["num_obstacles"] and row["camera_orientation_world"]
        assert all((o["log"], o["frame"]) == (row["log"], row["frame"]) for o in obstacles)
    assert sum(len(frame.obstacles) for frame in frames) > 13


def test_folders_are_given_as_path_or_text(folder: Path) -> None:
    with Results(str(folder)) as results:
        assert results.folder == folder


def test_results_record_version_configuration_and_inputs(folder: Path) -> None:
    with Results(folder) as results:
        assert results.method == CONFIG and results.log_options == OPTIONS
        assert results.version == jaxdet.__version__
        log = results.log("a")
        assert [path.name for path in log.paths] == ["a.mcap"]
        assert log.topic("color") and log.topic("depth") and not log.topic("sound")
        assert list(results.pictures(log)) == [0, 8]
        image = results.map(log)
        assert image is not None and image.path.shape == (9, 2) and image.counts.any()
        with pytest.raises(InputError, match="no log 'ab'; it holds a, b"):
            results.log("ab")


def test_metadata_of_tables_has_units_configuration_and_inputs(folder: Path) -> None:
    for name, schema in (("frames", FRAMES_SCHEMA), ("obstacles", OBSTACLES_SCHEMA)):
        file = pq.ParquetFile(folder / "a" / f"{name}.parquet")
        assert file.schema_arrow.equals(schema)
        for field in file.schema_arrow:
            about = {key.decode(): value.decode() for key, value in field.metadata.items()}
            assert about["description"]
            end = field.name.rpartition("_")[2]
            if end in ("m", "rad", "ns"):
                assert about["unit"] == end
        about = {key.decode(): value.decode() for key, value in file.metadata.metadata.items()}
        assert about[VERSION_KEY] == jaxdet.__version__
        config = json.loads(about[CONFIG_KEY])
        assert config["ground"]["max_depth_m"] == 3.5 and "backend" not in config
        inputs = json.loads(about[INPUTS_KEY])
        assert [(one["log"], one["frames"]) for one in inputs] == [("a", 9)]
        assert str(folder.parent) not in "".join(about.values())


@pytest.mark.parametrize(
    "name", ["manifest.json", "summary.json", "config.json", "obstacles.parquet"]
)
def test_incomplete_results_are_refused(folder: Path, tmp_path: Path, name: str) -> None:
    half = copied(folder, tmp_path / "half")
    (half / name).unlink()
    message = f"no (complete )?results .{name}"
    with pytest.raises(InputError, match=message):
        Results(half).tables()
    for damaged in (b"{", b"[]", b"[" * 100_000):
        (half / name).write_bytes(damaged)
        with pytest.raises(InputError, match="is not"):
            Results(half).tables()


def test_logs_that_are_not_finished_are_not_listed(folder: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copy / "a" / "manifest.json").unlink()
    (copy / "mine").mkdir()
    with Results(copy) as results:
        assert [log.name for log in results.logs] == ["b"] and not results.stale
        assert [failure.log for failure in results.failed] == ["ab"]
    (copy / "run.json").unlink()
    with pytest.raises(InputError, match="holds no results"):
        Results(copy)


def test_the_configuration_is_not_that_of_results_to_be_overwritten(folder, tmp_path) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    config = json.loads((copy / "a/config.json").read_text("utf-8"))
    config["ground"]["max_depth_m"] = 9.0
    (copy / "a/config.json").write_text(json.dumps(config), encoding="utf-8")
    about = {key: read_manifest(copy / "a")[key] for key in ("log", "inputs")}
    write_manifest(copy / "a", {**about, "run": "of another configuration"})
    with Results(copy) as results:
        assert results.stale == ["a"] and [log.name for log in results.logs] == ["b"]
        assert results.method == CONFIG and [path.name for path in results.manifests] == ["b"]


def test_names_in_received_results_cannot_leave_the_folder(folder: Path, tmp_path: Path) -> None:
    """Such names are refused before a file is read or written."""
    copy = copied(folder, tmp_path / "copy")
    summary = json.loads((copy / "summary.json").read_text("utf-8"))
    summary["logs"][0] |= {
        "file_name": "../../x",
        "map": "/etc/x",
        "pictures": ["../../y_000001.png"],
    }
    (copy / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    with pytest.raises(InputError, match=r"summary.json: is not as jaxdet writes it"):
        Results(copy)


def test_an_unreadable_file_is_not_reported_as_damaged(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shut(path: Path, mode: str) -> None:
        raise PermissionError(errno.EACCES, "Failed to open", str(path))

    message = r"%s: can't be read \(%s\); check its permissions"
    with monkeypatch.context() as patch, pytest.raises(InputError) as caught:
        patch.setattr(reading, "open_file", shut)
        Results(folder).tables()
    assert caught.match(message % ("frames.parquet", "Permission denied"))
    new = copied(folder, tmp_path / "new")
    (new / "frames.parquet").unlink()
    os.mkfifo(new / "frames.parquet")
    with pytest.raises(InputError, match=r"frames.parquet: is not a regular file"):
        Results(new).tables()
    (new / "frames.parquet").unlink()
    (new / "summary.json").unlink()
    (new / "summary.json").mkdir()
    with pytest.raises(InputError, match=message % ("summary.json", "Is a directory")):
        Results(new)


def test_tables_of_different_runs_are_refused(folder: Path, tmp_path: Path) -> None:
    other = copied(folder, tmp_path / "other")
    table = pq.read_table(other / "frames.parquet")
    about = pq.ParquetFile(other / "frames.parquet").metadata.metadata

    def replace(rows: pa.Table, metadata: dict) -> None:
        named = rows.replace_schema_metadata(metadata)
        pq.write_table(named, other / "frames.parquet")

    def refused(text: str) -> None:
        with Results(other) as results, pytest.raises(InputError, match=text):
            list(results.chunks())

    replace(table.slice(1), about)
    refused("3 rows, but summary")
    replace(pa.concat_tables([table, table.slice(3)]), about)
    refused("5 rows, but summary")
    replace(pa.concat_tables([table.slice(1), table.slice(0, 1)]), about)
    refused("don't belong together")
    replace(table, {**about, b"jaxdet.format": b"99"})
    refused("format 99 of the tables")
    replace(table, {})
    refused("format none of the tables")
    with pytest.raises(InputError, match="no such folder"):
        Results(tmp_path / "missing")


def test_a_log_is_not_a_results_folder(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").touch()
    with pytest.raises(InputError, match="a file, not a folder of results; name the folder"):
        Results(tmp_path / "drive.mcap")


def test_damaged_rows_are_an_error(folder: Path, tmp_path: Path) -> None:
    torn = copied(folder, tmp_path / "torn")
    data = bytearray((torn / "obstacles.parquet").read_bytes())
    data[200:400] = bytes(200)
    (torn / "obstacles.parquet").write_bytes(data)
    with Results(torn) as results, pytest.raises(InputError, match="can't be read"):
        list(results.frames())


def test_different_logs_have_different_folders() -> None:
    logs = [
        "a b",
        "a/b",
        "a_b",
        "a--b",
        "...",
        "",
        "\u00e9" * 200,
        "\u00e9" * 201,
        "x" * 300,
        "x" * 301,
    ]
    logs += ["Drive", "drive", "DRIVE", ".drive", "run.json", "a-/b", "a/-b", "failed.json"]
    names = [log_name(log) for log in logs]
    # Some file systems do not distinguish upper and lower case.
    assert len({name.casefold() for name in names}) == len(logs)
    assert log_name("drive_1") == "drive_1" and log_name("day/drive") == "day--drive"
    for name in names:
        assert set(name.encode()).isdisjoint(b"/ =%") and len(name.encode()) < 110
        assert name and not name.startswith(".") and not name.endswith(".json")
    cameras = ["front left", "front_left", "front-left", "front/left", "x" * 300, "x" * 301]
    assert len({camera_name(camera) for camera in cameras}) == len(cameras)
    assert export_name("log", "front/left") == "log@front-left"
