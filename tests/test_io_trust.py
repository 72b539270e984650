"""Consistency of logs: index against content, changing files and calibrations, read errors."""

import errno
import os
import pickle
import shutil
import struct
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxdet.errors import FrameError, FrameStatus, InputError, JaxdetError, RescanError, printable
from jaxdet.io import LogOptions, container, find_logs, indexed, open_log
from jaxdet.io.chunks import DamageError
from jaxdet.io.declarations import ChannelInfo, Declarations
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.definition import bare_definition
from jaxdet.io.limits import ReadMemory
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.messages import TransformMessage
from jaxdet.io.opening import open_files
from jaxdet.io.transforms import TransformTree
from tests.fuzz.formats import write_format
from tests.fuzz.mutations import chunks, records
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_INFO,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_INFO,
    DEPTH_K,
    DEPTH_SIZE,
    SECOND,
    START,
    STORE,
    T_DEPTH_COLOR,
    LogFile,
    assert_holds,
    make_scene,
    ros_image,
    ros_info,
    ros_odometry,
    ros_tf,
    write_calibration,
    write_images,
    write_log,
)

SCENE = make_scene(8)


def drop(path: Path, item) -> None:
    """Remove a record from a file."""
    data = path.read_bytes()
    path.write_bytes(data[: item.start] + data[item.end :])


@pytest.mark.parametrize("name", ["raw", "zstd", "no_crc"])
def test_a_missing_chunk_is_reported_by_the_index(tmp_path, name):
    path = write_format(name, tmp_path / "x.mcap")
    drop(path, chunks(path.read_bytes())[2])
    with open_log(str(path)) as log:
        [file] = log.description.integrity
        assert log.num_frames < 8 and file.recovered
        assert file.lost["chunk of the index is missing"] == 1 and file.lost_bytes > 0
        assert file.missing[DEPTH] == 8 - log.num_frames and len(file.lost_spans_ns) == 1
        assert f"messages of {COLOR} missing" in " ".join(log.description.warnings)
        assert "missing messages can't" not in file.text


def test_missing_messages_are_reported_by_message_indexes(tmp_path):
    path = write_format("raw", tmp_path / "x.mcap")
    data = path.read_bytes()
    drop(path, chunks(data)[1])
    path.write_bytes(path.read_bytes()[:-500])  # without a summary
    with open_log(str(path)) as log:
        [file] = log.description.integrity
        assert file.missing and "missing messages can't be counted" in file.text


def test_an_unreadable_summary_is_reported(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE)
    data = bytearray(path.read_bytes())
    footer = len(data) - 8 - 20
    struct.pack_into("<Q", data, footer, 12345)
    end = next(item for item in records(bytes(data)) if item.opcode == 15)
    data[end.end + 20] ^= 255
    path.write_bytes(data)
    with open_log(str(path)) as log:
        assert any("missing messages can't be counted" in text for text in log.description.warnings)


def test_missing_checksums_are_reported_once(tmp_path):
    for number in range(2):
        part = make_scene(2)._replace(color_ns=SCENE.color_ns[2 * number :][:2])
        part = part._replace(depth_ns=SCENE.depth_ns[2 * number :][:2])
        write_log(tmp_path / f"x_{number}.mcap", part, crc=False)
    with open_log(str(tmp_path)) as log:
        expected = "no integrity check of 2 of 2 files, which have no CRCs"
        assert not log.description.warnings
        assert [text for text in log.description.notes if "joined" not in text] == [expected]


def test_a_chunk_missing_in_the_index_is_reported(tmp_path):
    """The chunk lies between two indexed chunks, and the statistics count it."""
    path = write_format("raw", tmp_path / "x.mcap")
    data = path.read_bytes()
    item = chunks(data)[3]
    path.write_bytes(data[: item.end] + data[item.start : item.end] + data[item.end :])
    with open_log(str(path)) as log:
        assert log.description.integrity[0].recovered
        assert any("occur twice" in text for text in log.description.warnings)


@pytest.mark.parametrize("scan", [False, True])
@pytest.mark.parametrize("how", ["grown", "cut", "emptied", "replaced", "rewritten", "removed"])
def test_a_file_that_changes_while_reading_is_an_error(tmp_path, how, scan):
    path = write_log(tmp_path / "x.mcap", SCENE, compression="none", chunk_size=6000)
    with open_log(str(path), LogOptions(scan=scan)) as log:
        log.read([0])
        size, data = path.stat().st_size, path.read_bytes()
        if how == "grown":
            path.write_bytes(data + b"x")
        elif how in ("cut", "emptied"):
            os.truncate(path, size // 2 if how == "cut" else 0)
        elif how == "replaced":
            (tmp_path / "new").write_bytes(data)
            (tmp_path / "new").replace(path)
        elif how == "removed":
            path.unlink()
        else:
            path.write_bytes(data[::-1])
            os.utime(path, ns=(1, 1))
        with pytest.raises(
            InputError, match="changed while it was read; wait until nothing writes to it"
        ):
            list(log.batches(2))


def test_a_file_that_changes_before_a_worker_opens_it_is_an_error(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE)
    with open_log(str(path)) as log:
        work = pickle.dumps(log)
        os.utime(path, ns=(1, 1))
        with pytest.raises(InputError, match="changed while it was read"):
            pickle.loads(work)


def test_a_file_truncated_while_scanning_is_an_error(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE, compression="none", chunk_size=6000)
    [source] = find_logs([str(path)])
    [file], _ = open_files(source, LogOptions(), ReadMemory())
    os.truncate(path, 5000)
    with pytest.raises(InputError, match="changed while it was read"):
        file.rebuild_index()
    file.close()


def test_a_topic_may_have_messages_of_several_types(tmp_path):
    path = tmp_path / "x.mcap"
    with LogFile(path, chunk_size=6000) as log:
        write_calibration(log)
        write_images(log, SCENE)
        log._channels.pop(DEPTH)
        for number in range(12):
            log.ros(DEPTH, ros_tf(("map", "x", *T_DEPTH_COLOR)), START + number)
    with open_log(str(path)) as log:
        assert_holds(log, SCENE)


def other_calibration(path: Path, changed: range, K: tuple[float, ...]) -> Path:
    """Write a log with a CameraInfo per depth image; those of ``changed`` have matrix ``K``."""
    with LogFile(path, chunk_size=9000) as log:
        write_calibration(log)
        for number in range(8):
            at = int(SCENE.depth_ns[number])
            part = SCENE._replace(**{k: v[number : number + 1] for k, v in SCENE._asdict().items()})
            used = K if number in changed else DEPTH_K
            log.ros(DEPTH_INFO, ros_info(DEPTH_SIZE, used, at, DEPTH_FRAME), at)
            write_images(log, part)
    return path


def test_frames_with_another_calibration_are_not_used(tmp_path):
    path = other_calibration(tmp_path / "x.mcap", range(4, 6), (60.0, 51.0, 15.5, 11.5))
    with open_log(str(path)) as log, pytest.raises(RescanError, match="the calibration changes"):
        list(log.batches(3))
    with open_log(str(path), LogOptions(scan=True)) as log:
        [batch] = log.batches(8)
        good, bad = FrameStatus.OK, FrameStatus.BAD_CALIBRATION
        assert batch.status == (good,) * 4 + (bad,) * 2 + (good,) * 2
        assert "calibration of this frame differs" in batch.errors[4]
        assert not batch.frames.depth[4:6].any()
        assert any("frames with another calibration" in t for t in log.description.warnings)


@pytest.mark.parametrize("part", [{"start": "1"}, {"every": 15}])
def test_a_calibration_that_changes_before_a_part_causes_a_scan(tmp_path, part):
    """The calibration is recorded only when it changes."""
    scene = make_scene(36)
    path = tmp_path / "x.mcap"
    with LogFile(path, chunk_size=9000) as log:
        write_calibration(log)
        write_images(log, scene)
        at = int(scene.color_ns[20])
        message = ros_info(DEPTH_SIZE, (60.0, 51.0, 15.5, 11.5), at, DEPTH_FRAME)
        log.ros(DEPTH_INFO, message, at)
    options = LogOptions(**part)
    with open_log(str(path), options) as log, pytest.raises(RescanError, match="calibration chan"):
        list(log.batches(3))


def test_empty_calibrations_are_ignored(tmp_path):
    path = other_calibration(tmp_path / "x.mcap", range(4, 6), (0.0, 0.0, 0.0, 0.0))
    with open_log(str(path)) as log:
        assert all(status is FrameStatus.OK for b in log.batches(3) for status in b.status)


def test_given_intrinsics_override_changing_calibrations(tmp_path):
    path = other_calibration(tmp_path / "x.mcap", range(4, 8), (60.0, 51.0, 15.5, 11.5))
    with open_log(str(path), LogOptions(depth_intrinsics=DEPTH_K)) as log:
        assert all(status is FrameStatus.OK for b in log.batches(3) for status in b.status)


def drive(path: Path, start: int, K: tuple[float, ...] = COLOR_K, count: int = 3) -> None:
    """Write a log that begins at the time ``start`` [ns]."""
    shift = start - START
    scene = make_scene(count)
    with LogFile(path) as log:
        log.ros(COLOR_INFO, ros_info(COLOR_SIZE, K, start, COLOR_FRAME), start)
        scene = scene._replace(color_ns=scene.color_ns + shift, depth_ns=scene.depth_ns + shift)
        write_images(log, scene)


def names_of(folder: Path) -> list[tuple[str, int]]:
    return [(log.name, len(log.paths)) for log in find_logs([str(folder)])]


def test_numbered_files_are_one_log_only_with_equal_calibrations_and_short_pauses(tmp_path):
    for number in range(3):
        drive(tmp_path / f"x_{number}.mcap", START + number * SECOND)
    assert names_of(tmp_path) == [("x", 3)]
    drive(tmp_path / "x_3.mcap", START + 3 * SECOND, (60.0, 51.0, 15.5, 11.5))
    drive(tmp_path / "x_4.mcap", START + 4 * SECOND, (60.0, 51.0, 15.5, 11.5))
    assert names_of(tmp_path) == [("x", 3), ("x_3", 2)]
    [first, second] = (log.about for log in find_logs([str(tmp_path)]))
    assert first.startswith("joined 3 files") and second.startswith("joined 2 files")
    why = "x_2.mcap and x_3.mcap are different recordings: "
    assert all(why in about and "another calibration" in about for about in (first, second))
    drive(tmp_path / "x_5.mcap", START + 9000 * SECOND, (60.0, 51.0, 15.5, 11.5))
    abouts = [log.about for log in find_logs([str(tmp_path)])]
    assert abouts[0] == first and abouts[1] == f"{second}; {abouts[2]}"
    assert "x_4.mcap and x_5.mcap are different recordings: they are" in abouts[2]


@pytest.mark.parametrize(
    ("start", "why"),
    [
        (-SECOND, "overlap in time"),
        (0, "overlap in time"),
        (SECOND // 40, ""),
        (100 * SECOND, " s apart"),
    ],
)
def test_splits_must_be_consecutive_in_time(tmp_path, start, why):
    drive(tmp_path / "x_1.mcap", START)
    drive(tmp_path / "x_2.mcap", START + (3 * SECOND if start < 0 else 0) + start)
    if start < 0:
        drive(tmp_path / "x_1.mcap", START + 5 * SECOND)
    logs = find_logs([str(tmp_path)])
    assert len(logs) == (2 if why else 1) and why in logs[0].about


def test_calibrations_of_other_recordings_are_not_used(tmp_path):
    with LogFile(tmp_path / "drive_1.mcap") as log:
        write_images(log, make_scene(3))
    drive(tmp_path / "drive_2.mcap", START + 100_000 * SECOND)
    with pytest.raises(JaxdetError, match="no calibration of the depth camera"):
        open_log(str(tmp_path / "drive_1.mcap"))


@pytest.mark.parametrize(
    ("t", "q", "why"),
    [
        ((1e14, 0, 0), (0, 0, 0, 1), "is implausible"),
        ((float("nan"), 0, 0), (0, 0, 0, 1), "is implausible"),
        ((0, float("nan"), 0), (0, 0, 0, 1), "is implausible"),
        ((0, 0, float("nan")), (0, 0, 0, 1), "is implausible"),
        ((0, 0, 0), (0, 0, 0, 0), "not of unit length"),
        ((0, 0, 0), (0, 0, 0, 1.1), "not of unit length"),
        ((0, 0, 0), (1e200, 0, 0, 0), "not of unit length"),
    ],
)
def test_implausible_poses_are_refused(t, q, why):
    def decoded(message: Any) -> Any:
        name = message.__msgtype__
        text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
        decoder = MessageDecoder(ChannelInfo("/t", "cdr", name, "ros2msg", text))
        return decoder.decode(bytes(STORE.serialize_cdr(message, name)))

    with pytest.raises(FrameError, match=why):
        decoded(ros_odometry("a", "b", t, q, START))
    bad, good = decoded(ros_tf(("a", "b", t, q), ("b", "c", (1, 2, 3), (0, 0, 0, 1))))
    assert why in bad.problem and not good.problem and good.translation == (1, 2, 3)


def test_the_number_of_tf_frames_is_limited():
    tree = TransformTree()
    chain = [
        TransformMessage(0, f"f{i}", f"f{i + 1}", (0, 0, 0), (0, 0, 0, 1)) for i in range(11_000)
    ]
    tree.add(chain, static=True)
    assert len(tree.frames) < 10_100 and "more than 10000 TF frames" in tree.warnings[0]
    assert tree.distance("f0", "f9000") == 9000


def test_names_are_escaped_everywhere(tmp_path):
    path = tmp_path / os.fsdecode(b"a\xff\x1b[31m\n.mcap")
    shutil.copy(write_log(tmp_path / "x.mcap", make_scene(2)), path)
    [log] = find_logs([str(path)])
    assert log.name == r"a\xff\x1b[31m\n" and log.paths == (path,)
    with open_log(log) as opened:
        about = opened.description
        assert opened.name == log.name
        assert all(text.isprintable() for text in (*about.warnings, about.name))
    path.write_bytes(b"x")
    with pytest.raises(InputError) as caught:
        open_log(log)
    assert str(caught.value).isprintable() and r"a\xff\x1b" in str(caught.value)


@given(st.text())
def test_printable_characters_are_kept_and_others_escaped(text):
    shown = printable(text)
    assert shown.isprintable() and shown.encode("utf-8").isascii() >= text.isascii()
    assert shown == text or not text.isprintable()


@given(st.binary(max_size=200))
def test_random_bytes_as_schemas_and_channels_are_errors_or_parsed(data):
    declared = Declarations()
    for add in (declared.add_schema, declared.add_channel):
        try:
            add(data)
        except DamageError:
            continue
    for number in declared.channels:
        assert declared.info(number) is not None


IMAGE = "sensor_msgs/msg/Image"
DECODER = MessageDecoder(
    ChannelInfo(
        "/i", "cdr", IMAGE, "ros2msg", STORE.generate_msgdef(IMAGE, ros_version=2)[0].encode()
    )
)
GOOD = bytes(STORE.serialize_cdr(ros_image(SCENE.color[0], "rgb8", START, COLOR_FRAME), IMAGE))


@given(st.binary(max_size=80), st.integers(0, 70))
def test_random_bytes_as_cdr_are_errors_or_decoded(data, place):
    for payload in (data, GOOD[:place] + data, GOOD[:place] + data + GOOD[place + len(data) :]):
        try:
            DECODER.decode(memoryview(payload))
            DECODER.stamp_ns(memoryview(payload))
        except FrameError as error:
            assert str(error).isprintable()


@pytest.mark.parametrize("seed", range(40))
def test_random_changes_of_the_index_are_errors_or_lose_no_frames(tmp_path, seed):
    """Summary and message indexes have wrong numbers, and their CRCs match."""
    path, random = write_format("raw", tmp_path / "x.mcap"), Random(seed)
    data = bytearray(path.read_bytes())
    places = [item for item in records(bytes(data)) if item.opcode in (7, 8, 11)]
    item = random.choice(places)
    form = random.choice(("<H", "<I", "<Q"))
    value = random.choice((0, 1, 0xFFFF, random.getrandbits(16)))
    value = value if form == "<H" else random.choice((value, 0xFFFFFFFF, random.getrandbits(32)))
    struct.pack_into(form, data, random.randrange(item.start + 9, item.end - 8), value)
    struct.pack_into("<I", data, len(data) - 12, 0)
    path.write_bytes(data)
    try:
        with open_log(str(path)) as log:
            frames = list(log.batches(3))
            assert sum(len(batch.status) for batch in frames) == log.num_frames
    except JaxdetError as error:
        assert str(error).isprintable()


def test_definitions_are_reduced_to_the_layout_of_fields():
    text = (
        "# a [m] comment\nuint8 A=1\nuint8[<=3] a 1 # b\nstring<=10 b\n====\nMSG: x/Y\nint8 c -1\n"
    )
    assert bare_definition(text) == "uint8[<=3] a\nstring<=10 b\n====\nMSG: x/Y\nint8 c"


@pytest.fixture
def fail(monkeypatch) -> Callable[..., list[float]]:
    """Return a function that makes the next reads fail, and returns a list of later waits [s]."""
    left, waited, number = 0, [], errno.EIO

    def flaky(call: Callable[..., Any]) -> Callable[..., Any]:
        def sometimes(*args: Any) -> Any:
            nonlocal left
            if left:
                left -= 1
                raise OSError(number, os.strerror(number))
            return call(*args)

        return sometimes

    def begin(count: int, error: int = errno.EIO) -> list[float]:
        nonlocal left, number
        left, number = count, error
        return waited

    for name in ("pread", "preadv"):
        monkeypatch.setattr(os, name, flaky(getattr(os, name)))
    monkeypatch.setattr(time, "sleep", waited.append)
    return begin


def test_temporary_read_errors_are_retried(tmp_path, fail):
    """Each read is tried four times, as a disk or file server may be absent for a moment."""
    path = write_log(tmp_path / "x.mcap", SCENE, compression="none", chunk_size=6000)
    with open_log(str(path)) as log:
        want, waited = list(log.batches(3)), fail(0)
        found = []
        for batch in log.batches(3):
            found.append(batch)
            fail(3)
    assert waited[:3] == [0.1, 0.5, 2.0] and len(waited) >= 6
    for one, other in zip(found, want, strict=True):
        assert one.status == other.status == (FrameStatus.OK,) * len(one.status)
        assert (one.frames.color_stamp_ns == other.frames.color_stamp_ns).all()
        assert (one.frames.depth == other.frames.depth).all()


def test_permanent_read_errors_are_not_retried_at_each_position(tmp_path, fail):
    path = write_log(tmp_path / "x.mcap", SCENE)
    file = McapFile(path, 1 << 20)
    waited = fail(1 << 20)
    for _ in range(100):
        with pytest.raises(DamageError, match="file can't be read"):
            file.read(0, 8)
    assert 20 < sum(waited) <= 30
    file.close()


def test_only_temporary_errors_are_retried(tmp_path, fail):
    file = McapFile(write_log(tmp_path / "x.mcap", SCENE), 1 << 20)
    for error in (errno.EACCES, errno.EISDIR, errno.EBADF):
        waited = fail(1, error)
        with pytest.raises(DamageError, match="file can't be read"):
            file.read(0, 8)
    assert not waited and file.read(0, 8) == file.magic
    file.close()


def test_partial_reads_are_continued_and_errors_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(container, "_WAITS_S", ())
    path = write_log(tmp_path / "x.mcap", SCENE, compression="none", chunk_size=6000)
    plain, plain_into, failing = os.pread, os.preadv, False

    def some(descriptor: int, size: int, position: int) -> bytes:
        return plain(descriptor, min(size, 1000), position)

    def some_into(descriptor: int, parts: list[memoryview], position: int) -> int:
        if failing:
            raise OSError(5, "Input/output error")
        return plain_into(descriptor, [parts[0][:1000]], position)

    monkeypatch.setattr(os, "pread", some)
    monkeypatch.setattr(os, "preadv", some_into)
    with open_log(str(path)) as log:
        assert all(status is FrameStatus.OK for b in log.batches(3) for status in b.status)
    with open_log(str(path), LogOptions(scan=True)) as log:
        failing = True
        statuses = [status for b in log.batches(3) for status in b.status]
        assert FrameStatus.DECODE_ERROR in statuses and len(statuses) == 8


def test_video_is_refused_with_its_format(tmp_path):
    with LogFile(tmp_path / "x.mcap") as log:
        log.json("/cam/color/video", "foxglove.CompressedVideo", {"data": ""}, START)
    with pytest.raises(JaxdetError, match=r"/cam/color/video \(foxglove.CompressedVideo\)"):
        open_log(str(tmp_path / "x.mcap"))


@pytest.mark.parametrize("bad", [(20, 30), (1, 30)], ids=["later", "looked_at"])
def test_undecodable_transforms_are_counted(tmp_path, monkeypatch, bad):
    """If such transforms are not read when the log is opened, the log is scanned."""
    monkeypatch.setattr(indexed, "_MAX_MOTIONS", 0)
    monkeypatch.setattr(indexed, "FIRST_MOTIONS", 4)
    monkeypatch.setattr(indexed, "_MOTION_SAMPLE", 2)
    path, scene = tmp_path / "x.mcap", make_scene(40)
    text = STORE.generate_msgdef("tf2_msgs/msg/TFMessage", ros_version=2)[0].encode()
    with LogFile(path) as log:
        write_calibration(log)
        for number, at in enumerate(scene.color_ns.tolist()):
            log.ros("/tf", ros_tf(("odom", "color_optical", (1, 0, 0), (0, 0, 0, 1))), at)
            if number in bad:
                kind = "tf2_msgs/msg/TFMessage", "ros2msg", text
                log.raw("/tf", "cdr", kind, b"\0\1\0\0\xff\xff\xff\x0f", at)
        write_images(log, scene)
    if bad[0] > 4:
        text = "of /tf can't be decoded"
        with open_log(str(path)) as log, pytest.raises(RescanError, match=text):
            list(log.batches(8))
    with open_log(str(path), LogOptions(scan=bad[0] > 4)) as log:
        expected = "/tf: 2 of 42 messages can't be decoded"
        assert any(expected in text for text in log.description.warnings)
