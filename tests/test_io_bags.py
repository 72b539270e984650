"""ROS 1 bags and SQLite bags of rosbag2 give the frames of equal MCAP files, even if damaged."""

import importlib.util
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxdet.cli.main import main
from jaxdet.errors import FrameStatus, InputError
from jaxdet.io import Log, LogOptions, find_logs, open_log, sqlite
from jaxdet.io import open_log as open_only
from jaxdet.io.bag import records
from jaxdet.io.chunks import DamageError
from jaxdet.io.limits import ReadMemory
from jaxdet.io.sqlite import SqliteFile
from jaxdet.sim import SimConfig, write_log
from tests.io_helpers import convert_log, make_scene
from tests.io_helpers import write_log as write_made
from tests.runs import only_log, run_logs

TABLES = ("frames.parquet", "obstacles.parquet")


@pytest.fixture(scope="module")
def mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "sim.mcap"
    write_log(path, SimConfig(frames=8, width=160, height=120, rate_hz=5))
    return path


@pytest.fixture(scope="module")
def bag(mcap: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return convert_log(mcap, tmp_path_factory.mktemp("bag") / "sim.bag")


@pytest.fixture(scope="module")
def db3(mcap: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return convert_log(mcap, tmp_path_factory.mktemp("db3") / "sim")


def copy(path: Path, folder: Path) -> Path:
    target = folder / path.name
    target.write_bytes(path.read_bytes())
    return target


def run(log: Path, output: Path) -> list[bytes]:
    run_logs(log, output, pictures=0, workers=1)
    return [(only_log(output) / name).read_bytes() for name in TABLES]


def assert_same(found: Log, expected: Log) -> None:
    """Assert that two logs give the same frames."""
    assert found.num_frames == expected.num_frames
    assert found.calibration == expected.calibration
    assert np.array_equal(found.T_base_camera, expected.T_base_camera)
    for one, other in zip(
        found.batches(3, color=True), expected.batches(3, color=True), strict=True
    ):
        assert one.status == other.status
        for name in ("color", "depth", "number", "stamp_ns", "color_stamp_ns", "T_world_camera"):
            pair = getattr(one.frames, name), getattr(other.frames, name)
            assert np.array_equal(*pair, equal_nan=name == "T_world_camera"), name


def by_index(log: Log) -> bool:
    return all(file.by_index for file in log.description.integrity)


def test_tables_equal_those_of_the_mcap_file(mcap, bag, db3, tmp_path):
    expected = run(mcap, tmp_path / "mcap")
    assert run(bag, tmp_path / "bag") == expected
    assert run(db3, tmp_path / "db3") == expected


@pytest.mark.parametrize("compress", [None, "lz4", "bz2"])
@pytest.mark.parametrize("scan", [False, True])
def test_a_bag_gives_the_frames_of_the_mcap_file(mcap, tmp_path, compress, scan):
    path = convert_log(mcap, tmp_path / "sim.bag", compress)
    with open_log(str(path), LogOptions(scan=scan)) as log, open_log(str(mcap)) as expected:
        assert by_index(log) is not scan
        assert_same(log, expected)


@pytest.mark.parametrize("scan", [False, True])
def test_a_db3_file_gives_the_frames_of_the_mcap_file(mcap, db3, scan):
    with open_log(str(db3), LogOptions(scan=scan)) as log, open_log(str(mcap)) as expected:
        assert by_index(log) is not scan
        assert_same(log, expected)


def test_db3_without_definitions_uses_those_of_ros(mcap, db3, tmp_path):
    path = copy(db3, tmp_path)
    with closing(sqlite3.connect(path)) as file, file:
        file.execute("DROP TABLE message_definitions")
        file.execute("DROP TABLE metadata")
    with open_log(str(path)) as log, open_log(str(mcap)) as expected:
        assert_same(log, expected)


def test_a_db3_file_whose_table_was_copied_without_its_key_is_read(mcap, db3, tmp_path):
    path = copy(db3, tmp_path)
    with closing(sqlite3.connect(path)) as file, file:
        columns = "id + 10 AS id, topic_id, timestamp, data"
        file.execute(f"CREATE TABLE copied AS SELECT {columns} FROM messages")
        file.execute("DROP TABLE messages")
        file.execute("ALTER TABLE copied RENAME TO messages")
    with open_log(str(path)) as log, open_log(str(mcap)) as expected:
        assert_same(log, expected)


def test_a_recording_of_librealsense_is_read(shared_data):
    folder = shared_data / "realsense_d435_bag"
    source = folder / "unit-tests" / "resources" / "single_depth_color_640x480.bag"
    other = str(folder / "realsense_d435_1pair.mcap")
    with open_log(str(source)) as log, open_log(other) as expected:
        for name in ("color", "depth"):
            pair = getattr(log.calibration, name), getattr(expected.calibration, name)
            assert np.allclose(*(camera[:6] for camera in pair), rtol=0, atol=1e-6)
        pair = log.calibration.color_from_depth, expected.calibration.color_from_depth
        for one, other in zip(*pair, strict=True):
            assert np.allclose(one, other, rtol=0, atol=1e-6)
        [found, *_], [other, *_] = (list(one.batches(1, color=True)) for one in (log, expected))
        assert found.status == other.status == (FrameStatus.OK,)
        assert np.array_equal(found.frames.color, other.frames.color)
        assert np.array_equal(found.frames.depth, other.frames.depth)


def test_an_unclosed_bag_is_an_error_that_names_the_repair(bag, tmp_path):
    data, path = bag.read_bytes(), tmp_path / "torn.bag"
    end = int.from_bytes(next(records(data[13:])).fields[b"index_pos"], "little")
    for torn in (data[:end], data[: end + 100], data[:5000]):
        path.write_bytes(torn)
        with pytest.raises(InputError, match=r"no usable index \(.*\); run rosbag reindex on"):
            open_log(str(path))


@pytest.mark.parametrize("compress", [None, "lz4", "bz2"])
@pytest.mark.parametrize(
    ("part", "is_lost"), [("header", True), ("content", True), ("index", False)]
)
def test_a_damaged_chunk_of_a_bag_is_reported(mcap, tmp_path, compress, part, is_lost):
    """Twenty bytes are zeroed in the middle. The index of a chunk is not needed to read it."""
    path = convert_log(mcap, tmp_path / "sim.bag", compress)
    data = bytearray(path.read_bytes())
    items = [*records(bytes(data[13:]))]
    middle = next(n for n, item in enumerate(items) if item.op == 5 and item.start > len(data) // 2)
    chunk, index = items[middle : middle + 2]
    assert index.op == 4
    start = 13 + {"header": chunk.start, "content": chunk.data, "index": index.start}[part]
    data[start : start + 20] = bytes(20)
    path.write_bytes(data)
    with open_log(str(path), LogOptions(scan=True)) as log:
        [integrity] = log.description.integrity
        assert integrity.declared_messages == sum(
            t.num_messages for t in log.description.topics
        ) + sum(integrity.missing.values())
        assert integrity.recovered is is_lost is (sum(integrity.lost.values()) == 1)
        assert any("bytes lost" in text for text in log.description.warnings) is is_lost
        lost = integrity.missing.get("/camera/camera/depth/image_rect_raw", 0)
        assert log.num_frames == 8 - lost
        for batch in log.batches(3):
            assert set(batch.status) == {FrameStatus.OK}
    if part != "content":
        with open_log(str(path)) as log:
            assert log.num_frames == 8 - lost


def test_info_scans_a_bag_with_damaged_images(tmp_path, capsys):
    """The damage is noticed when an image is read, after the bag was opened by its index."""
    source = write_made(tmp_path / "x.mcap", make_scene(20))
    path = convert_log(source, tmp_path / "x.bag", "bz2")
    data = bytearray(path.read_bytes())
    chunks = [item for item in records(bytes(data[13:])) if item.op == 5]
    for chunk in chunks[-20:-10]:
        data[13 + chunk.data + 100 : 13 + chunk.data + 110] = bytes(10)
    path.write_bytes(data)
    assert main(["info", str(path)]) == 0
    assert "recovered: " in capsys.readouterr().out


def test_a_chunk_of_a_bag_that_exceeds_the_memory_is_refused(mcap, tmp_path):
    """Its size after decompression counts."""
    path = convert_log(mcap, tmp_path / "sim.bag", "bz2")
    chunks = [item for item in records(path.read_bytes()[13:]) if item.op == 5]
    most = max(item.number(b"size") for item in chunks)
    assert max(item.size for item in chunks) < most

    def read(chunk: int) -> list[FrameStatus]:
        with open_only(str(path), memory=ReadMemory(chunk)) as log:
            return [status for batch in log.batches(3) for status in batch.status]

    assert read(most) == [FrameStatus.OK] * 8
    with pytest.raises(InputError, match=r"a chunk of .* needs .*; raise --memory by"):
        read(most - 1)


def count_messages(path: Path) -> int:
    with closing(sqlite3.connect(path)) as file:
        return file.execute("SELECT count(*) FROM messages").fetchone()[0]


@pytest.mark.parametrize("where", [0.25, 0.5, 0.75])
@pytest.mark.parametrize("torn", [False, True])
def test_damaged_db3_accounts_for_every_message(db3, tmp_path, where, torn):
    """A page is zeroed or the file truncated; the index of times still counts all messages."""
    data, path = bytearray(db3.read_bytes()), tmp_path / "sim.db3"
    leaves = [at for at in range(0, len(data), 4096) if data[at] == 0x0D]
    page = leaves[int(where * len(leaves))]
    path.write_bytes(data[:page] if torn else data[:page] + bytes(4096) + data[page + 4096 :])
    with open_log(str(path)) as log:
        [integrity] = log.description.integrity
        count = count_messages(db3)
        assert 0 < integrity.messages < count == integrity.declared_messages
        assert integrity.messages + sum(integrity.lost.values()) == count
        assert integrity.has_end is not torn
        images = integrity.missing.get("/camera/camera/depth/image_rect_raw", 0)
        assert images + log.num_frames <= 8
        for batch in log.batches(4):
            assert set(batch.status) == {FrameStatus.OK}


@pytest.mark.parametrize("answer", ["SELECT 1 WHERE 0", "SELECT -1, 1, 1, NULL, 1"])
def test_queries_of_a_damaged_db3_terminate(db3, monkeypatch, answer):
    """The query for all rows fails; queries for single rows return no row or an earlier one."""
    query = SqliteFile.query

    def damaged(self: SqliteFile, text: str, values: Any = ()) -> Any:
        if "count" not in values:
            return query(self, text, values)
        if values["count"] == -1:
            raise DamageError("disk image is malformed")
        return query(self, answer)

    monkeypatch.setattr(SqliteFile, "query", damaged)
    lost = Counter[str]()
    with closing(SqliteFile(db3, 1 << 30)) as file:
        assert [*sqlite._rows(file, lost)] == []
    assert lost["page is damaged"] == count_messages(db3) + 1


def test_a_recording_in_several_formats_is_one_log(mcap, bag, db3, tmp_path):
    for path in (mcap, bag, db3):
        copy(path, tmp_path)
    (tmp_path / "other.svo2").write_bytes(b"x")
    (tmp_path / "other.r3d").write_bytes(b"x")
    [log] = find_logs([str(tmp_path)])
    assert [path.name for path in log.paths] == ["sim.mcap"]
    for text in (
        "sim.bag is left out",
        "sim.db3 is left out",
        "other.svo2 is left out: play it with zed-ros2-wrapper",
        "other.r3d is left out: in Record3D, export it as EXR",
    ):
        assert text in log.note
    with open_log(log) as opened:
        assert log.note in opened.description.warnings
    [named] = find_logs([str(tmp_path / "sim.bag")])
    assert [path.name for path in named.paths] == ["sim.bag"]


def test_logs_are_found_through_links_and_with_suffixes_in_upper_case(mcap, tmp_path):
    """A link to a parent folder is followed once; a broken link is reported."""
    folder, elsewhere = tmp_path / "logs", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    copy(mcap, folder).rename(folder / "A.MCAP")
    copy(mcap, elsewhere).rename(elsewhere / "b.mcap")
    (folder / "day2").symlink_to(elsewhere)
    (folder / "up").symlink_to(folder)
    (folder / "lost.mcap").symlink_to(tmp_path / "nothing.mcap")
    found = find_logs([str(folder)])
    assert sorted(log.name for log in found) == ["A", "day2/b"]
    assert [log.note for log in found if log.note] == ["lost.mcap is left out: a broken link"]
    for number in range(20):
        (folder / f"lost_{number:02}.mcap").symlink_to(tmp_path / "nothing.mcap")
    message = [log.note for log in find_logs([str(folder)]) if log.note]
    assert len(message) == 1 and message[0].endswith(
        "lost_02.mcap is left out: a broken link; and 17 more"
    )
    for name in ("A.MCAP", "day2"):
        (folder / name).unlink()
    with pytest.raises(InputError, match=r"lost\.mcap: this is a broken link.*correct the link"):
        find_logs([str(folder)])


def test_a_folder_without_logs_is_an_error(tmp_path):
    (tmp_path / "run.bag.active").write_bytes(b"x")
    with pytest.raises(InputError, match=r"run\.bag\.active.*rosbag reindex"):
        find_logs([str(tmp_path)])
    (tmp_path / "run.mcap.active").write_bytes(b"x")
    with pytest.raises(
        InputError, match=r"\.active files are not supported; remove \.active from its name"
    ):
        find_logs([str(tmp_path / "run.mcap.active")])


def test_a_lerobot_dataset_is_an_error_that_names_a_remedy(mcap, tmp_path):
    folder = tmp_path / "pick"
    (folder / "meta").mkdir(parents=True)
    (folder / "videos").mkdir()
    (folder / "videos" / "file-000.mp4").write_bytes(b"x")
    (folder / "meta" / "info.json").write_text('{"codebase_version": "v3.0", "fps": 30}')
    message = "pick: LeRobot datasets are not supported, .* no camera calibration; write its frames"
    for given in (folder, tmp_path):
        with pytest.raises(InputError, match=message):
            find_logs([str(given)])
    copy(mcap, tmp_path)
    [log] = find_logs([str(tmp_path)])
    assert log.note == "pick is left out: a LeRobot dataset"


def test_bag_without_rosbags_names_the_extra(bag, monkeypatch):
    find_spec = importlib.util.find_spec
    hidden = lambda name, *rest: None if name == "rosbags" else find_spec(name, *rest)  # noqa: E731
    monkeypatch.setattr("jaxdet.io.bag.find_spec", hidden)
    with pytest.raises(InputError, match=r"jaxdet\[rosbag\].*rosbags-convert --src .*sim\.bag"):
        open_log(str(bag))


@pytest.mark.parametrize(
    "name, content, problem",
    [
        ("a.bag", b"#ROSBAG V1.2\n" + bytes(99), "not a ROS 1 bag"),
        ("a.bag", b"#ROSBAG V2.0\n" + bytes(99), "run rosbag reindex"),
        ("a.db3", b"SQLite format 3\0" + bytes(99), "can't be read"),
        ("a.db3", b"x" * 99, "not a rosbag2 SQLite file"),
        ("a.db3", b"", "is empty"),
        ("a.mcap", bytes(range(99)), "not an MCAP file; record or copy it again"),
        (
            "a.mcap",
            b"x = 3\ny" + b" " * 99,
            r"but text that begins with 'x = 3';",
        ),
        ("a.mcap", bytes(5000), "but zeros, as if it was never written; copy the recording"),
        ("a.mcap", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer; run git lfs"),
        (
            "a.bag",
            b"\n<!DOCTYPE HTML><title>404</title>",
            "'<!DOCTYPE HTML>.*a server; download",
        ),
        ("a.mcap", b"PK\3\4" + bytes(99), "but a ZIP archive; unpack it"),
        ("a.mcap.gz", b"x" * 99, "not an MCAP file, but text that begins with"),
        ("a.mcap.zst", b"", "a.mcap.zst: the file is empty"),
        ("a.mcap.zst", b"\x28\xb5\x2f\xfd", r"a.mcap.zst: can't be decompressed \(Truncated"),
        ("a.tar.zst", b"x" * 99, r"\.tar files are not supported; unpack it"),
        ("a.mcap.xz", b"x" * 99, r"\.xz files are not supported; decompress it"),
        ("a.sens", b"x" * 99, "not supported; export its images with ScanNet's SensReader"),
    ],
)
def test_files_that_are_not_recordings_are_refused(tmp_path, name, content, problem):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(Exception, match=problem):
        open_log(str(path))


def test_an_unclosed_db3_is_an_error(db3, tmp_path):
    path = copy(db3, tmp_path)
    journal = tmp_path / "sim.db3-wal"
    journal.write_bytes(b"x")
    with pytest.raises(InputError, match=r"not closed, sim\.db3-wal"):
        open_log(str(path))


@pytest.mark.parametrize("suffix", ["-wal", "-journal"])
def test_a_database_with_a_journal_is_an_error(tmp_path, suffix):
    path = convert_log(write_made(tmp_path / "x.mcap"), tmp_path / "db")
    path.with_name(path.name + suffix).write_bytes(b"x")
    with pytest.raises(InputError, match=f"was not closed, .*{suffix} has part of it"):
        open_log(str(path))
