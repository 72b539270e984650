"""Damaged files: intact frames are used, losses are reported, and no other error is raised."""

import os
import struct
import time
import tracemalloc
import zlib
from contextlib import closing
from functools import partial

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from jaxdet import io
from jaxdet.errors import JaxdetError, RescanError, TopicError
from jaxdet.io import LogOptions, mcap_scan, open_log
from jaxdet.io.chunks import MAGIC, RECORD_HEAD, ChunkHead, DamageError, chunk_records, decompress
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.store import ChunkStore
from tests.io_both_ways import is_indexed
from tests.io_helpers import Scene, assert_holds, make_scene, write_log

SCENE = make_scene(12)


def chunk_index(path):
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return sorted(summary.chunk_indexes, key=lambda item: item.chunk_start_offset)


def frames_right(log) -> int:
    """Return the number of valid frames with colour; assert that each equals the scene's."""
    count = 0
    for batch in log.batches(4, color=True):
        frames = batch.frames
        for row in np.flatnonzero(frames.valid):
            number = SCENE.depth_ns.tolist().index(frames.stamp_ns[row])
            np.testing.assert_array_equal(frames.depth[row], SCENE.depth[number])
            if frames.color_stamp_ns[row] >= 0:
                other = SCENE.color_ns.tolist().index(frames.color_stamp_ns[row])
                np.testing.assert_array_equal(frames.color[row], SCENE.color[other])
                count += number == other
    return count


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_truncated_file_gives_the_frames_before_the_end(tmp_path, compression):
    path = write_log(tmp_path / "x.mcap", SCENE, compression=compression, chunk_size=6000)
    whole, third = path.read_bytes(), chunk_index(path)[6]
    path.write_bytes(whole[: third.chunk_start_offset + 200])
    with open_log(str(path)) as log:
        text = log.description.integrity[0].text
        assert text.startswith("recovered:") and "no end of file" in text and "bytes lost" in text
        assert 3 <= frames_right(log) < 12


def test_the_error_for_no_images_names_the_damage(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(TopicError, match=r"no messages; .*; x.mcap is recovered: .* bytes lost"):
        open_log(str(path))


def test_chunks_larger_than_the_limit_are_reported(tmp_path):
    path = write_log(tmp_path / "x.mcap", make_scene(400), chunk_size=5 << 20)
    with pytest.raises(TopicError, match=r"larger than --log.max-chunk-mib \(1\)"):
        open_log(str(path), LogOptions(max_chunk_mib=1))


def test_any_truncation_gives_frames_or_a_clear_error(tmp_path):
    whole = write_log(tmp_path / "x.mcap", SCENE, chunk_size=6000).read_bytes()
    for size in np.random.default_rng(0).integers(0, len(whole), 40):
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        try:
            with open_log(str(tmp_path / "cut.mcap")) as log:
                frames_right(log)
        except JaxdetError as error:
            assert "\n" not in str(error)


def test_chunks_with_a_wrong_crc_are_dropped_and_their_neighbours_used(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE, compression="none", chunk_size=6000)
    data, chunks = bytearray(path.read_bytes()), chunk_index(path)
    damaged = chunks[3], chunks[5]
    for chunk in damaged:
        data[chunk.chunk_start_offset + 1500] ^= 4
    path.write_bytes(data)
    with open_log(str(path)) as log, pytest.raises(RescanError, match=r"CRC.*--log\.scan"):
        frames_right(log)
    with open_log(str(path), LogOptions(scan=True)) as log:
        [integrity] = log.description.integrity
        assert integrity.lost == {"chunk has a wrong CRC": 2} and integrity.recovered
        assert integrity.lost_bytes > sum(chunk.uncompressed_size for chunk in damaged)
        spans = tuple((chunk.message_start_time, chunk.message_end_time) for chunk in damaged)
        assert integrity.lost_spans_ns == spans
        assert 7 <= frames_right(log) < 12


def test_flipped_bits_are_always_reported_if_there_are_crcs(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE, chunk_size=6000)
    whole, end = path.read_bytes(), chunk_index(path)[-1]
    random = np.random.default_rng(1)
    for place in random.integers(8, end.chunk_start_offset + end.chunk_length, 60):
        data = bytearray(whole)
        data[place] ^= 1 << random.integers(8)
        path.write_bytes(data)
        try:
            with open_log(str(path)) as log:
                right = frames_right(log)
                assert right == 12 or log.description.integrity[0].recovered
            with open_log(str(path), LogOptions(scan=True)) as log:
                right = frames_right(log)
                assert right == 12 or log.description.integrity[0].recovered
        except JaxdetError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize("use_chunking", [True, False])
def test_flipped_bytes_without_crc_give_frames_or_a_clear_error(tmp_path, use_chunking):
    path = tmp_path / "x.mcap"
    options = {"compression": "none", "crc": False, "use_chunking": use_chunking}
    whole = write_log(path, SCENE, **options).read_bytes()
    random = np.random.default_rng(2)
    for _ in range(150):
        data = bytearray(whole)
        for place in random.integers(8, 9000, 3):
            data[place] = random.integers(256)
        path.write_bytes(data)
        try:
            with io.open_log(str(path)) as log:
                assert sum(len(batch.status) for batch in log.batches(5)) == log.num_frames
        except JaxdetError as error:
            assert "\n" not in str(error)


def test_a_record_with_a_damaged_length_is_skipped_with_the_index(tmp_path):
    path = write_log(tmp_path / "x.mcap", SCENE, chunk_size=6000)
    data, chunks = bytearray(path.read_bytes()), chunk_index(path)
    struct.pack_into("<Q", data, chunks[4].chunk_start_offset + 1, 2**64 - 1)
    path.write_bytes(data)
    with open_log(str(path)) as log:
        assert not is_indexed(log)  # the first messages revealed the damage
        assert "damaged or torn record" in log.description.integrity[0].lost
        assert 9 <= frames_right(log) < 12


def test_time_is_linear_in_the_number_of_damaged_lengths(tmp_path):
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=1)
        writer.start()
        channel = writer.register_channel("/x", "cdr", 0)
        for number in range(15_000):
            writer.add_message(channel, number, b"", number)
        writer.finish()
    data = bytearray((tmp_path / "x.mcap").read_bytes())
    chunks = chunk_index(tmp_path / "x.mcap")
    for chunk in chunks:
        struct.pack_into("<Q", data, chunk.chunk_start_offset + 1, 1 << 62)
    (tmp_path / "x.mcap").write_bytes(data)
    start = time.perf_counter()
    with pytest.raises(TopicError, match=f"damaged or torn record .{len(chunks)}."):
        open_log(str(tmp_path / "x.mcap"), LogOptions(scan=True))
    assert time.perf_counter() - start < 6


def test_losses_do_not_depend_on_reading_ahead(tmp_path, monkeypatch):
    path = write_log(tmp_path / "x.mcap", SCENE, compression="none", chunk_size=6000)
    data, chunks = bytearray(path.read_bytes()), chunk_index(path)
    starts = [chunk.chunk_start_offset for chunk in chunks]
    data[starts[2] + 1500] ^= 4
    struct.pack_into("<Q", data, starts[4] + 1, 2**64 - 1)
    data[starts[6] + 1500] ^= 4
    path.write_bytes(data)
    found = []
    for ahead in (0, 10_000, 1 << 30):
        monkeypatch.setattr(mcap_scan, "ChunkStore", partial(ChunkStore, cache_bytes=ahead))
        with open_log(str(path), LogOptions(scan=True)) as log:
            [integrity] = log.description.integrity
            found.append((integrity, integrity.text, log.stamps_ns.tolist(), frames_right(log)))
    assert found[0] == found[1] == found[2] and list(found[0][0].lost.values()) == [2, 1]


def test_a_missing_summary_loses_no_frames(tmp_path):
    options = {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False}
    path = write_log(tmp_path / "x.mcap", SCENE, **options, use_summary_offsets=False)
    with open_log(str(path)) as log:
        assert_holds(log, SCENE)
        assert log.description.integrity[0].text.startswith("CRC checked")
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(b"\x0f" + struct.pack("<Q", 4)) + 13])
    with open_log(str(path)) as log:
        assert_holds(log, SCENE)
        assert "no end of file" in log.description.integrity[0].text


def test_missing_crcs_are_reported_in_a_note(tmp_path):
    with open_log(str(write_log(tmp_path / "x.mcap", SCENE, crc=False))) as log:
        assert log.description.integrity[0].text == "not checkable (no CRC in file)"


def head(data: bytes, size: int, compression: str = "", crc: int = 0) -> ChunkHead:
    return ChunkHead(0, 0, size, crc, compression, 0, len(data))


def test_chunks_with_wrong_sizes_are_rejected():
    bomb = zstandard.compress(b"\0" * (1 << 26))
    with pytest.raises(DamageError, match="size that differs"):
        decompress(head(bomb, 100, "zstd"), bomb)
    with pytest.raises(DamageError, match="unknown"):
        decompress(head(b"x", 1, "bz2"), b"x")
    for compression in ("zstd", "lz4"):
        with pytest.raises(DamageError, match="decompressed"):
            decompress(head(b"junkjunk", 8, compression), b"junkjunk")
    good = b"abc"
    packed = {"": good, "zstd": zstandard.compress(good), "lz4": lz4.frame.compress(good)}
    for compression, data in packed.items():
        assert decompress(head(data, 3, compression), data) == good
        for size in (2, 4):
            with pytest.raises(DamageError, match="size that differs"):
                decompress(head(data, size, compression), data)
    assert decompress(head(good, 3, crc=zlib.crc32(good)), good) == good


@pytest.mark.parametrize("sizes", [(1 << 33, 8), (8, 1 << 25)])
def test_chunks_that_are_too_large_are_not_read(tmp_path, sizes):
    """The limit applies to the compressed and to the uncompressed size."""
    size, packed = sizes
    content = struct.pack("<QQQII4sQ", 0, 0, size, 0, 4, b"zstd", packed)
    record = struct.pack("<BQ", Opcode.CHUNK, len(content) + packed) + content
    path, place = tmp_path / "x.mcap", len(MAGIC) + RECORD_HEAD.size
    path.write_bytes(MAGIC + record)
    os.truncate(path, place + len(content) + packed)
    with closing(McapFile(path, 1 << 20)) as file:
        tracemalloc.start()
        try:
            with pytest.raises(DamageError, match=r"larger than --log\.max-chunk-mib"):
                file.chunk(place)
            assert tracemalloc.get_traced_memory()[1] < 100_000
        finally:
            tracemalloc.stop()


def test_records_beyond_the_end_of_their_chunk_are_dropped():
    good = struct.pack("<BQ", 5, 22) + b"\0" * 22
    for tail in (struct.pack("<BQ", 5, 10**6) + b"x", b"\5\1", b"\0" * 90):
        found = []
        with pytest.raises(DamageError):
            for record in chunk_records(good + tail):
                found.append(record)
        assert len(found) == 1
    flood = struct.pack("<BQ", 0x80, 0) * 5000
    with pytest.raises(DamageError):
        list(chunk_records(flood))


def test_the_error_for_a_large_chunk_names_the_flag(tmp_path):
    scene = make_scene(260)
    path = write_log(tmp_path / "x.mcap", scene, compression="none", chunk_size=1 << 22)
    with open_log(str(path)) as log:
        assert log.num_frames == 260
    with pytest.raises(TopicError, match=r"0 messages of .* chunk is larger than --log\.max-chunk"):
        open_log(str(path), LogOptions(max_chunk_mib=1))


@pytest.mark.parametrize(
    ("join", "warning"),
    [
        (lambda one, two: one + two, "bytes after the end of the recording are not read"),
        (lambda one, two: (one + two) * 200, "bytes after the end of the recording are not read"),
        (lambda one, two: one + b"x" * 99, "99 bytes after the end of the recording are not read"),
        (lambda one, two: one + MAGIC, "8 bytes after the end of the recording are not read"),
    ],
)
@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_bytes_after_the_end_are_reported(tmp_path, compression, join, warning):
    options = {"compression": compression, "chunk_size": 6000}
    parts = [Scene(*(values[rows] for values in SCENE)) for rows in (slice(0, 6), slice(6, 12))]
    files = [write_log(tmp_path / "x.mcap", part, **options).read_bytes() for part in parts]
    path = tmp_path / "x.mcap"
    path.write_bytes(join(*files))
    with open_log(str(path)) as log:
        assert frames_right(log) == log.num_frames == 6
        assert any(warning in text for text in log.description.warnings)
