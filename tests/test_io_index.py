"""Logs opened by their index: equal to a scan, or an error that causes a scan."""

import pickle
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType

from jaxdet.cli import info
from jaxdet.errors import RescanError
from jaxdet.io import Batch, LogOptions, indexed, reading, windows
from jaxdet.io import log as log_module
from jaxdet.io import open_log as open_only
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.store import ChunkStore
from jaxdet.io.timeline import total
from tests.io_both_ways import assert_same_batch, assert_same_log, is_indexed, scanning
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    DEPTH,
    DEPTH_FRAME,
    SECOND,
    START,
    STORE,
    LogFile,
    make_scene,
    ros_image,
    ros_odometry,
    ros_tf,
    write_calibration,
    write_log,
)

MS = 1_000_000
NO_TURN = (0.0, 0.0, 0.0, 1.0)
LEVEL = (-0.5, 0.5, -0.5, 0.5)
"""Quaternion of a camera that looks ahead."""


class Sender:
    """Writer of images that repeat three pictures with new timestamps."""

    def __init__(self, log: LogFile) -> None:
        scene = make_scene(3)
        self.log = log
        self.images = {
            COLOR: [ros_image(item, "rgb8", 0, COLOR_FRAME) for item in scene.color],
            DEPTH: [ros_image(item, "16UC1", 0, DEPTH_FRAME) for item in scene.depth],
        }
        self.known: dict[tuple[str, int], tuple[tuple[str, str, bytes], bytes]] = {}

    def image(self, topic: str, number: int, stamp_ns: int, log_ns: int) -> None:
        key = topic, number % 3
        if key not in self.known:
            message = self.images[topic][number % 3]
            name = message.__msgtype__
            text = STORE.generate_msgdef(name, ros_version=2)[0].encode()
            data = bytes(STORE.serialize_cdr(message, name))
            self.known[key] = (name, "ros2msg", text), data
        schema, data = self.known[key]
        stamp = struct.pack("<iI", *divmod(stamp_ns, SECOND))
        self.log.raw(topic, "cdr", schema, data[:4] + stamp + data[12:], log_ns)


def random_images(random: np.random.Generator) -> list[tuple[int, str, int, int]]:
    """Return log time, topic, number and timestamp of images, with jitter, gaps and duplicates."""
    count, period = int(random.integers(1, 70)), int(random.choice([10, 33, 100])) * MS
    events: list[tuple[int, str, int, int]] = []
    for topic, offset in ((COLOR, 0), (DEPTH, int(random.integers(-40, 40)) * MS)):
        stamps = START + SECOND + np.arange(count) * period + offset
        stamps += random.integers(-4, 5, count) * MS * int(random.integers(0, 4))
        kept = random.random(count) > random.choice([0, 0.1, 0.5])
        kept[0] = True
        if random.random() < 0.3:
            stamps[count // 2 :] += int(random.integers(0, 5)) * SECOND
        if random.random() < 0.3:
            doubled = stamps[:: int(random.integers(2, 7))]
            doubled -= doubled % (50 * MS)
        delay = random.integers(0, 30, count) * MS * int(random.integers(0, 3))
        for i in np.flatnonzero(kept).tolist():
            events.append((int(stamps[i] + delay[i]), topic, i, int(stamps[i])))
    return events


def random_events(random: np.random.Generator) -> list[tuple[int, str, int, int]]:
    """Return images and poses, partly out of the order of log times."""
    events = random_images(random)
    last = max(event[0] for event in events) + SECOND
    for at in range(START, last, int(random.choice([5, 20, 300, 1500])) * MS):
        events.append((at + int(random.integers(0, 30)) * MS, "/tf", 0, at))
    for at in range(START, last, 400 * MS):
        events.append((at, "/tf slow", 0, at))
        events.append((at + 3 * MS, "/odom", 0, at))
    events.sort()
    if random.random() < 0.3:
        for i in range(0, len(events) - 3, 5):
            events[i], events[i + 2] = events[i + 2], events[i]
    return events


def write_random(path: Path, seed: int) -> LogOptions:
    """Write a log of random events in a random form; return options for it."""
    random = np.random.default_rng(seed)
    events = random_events(random)
    compression = str(random.choice(["none", "lz4", "zstd"]))
    chunk_size, crc = int(random.choice([500, 5000, 60_000])), bool(random.random() < 0.7)
    with LogFile(path, compression, crc, chunk_size=chunk_size) as log:
        sender = Sender(log)
        write_calibration(log)
        edge = "base_link", DEPTH_FRAME, (0.1, 0, 0.3), NO_TURN
        log.ros("/tf_static", ros_tf(edge), START)
        for log_ns, topic, number, stamp in events:
            x = (stamp - START) / SECOND
            if topic in (COLOR, DEPTH):
                sender.image(topic, number, stamp, log_ns)
            elif topic == "/odom":
                message = ros_odometry("odom", "base_link", (x, x * x, 0), NO_TURN, stamp)
                log.ros(topic, message, log_ns)
            else:
                slow = topic == "/tf slow"
                edge = ("map", "odom") if slow else ("odom", "base_link")
                edges = [(*edge, (np.sin(x) if slow else x, 1, 0), NO_TURN)]
                edges.append(("base_link", "wheel", (1, 2, 3), NO_TURN))
                log.ros("/tf", ros_tf(*edges, stamp_ns=stamp), log_ns)
    odom = "/odom" if random.random() < 0.3 else None
    tolerance = float(random.choice([0, 0.004, 0.03, 0.15, 2.0]))
    return LogOptions(pair_tolerance_s=tolerance, odom=odom)


def test_random_logs_are_equal_by_index_and_by_scan(tmp_path, monkeypatch):
    """Transforms are read when a log is opened by its index or, if there are more than a maximum,
    together with the frames near them; the maximum is the default or 0.
    """
    monkeypatch.setattr(windows, "_BESIDE", 1)
    path, same = tmp_path / "x.mcap", dict.fromkeys((indexed._MAX_MOTIONS, 0), 0)
    for seed in range(16):
        options = write_random(path, seed)
        with open_only(str(path), scanning(options)) as scanned:
            for most in same:
                monkeypatch.setattr(indexed, "_MAX_MOTIONS", most)
                with suppress(RescanError), open_only(str(path), options) as found:
                    if is_indexed(found):
                        assert_same_log(found, scanned, (3, 16))
                        same[most] += 1
    assert min(same.values()) >= 10, same


def long_log(path: Path, count: int = 60, **options: object) -> Path:
    """Write a log whose later messages are not read when it is opened."""
    return write_log(path, make_scene(count), chunk_size=4000, **options)


def chunks_of(path: Path) -> list:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda item: item.chunk_start_offset)


def flip(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


def read_all(log) -> list:
    return list(log.batches(7, color=True))


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_opening_reads_little_and_each_chunk_is_read_once(tmp_path, monkeypatch, compression):
    path = long_log(tmp_path / "x.mcap", 400, compression=compression)
    size, read, chunks = path.stat().st_size, [], []
    plain_read, plain_into, plain_chunk = McapFile.read, McapFile.read_into, McapFile.chunk

    def counted(file, position, size):
        read.append(size)
        return plain_read(file, position, size)

    def counted_into(file, position, memory):
        read.append(len(memory))
        plain_into(file, position, memory)

    def counted_chunk(file, position):
        chunks.append(position)
        return plain_chunk(file, position)

    # As for large images, few are read at once, and few chunks are kept.
    monkeypatch.setattr(log_module, "_BYTES_AT_ONCE", 2 * 5136)
    monkeypatch.setattr(ChunkStore.__init__, "__defaults__", (1, 1, 1 << 30))
    monkeypatch.setattr(McapFile, "read", counted)
    monkeypatch.setattr(McapFile, "read_into", counted_into)
    monkeypatch.setattr(McapFile, "chunk", counted_chunk)
    with open_only(str(path)) as log:
        assert is_indexed(log) and sum(read) < 0.15 * size
        read.clear()
        chunks.clear()
        assert sum(batch.frames.valid.sum() for batch in log.batches(16)) == 400
        assert sum(read) < (1.4 if compression == "none" else 1.2) * size
    if compression != "none":
        assert len(chunks) <= len(set(chunks)) + 2


@pytest.mark.parametrize("size", [1, 5, 16])
def test_the_number_of_frames_read_together_has_no_influence(tmp_path, monkeypatch, size):
    path = str(long_log(tmp_path / "x.mcap", 90, compression="none"))
    found, looked_at = [], []
    plain = windows.IndexedFrames.window

    def counted(frames, start, stop):
        looked_at.append(stop - start)
        return plain(frames, start, stop)

    monkeypatch.setattr(windows.IndexedFrames, "window", counted)
    for together in (1, 40, 256):
        monkeypatch.setattr(log_module, "_LOOKED_AT", together)
        looked_at.clear()
        with open_only(path) as log:
            batches = list(log.batches(size, 3, 88, color=True))
        assert max(looked_at) == min(85, max(1, together // size) * size)
        parts = [batch.without_images() for batch in batches]
        images = [
            np.concatenate([getattr(b.frames, name)[: len(b.status)] for b in batches])
            for name in ("depth", "color")
        ]
        found.append((Batch.joined(parts), images))
    for batch, images in found[1:]:
        np.testing.assert_equal(batch._replace(decoding_s=0), found[0][0]._replace(decoding_s=0))
        np.testing.assert_equal(images, found[0][1])


@pytest.mark.parametrize("apart", [1, windows.REACH - 1, windows.REACH, 30])
def test_timestamps_out_of_order_are_sorted_or_cause_a_scan(tmp_path, apart):
    with LogFile(tmp_path / "x.mcap", chunk_size=9000) as log:
        write_calibration(log)
        sender = Sender(log)
        order = list(range(80))
        order.insert(20 + apart, order.pop(20))
        for place, number in enumerate(order):
            stamp, at = START + number * 33 * MS, START + place * 33 * MS
            sender.image(DEPTH, place, START + place * 33 * MS, at)
            sender.image(COLOR, place, stamp, at)
    path = str(tmp_path / "x.mcap")
    with open_only(path) as log, open_only(path, LogOptions(scan=True)) as scanned:
        assert is_indexed(log)
        if apart < windows.REACH:
            assert_same_log(log, scanned)
            return
        for size in (1, 7, 100):
            with pytest.raises(RescanError, match=r"header timestamps.*--log\.scan"):
                list(log.batches(size))
        assert_same_batch(log.read([70]), scanned.read([70]))


@pytest.mark.parametrize("ahead_s", [0.4, 0.0, -1.0, 3.3])
def test_offsets_between_clocks_are_applied(tmp_path, ahead_s):
    """Timestamps of depth are from another clock than those of colour."""
    ahead_ns = round(ahead_s * SECOND)
    with LogFile(tmp_path / "x.mcap", chunk_size=9000) as log:
        write_calibration(log)
        sender = Sender(log)
        for number in range(200):
            at = START + number * 33 * MS
            sender.image(DEPTH, number, at + ahead_ns, at + 5 * MS)
            sender.image(COLOR, number, at, at + 9 * MS)
    path = str(tmp_path / "x.mcap")
    other = abs(ahead_s) > 0.5
    with open_only(path) as log, open_only(path, LogOptions(scan=True)) as scanned:
        assert_same_log(log, scanned)
        apart = log.color_stamps_ns + ahead_ns - log.stamps_ns
        assert (np.abs(apart) <= 33 * MS).all() == (other or not ahead_s)
        assert any("--log.color-offset-s 0" in text for text in log.description.notes) == other
    given = LogOptions(color_offset_s=-ahead_s)
    with open_only(path, given) as log:
        assert (log.color_stamps_ns + ahead_ns == log.stamps_ns).all()
        assert not any("offset" in text for text in log.description.notes)
        assert not log.description.warnings
    with open_only(path) as log:
        text = "its timestamps are 0.40 s behind depth's"
        assert any(text in item for item in log.description.warnings) == (ahead_s == 0.4)


@pytest.mark.parametrize("late", [COLOR, DEPTH])
def test_images_that_are_recorded_late_are_paired(tmp_path, late):
    """The recorder receives one stream 0.4 s later than the other, a dozen images."""
    path, stamps = str(tmp_path / "x.mcap"), range(START, START + 200 * 33 * MS, 33 * MS)
    delay = {COLOR: 0, DEPTH: 0, late: 400 * MS}
    with LogFile(tmp_path / "x.mcap", chunk_size=9000) as log:
        write_calibration(log)
        sender = Sender(log)
        for at, topic, stamp in sorted(
            (s + delay[t], t, s) for s in stamps for t in (COLOR, DEPTH)
        ):
            sender.image(topic, stamp // MS, stamp, at)
    with open_only(path) as log, open_only(path, LogOptions(scan=True)) as scanned:
        assert is_indexed(log)
        assert_same_log(log, scanned)
        assert (log.color_stamps_ns == log.stamps_ns).all()


@pytest.mark.parametrize("field", ["log time", "offset", "count", "channel", "opcode", "summary"])
def test_a_wrong_index_causes_a_scan(tmp_path, field):
    path = long_log(tmp_path / "x.mcap", 60, compression="lz4")
    chunk = chunks_of(path)[40]
    place = chunk.chunk_start_offset + chunk.chunk_length
    at = {"log time": 15 + 1, "offset": 15 + 8, "count": 11, "channel": 9, "opcode": 0}
    if field == "summary":
        place, at[field] = path.stat().st_size - 200, 0
    flip(path, place + at[field])
    with open_only(str(path), LogOptions(scan=True)) as scanned, open_only(str(path)) as log:
        try:
            batches = read_all(log)
        except RescanError as error:
            assert is_indexed(log) and "\n" not in str(error)
        else:
            assert not is_indexed(log)
            for one, other in zip(batches, read_all(scanned), strict=True):
                assert_same_batch(one, other)
        assert scanned.num_frames == 60


@pytest.mark.parametrize("place", [0, 1, 45])
def test_a_damaged_head_of_a_chunk_causes_a_scan(tmp_path, place):
    """Opcode, length and size of the records of a chunk."""
    path = long_log(tmp_path / "x.mcap", 60, compression="lz4")
    flip(path, chunks_of(path)[40].chunk_start_offset + place)
    with open_only(str(path), LogOptions(scan=True)) as scanned, open_only(str(path)) as log:
        assert not is_indexed(log)
        for one, other in zip(read_all(log), read_all(scanned), strict=True):
            assert_same_batch(one, other)


def test_a_file_without_chunk_indexes_is_opened_by_its_message_indexes(tmp_path):
    path = long_log(tmp_path / "x.mcap", index_types=IndexType.MESSAGE)
    with open_only(str(path)) as log:
        assert is_indexed(log) and log.num_frames == 60


@pytest.mark.parametrize("damaged", [COLOR, "/tf", DEPTH])
def test_damage_of_chunks_that_are_not_decoded_causes_a_scan(tmp_path, damaged):
    """Only a scan drops damaged chunks; chunks with colour only may be damaged."""
    path = tmp_path / "x.mcap"
    with LogFile(path, compression="none", chunk_size=1) as log:
        write_calibration(log)
        sender = Sender(log)
        for i in range(60):
            at = START + i * SECOND
            sender.image(COLOR, i, at, at)
            if i < 40:
                sender.image(DEPTH, i, at, at)
            log.ros("/tf", ros_tf(("odom", DEPTH_FRAME, (i, 0, 0), LEVEL), stamp_ns=at), at)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
    [channel] = [key for key, item in summary.channels.items() if item.topic == damaged]
    mine = [item for item in chunks_of(path) if channel in item.message_index_offsets]
    with open_only(str(path)) as log:
        assert is_indexed(log)
        whole = read_all(log)
    chunk = mine[30 if damaged == COLOR else -1]
    flip(path, chunk.chunk_start_offset + chunk.chunk_length - 8)
    with open_only(str(path)) as log:
        if damaged == COLOR:
            for one, other in zip(log.batches(7), whole, strict=True):
                np.testing.assert_array_equal(one.frames.depth, other.frames.depth)
                np.testing.assert_array_equal(one.nearest_color_ns, other.nearest_color_ns)
        with pytest.raises(RescanError, match="CRC"):
            read_all(log)


def test_a_log_sent_to_a_worker_does_not_read_the_index_again(tmp_path, monkeypatch):
    path = long_log(tmp_path / "x.mcap", 60)
    with open_only(str(path)) as log:
        expected = read_all(log)
        sent = pickle.dumps(log)
    monkeypatch.setattr(McapFile, "read_index", None)
    with pickle.loads(sent) as log:
        for one, other in zip(read_all(log), expected, strict=True):
            assert_same_batch(one, other)


def test_pixels_read_in_place_equal_decoded_ones(tmp_path, monkeypatch):
    for compression in ("none", "lz4"):
        path = long_log(tmp_path / "x.mcap", 20, compression=compression)
        with open_only(str(path)) as log, open_only(str(path)) as other:
            found = read_all(log)
            with monkeypatch.context() as patch:
                patch.setattr(reading, "is_standard_image", lambda channel: False)
                for one, two in zip(found, read_all(other), strict=True):
                    assert_same_batch(one, two)


def test_notes_of_batches_add_up_for_any_batch_size(tmp_path):
    for seed in range(8):
        options = write_random(tmp_path / "x.mcap", seed)
        with open_only(str(tmp_path / "x.mcap"), options) as log:
            if not is_indexed(log):
                continue
            try:
                totals = [
                    str(log.described(total(batch.notes for batch in log.batches(size))))
                    for size in (1, 5, 100)
                ]
            except RescanError:
                continue
            assert totals[0] == totals[1] == totals[2]


def test_transforms_that_change_late_or_are_rare_are_not_taken_for_constant(tmp_path, monkeypatch):
    """A sample of the transforms would show them as constant, or one of them only once."""
    monkeypatch.setattr(indexed, "_MAX_MOTIONS", 10)
    monkeypatch.setattr(indexed, "FIRST_MOTIONS", 4)
    monkeypatch.setattr(indexed, "_MOTION_SAMPLE", 3)
    for moves, frame in ((False, "odom"), (True, "odom"), (True, "map")):
        with LogFile(tmp_path / "x.mcap", chunk_size=9000) as log:
            write_calibration(log)
            sender = Sender(log)
            for i in range(400):
                at = START + i * 100 * MS
                sender.image(DEPTH, i, at, at)
                sender.image(COLOR, i, at, at)
                x = 1.0 + (moves and i in (201, 203))
                edges = [(frame, DEPTH_FRAME, (x, 0, 0), NO_TURN)]
                if i == 204:
                    edges.append(("world", frame, (x, 0, 0), NO_TURN))
                log.ros("/tf", ros_tf(*(edges if i != 204 or moves else edges[:1])), at)
        path = str(tmp_path / "x.mcap")
        with open_only(path) as log, open_only(path, LogOptions(scan=True)) as scanned:
            if not moves:
                assert is_indexed(log)
                assert_same_log(log, scanned)
            else:
                with pytest.raises(RescanError):
                    read_all(log)
                assert scanned.T_world_camera is not None


def test_opening_intact_logs_never_scans(tmp_path):
    for options in ({}, {"compression": "none"}, {"crc": False}, {"chunk_size": 3000}):
        with open_only(str(write_log(tmp_path / "x.mcap", make_scene(20), **options))) as log:
            assert is_indexed(log)


def test_info_counts_pairs_if_the_flag_check_is_given(tmp_path, capsys):
    path = str(write_log(tmp_path / "x.mcap", make_scene(20), chunk_size=6000))
    assert info.main([path]) == 0
    text = capsys.readouterr().out
    assert "20 frames" in text and "not counted; pass --check to count" in text
    assert info.main([path, "--check"]) == 0
    text = capsys.readouterr().out
    assert "colour for all 20 frames, up to 4.0 ms apart" in text
    assert "CRC checked in" in text
