"""``jaxdet verify`` finds each kind of damage to results, and nothing in intact ones."""

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from jaxdet.cli import main
from jaxdet.cli.verify import report_lines
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import InputError
from jaxdet.io import LogOptions, find_logs
from jaxdet.results.manifest import write_manifest
from jaxdet.results.writer import INPUTS_KEY, Inputs, table_metadata
from jaxdet.sim import SimConfig, write_log
from jaxdet.tracks import TrackConfig, track_results
from jaxdet.verify import Report, verify
from jaxdet.verify.folder import check_files
from jaxdet.verify.logs import _OF_LOG
from tests.io_helpers import make_scene
from tests.io_helpers import write_log as write_random
from tests.runs import run_logs
from tests.test_io_image_folder import write_open3d

FRAMES = 12
TABLES = ("frames.parquet", "obstacles.parquet")
KEYS = {"log", "camera", "frame", "stamp_ns", *_OF_LOG}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of two logs, ``a`` and ``b``, in units of four frames, with tracks."""
    folder = tmp_path_factory.mktemp("verify")
    for seed, name in enumerate("ab"):
        write_log(folder / f"{name}.mcap", SimConfig(frames=FRAMES, width=96, height=72, seed=seed))
    config = Config(ground=GroundConfig(sample_frames=3, window_s=0.2))
    run_logs(folder, folder / "out", config, batch_size=4, pictures=1)
    track_results(folder / "out")
    return folder / "out"


@pytest.fixture
def results(whole: Path, tmp_path: Path) -> Path:
    """Return a copy of the results of log a, to damage."""
    return Path(shutil.copytree(whole / "a", tmp_path / "out"))


def found(report: Report, but: str = "") -> list[str]:
    return [str(finding) for finding in report.findings if finding.check != but]


def sealed(folder: Path) -> None:
    """Update the checksums in the manifest, as someone would who hides a change."""
    about = json.loads((folder / "manifest.json").read_text("utf-8"))
    write_manifest(folder, {k: v for k, v in about.items() if k not in ("files", "sha256")})


def rewrite(folder: Path, tables: Mapping[str, pa.Table], *, inputs: bool = False) -> None:
    """Write tables, figures, manifests and, with ``inputs``, the digests of the logs."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for log in summary["logs"]:
        for name, table in tables.items():
            log[name.partition(".")[0]] = table["log"].to_pylist().count(log["log"])
    for name, table in tables.items():
        summary[name.partition(".")[0]] = table.num_rows
    rows = tables["frames.parquet"]
    for log in summary["logs"]:
        mine = rows.filter(pa.array([name == log["log"] for name in rows["log"].to_pylist()]))
        log["status"] = {"ok": mine.num_rows}
        log["floor_sources"] = dict.fromkeys(log["floor_sources"], mine.num_rows)
    read = Inputs()
    read.add(rows)
    for name, table in tables.items():
        about = dict(pq.ParquetFile(folder / name).metadata.metadata)
        if inputs:
            config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
            about[INPUTS_KEY.encode()] = table_metadata(config, summary, read)[INPUTS_KEY].encode()
        pq.write_table(table.replace_schema_metadata(about), folder / name)
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    sealed(folder)


def read(folder: Path) -> dict[str, pa.Table]:
    return {name: pq.read_table(folder / name) for name in TABLES}


def frames_of(table: pa.Table, log: str, start: int, stop: int) -> list[int]:
    """Return the indices of the rows of a range of frames."""
    keys = zip(table["log"].to_pylist(), table["frame"].to_pylist(), strict=True)
    return [row for row, (name, frame) in enumerate(keys) if name == log and start <= frame < stop]


def without(tables: Mapping[str, pa.Table], frame: int) -> dict[str, pa.Table]:
    """Return tables without a frame of log ``a``."""
    left = {}
    for name, table in tables.items():
        gone = {*frames_of(table, "a", frame, frame + 1)}
        left[name] = table.take([row for row in range(table.num_rows) if row not in gone])
    return left


def test_intact_results_have_no_findings(whole: Path) -> None:
    report = verify(whole, sample=3)
    assert report.findings == report.notes == []
    each = [[pq.read_metadata(whole / log / name).num_rows for log in "ab"] for name in TABLES]
    rows = [sum(counts) for counts in each]
    assert [report.frames, report.obstacles] == rows and rows[1] > 0
    assert (report.frames_of_logs, report.frames_again) == (2 * FRAMES, 2 * 3)
    assert report.files == sum(path.is_file() for path in whole.rglob("*")) - 3


def test_results_of_parts_of_logs_have_no_findings(whole: Path, tmp_path: Path) -> None:
    log = whole.parent / "a.mcap"
    options = LogOptions(start="0.1", every=3)
    run_logs(log, tmp_path, log=options, pictures=0)
    report = verify(tmp_path, sample=1)
    assert report.findings == report.notes == [] and 1 < report.frames < FRAMES / 2


def test_results_of_a_scanned_log_have_no_findings(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    write_random(log, make_scene(2 * FRAMES), chunk_size=1)
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[-FRAMES]  # its depth image is not read on opening
    data = bytearray(log.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length - 9] ^= 0xFF
    log.write_bytes(data)
    config = Config(ground=GroundConfig(sample_frames=3))
    run_logs(log, tmp_path / "out", config, pictures=0)
    report = verify(tmp_path / "out", sample=1)
    assert report.findings == [] and report.frames == 2 * FRAMES - 1


def test_a_flipped_byte_in_any_file_is_reported(results: Path) -> None:
    names = [str(p.relative_to(results)) for p in results.rglob("*") if p.is_file()]
    assert {*TABLES, "tracks.parquet", "map.npz", "pictures/000000.png"} <= {*names}
    for name in names:
        content = (results / name).read_bytes()
        places = {0, len(content) // 2, len(content) - 1}
        if name == "manifest.json":
            places |= {*range(0, len(content), 13)}
        for place in places:
            spoiled = bytearray(content)
            spoiled[place] ^= 1
            (results / name).write_bytes(spoiled)
            report = Report()
            check_files(results, report)
            assert [finding.where for finding in report.findings] == [name], place
        (results / name).write_bytes(content)
    report = Report()
    check_files(results, report)
    assert not report.findings and report.files == len(names) - 1


def test_missing_and_additional_files_are_named(results: Path) -> None:
    (results / "map.npz").unlink()
    (results / "map.png").write_bytes(b"")
    (results / "pictures" / "c_000000.png").touch()
    for mine in ("map_mine.txt", "mine.txt"):
        (results / mine).touch()
    (results / "pictures" / "mine.txt").symlink_to("nowhere")
    report = verify(results, sample=0)
    assert found(report)[0] == "map.npz: missing"
    assert found(report)[1].startswith("map.png: expected ")
    others = ("map_mine.txt", "pictures/c_000000.png", "pictures/mine.txt")
    assert found(report)[2:] == [f"{name}: not in the manifest" for name in others]
    assert report.notes == ["mine.txt is not part of the results"]
    (results / "scenes").mkdir()  # an export
    for number in range(100):
        (results / "scenes" / f"{number}.jpg").touch()
    *_, last = verify(results, sample=0).notes
    assert last == "scenes/ has 100 files that are not part of the results"
    (results / "manifest.json").unlink()
    (finding,) = found(verify(results, sample=0))
    assert finding.startswith("manifest.json: has no complete results")


def test_swapped_units_are_reported(results: Path) -> None:
    tables = read(results)
    for name, table in tables.items():
        first, second = (frames_of(table, "a", at, at + 4) for at in (0, 4))
        rest = range(len(first) + len(second), table.num_rows)
        tables[name] = table.take([*second, *first, *rest])
    rewrite(results, tables)
    assert found(verify(results)) == [
        "a: expected frame 0 first, got 4",
        *[f"{name}: timestamps and calibrations differ from its rows or summary.json"
          for name in TABLES],
    ]  # fmt: skip


def test_swapped_contents_are_reported(results: Path) -> None:
    """Keys and checksums fit, so only the reference and the tracks reveal the change."""
    tables = read(results)
    frames = tables["frames.parquet"]
    order = [*range(4, 8), *range(4), *range(8, frames.num_rows)]
    moved = {name: frames[name] if name in KEYS else frames[name].take(order)
             for name in frames.column_names}  # fmt: skip
    obstacles = tables["obstacles.parquet"]
    rows = [row for at in order[:8] for row in frames_of(obstacles, "a", at, at + 1)]
    rows += range(len(rows), obstacles.num_rows)
    target = {old: new for new, old in enumerate(order[:8])}
    columns = {name: obstacles[name].take(rows) for name in obstacles.column_names}
    number = zip(columns["log"].to_pylist(), columns["frame"].to_pylist(), strict=True)
    at = [target.get(frame, frame) if log == "a" else frame for log, frame in number]
    stamps = dict(zip(frames["frame"].to_pylist(), frames["stamp_ns"].to_pylist(), strict=False))
    columns["frame"] = pa.array(at, pa.int64())
    columns["stamp_ns"] = pa.array([stamps[one] for one in at], pa.int64())
    spoiled = {
        "frames.parquet": pa.table(moved, schema=frames.schema),
        "obstacles.parquet": pa.table(columns, schema=obstacles.schema),
    }
    rewrite(results, spoiled)
    report = verify(results, sample=FRAMES)
    assert {finding.check for finding in report.findings} == {"sample", "tracks"}
    of_frames = found(report, but="tracks")
    numbers = [int(re.findall(r"a: frame (\d+): ", text)[0]) for text in of_frames]
    assert {*numbers} == {*range(8)}


def raised(table: pa.Table, name: str, row: int, by: float) -> pa.Table:
    """Return a table with another value in a column."""
    values = table[name].to_pylist()
    values[row] += by
    column = table.column_names.index(name)
    field = table.schema.field(column)
    return table.set_column(column, field, [pa.array(values, field.type)])


def test_a_changed_value_is_detected_by_the_reference(results: Path) -> None:
    tables = read(results)
    obstacles = tables["obstacles.parquet"]
    (row, *_) = frames_of(obstacles, "a", 11, 12)
    tables["obstacles.parquet"] = raised(obstacles, "distance_m", row, 0.001)
    rewrite(results, tables)
    assert found(verify(results, sample=2), but="tracks") == [
        "a: frame 11: distance_m of obstacles.parquet differs from the reference"
    ]
    assert {finding.check for finding in verify(results, sample=0).findings} == {"tracks"}


@pytest.mark.parametrize(
    ("column", "problem"),
    [
        ("obstacle", "a: obstacles of a frame are not numbered from 0"),
        ("stamp_ns", "a: stamp_ns of obstacles differs from their frames"),
    ],
)
def test_obstacles_that_do_not_fit_their_frames_are_reported(
    results: Path, column: str, problem: str
) -> None:
    tables = read(results)
    obstacles = tables["obstacles.parquet"]
    (row, *_) = frames_of(obstacles, "a", 11, 12)
    tables["obstacles.parquet"] = raised(obstacles, column, row, 1)
    rewrite(results, tables)
    assert problem in found(verify(results, sample=0))


@pytest.mark.parametrize(
    ("frame", "problem"),
    [
        (5, "a: frame 5 is missing: frame 6 follows 4"),
        (11, "a: the log has 12 frames, but the results have 11"),
    ],
)
def test_a_missing_frame_is_reported(results: Path, frame: int, problem: str) -> None:
    rewrite(results, without(read(results), frame), inputs=True)
    assert found(verify(results), but="tracks") == [problem]


def test_figures_that_include_a_missing_frame_are_reported(results: Path) -> None:
    for name, table in without(read(results), 11).items():
        about = pq.ParquetFile(results / name).metadata.metadata
        pq.write_table(table.replace_schema_metadata(about), results / name)
    sealed(results)
    (problem,) = found(verify(results))
    assert problem.endswith("a: 11 rows, but summary.json says 12")


def test_figures_that_differ_from_the_rows_are_reported(results: Path) -> None:
    path = results / "summary.json"
    summary = json.loads(path.read_text(encoding="utf-8"))
    summary["logs"][0]["status"] = {"ok": 11, "no_color": 1}
    summary["logs"][0]["lost"] = ["a, frames 0 to 3: timeout (twice)"]
    path.write_text(json.dumps(summary), encoding="utf-8")
    sealed(results)
    report = verify(results)
    (problem,) = found(report)
    assert problem.startswith("a: status is {'ok': 12} in the rows, but {'ok': 11")
    assert report.notes[0] == "lost in the run: a, frames 0 to 3: timeout (twice)"


def test_another_log_in_place_of_the_input_is_reported(whole: Path, tmp_path: Path) -> None:
    """The other log has equally many frames with equal timestamps."""
    other = SimConfig(frames=FRAMES, width=96, height=72, seed=5)
    write_log(tmp_path / "a.mcap", other)
    report = verify(whole, [str(tmp_path / "a.mcap")], sample=2)
    assert {(finding.check, finding.where) for finding in report.findings} >= {
        ("log", str(tmp_path / "a.mcap"))
    }
    write_log(tmp_path / "a.mcap", SimConfig(frames=FRAMES - 1, width=96, height=72))
    problems = found(verify(whole, [str(tmp_path / "a.mcap")], sample=0))
    assert problems[-1] == "a: the log has 11 frames, but the results have 12"
    (tmp_path / "a.mcap").write_bytes(b"no log")
    assert "a.mcap" in found(verify(whole, [str(tmp_path / "a.mcap")], sample=0))[-1]
    with pytest.raises(InputError, match="no log 'c'"):
        shutil.copy(tmp_path / "a.mcap", tmp_path / "c.mcap")
        verify(whole, [str(tmp_path / "c.mcap")])


def test_an_image_folder_is_found_at_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    logs = find_logs([str(write_open3d(Path("drive")))])
    run_logs(logs, tmp_path / "out", pictures=0)
    monkeypatch.chdir("/")
    report = verify(tmp_path / "out", sample=1)
    assert report.findings == report.notes == [] and report.frames_of_logs == report.frames == 3


def test_moved_logs_are_given_by_a_flag_or_reported_in_a_note(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole.parent, tmp_path / "all")
    out = tmp_path / "all" / "out"
    for summary in out.glob("*/summary.json"):
        text = summary.read_text("utf-8").replace(str(whole.parent), "/gone")
        summary.write_text(text, "utf-8")
        sealed(summary.parent)
    report = verify(out)
    assert not report.findings and not report.frames_of_logs
    assert report.notes[0].startswith("a was not compared: /gone/a.mcap: the log is not at its")
    assert report.notes[0].endswith("pass it with --against")
    assert report_lines(report)[-1] == (
        f"no problems, but {2 * FRAMES} frames were not compared with their logs"
    )
    report = verify(out, [str(tmp_path / "all" / "*.mcap")], sample=1)
    assert report.findings == report.notes == [] and report.frames_of_logs == 2 * FRAMES


def test_renamed_logs_are_recognized_by_their_content(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "all"
    shutil.copytree(whole.parent, folder)
    (folder / "a.mcap").rename(folder / "c.mcap")
    report = verify(folder / "out", [str(folder / "*.mcap")], sample=1)
    assert not report.findings and report.frames_of_logs == 2 * FRAMES
    content = (folder / "c.mcap").read_bytes()
    (folder / "c.mcap").write_bytes(content[:-1])
    known = "no log 'c'; their logs are a, b; logs are identified by name, else by content"
    with pytest.raises(InputError, match=known):
        verify(folder / "out", [str(folder / "*.mcap")], sample=1)


def test_an_incomplete_run_is_reported(whole: Path, tmp_path: Path) -> None:
    """The finding names the folder of the log."""
    copy = Path(shutil.copytree(whole, tmp_path / "copy"))
    (copy / "a" / "map.npz").write_bytes(b"")
    (copy / "b" / "manifest.json").unlink()
    (copy / "mine").mkdir()
    (copy / "c").mkdir()
    record = {"logs": [{"log": "c", "camera": None, "paths": [], "error": "no", "lost": []}]}
    record["logs"][0] |= {"frames": 0, "obstacles": 0}
    (copy / "c" / "failed.json").write_text(json.dumps(record))
    report = verify(copy, sample=0)
    first, second = found(report)
    assert first.startswith("a/map.npz: expected ")
    assert second == "b: the results are incomplete: there is no manifest"
    assert report.notes == [
        "c failed in the run and has no results",
        "mine is not the results of a log",
    ]


def test_verify_computes_the_tracks_again(results: Path, capsys: Any) -> None:
    """A changed byte is found even if its checksum was updated."""
    report = verify(results, sample=0)
    rows = pq.read_metadata(results / "track_links.parquet").num_rows
    assert not report.findings and 0 < report.linked <= rows == report.obstacles
    for name in ("tracks.parquet", "track_links.parquet", "tracks.png"):
        content = (results / name).read_bytes()
        for place in range(4, len(content), len(content) // 7):
            spoiled = bytearray(content)
            spoiled[place] ^= 1
            (results / name).write_bytes(spoiled)
            sealed(results)
            problems = verify(results, sample=0).findings
            assert problems and {(one.check, one.where) for one in problems} == {("tracks", name)}
        (results / name).write_bytes(content)
        sealed(results)
    assert main(["verify", str(results), "--sample", "0"]) == 0
    assert f"obstacles read, {report.linked} linked again" in capsys.readouterr().out


def test_tracks_of_other_obstacles_are_reported(results: Path, tmp_path: Path) -> None:
    """Tracks of recorded settings are accepted even if these are not the defaults."""
    track_results(results, TrackConfig(min_frames=2))
    assert not verify(results, sample=0).findings
    other = shutil.copytree(results, tmp_path / "other")
    track_results(other, TrackConfig(min_frames=3))
    shutil.copy(other / "track_links.parquet", results)
    (results / "tracks.png").rename(results / "tracks_c.png")
    sealed(results)
    assert found(verify(results, sample=0)) == [
        "track_links.parquet: differs from linking the obstacles again",
        "tracks.png: missing, but created by linking the obstacles again",
        "tracks_c.png: not created by linking the obstacles again",
    ]


def test_a_damaged_map_of_tracks_is_reported_once(results: Path) -> None:
    content = (results / "map.npz").read_bytes()
    for place in range(0, len(content), len(content) // 40):
        spoiled = bytearray(content)
        spoiled[place : place + 3] = b"\xff\xff\xff"
        (results / "map.npz").write_bytes(spoiled)
        sealed(results)
        assert {finding.check for finding in verify(results, sample=0).findings} <= {"tracks"}


def test_a_configuration_value_that_was_edited_to_another_type_is_reported(results: Path) -> None:
    path = results / "config.json"
    config = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(config | {"log": []}), encoding="utf-8")
    assert "config.json" in {finding.where for finding in verify(results, sample=0).findings}


def test_the_command_prints_findings_and_exits_with_1(results: Path, capsys: Any) -> None:
    assert main(["verify", str(results), "--sample", "1"]) == 0
    assert capsys.readouterr().out.endswith("no problems found\n")
    (results / "config.json").unlink()
    assert main(["verify", str(results), "--json"]) == 1
    record = json.loads(capsys.readouterr().out)
    assert record["findings"][0] == {
        "check": "files", "where": "config.json", "problem": "missing"
    }  # fmt: skip
    assert main(["verify", str(results / "missing")]) == 1
    assert "no such folder" in capsys.readouterr().err
    assert main(["verify", str(results), "--sample", "-1"]) == 2
