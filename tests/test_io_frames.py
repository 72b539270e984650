"""Unreadable frames, wrong timestamps, and bounded memory."""

import gc
import tracemalloc
import weakref
from functools import partial

import numpy as np
import pytest

from jaxdet.errors import CalibrationError, RescanError, TopicError
from jaxdet.io import LogOptions, mcap_scan, open_log, opening, store
from jaxdet.io import log as log_module
from jaxdet.io.chunks import DamageError
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.store import ChunkStore
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
    Scene,
    assert_holds,
    make_scene,
    ros_image,
    ros_info,
    ros_tf,
    write_calibration,
    write_images,
    write_log,
)

BAD = ["ok"] * 4 + ["decode_error", "bad_calibration", "ok"]


@pytest.fixture(params=[False, True], ids=["index", "scan"])
def bad_log(tmp_path, request):
    """Return a log with bad colour in frames 1 and 2, none in 3, bad depth in 4 and 5."""
    scene = make_scene(7)
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log)
        for i, (color, depth, at, depth_at) in enumerate(zip(*scene, strict=True)):
            pixels, encoding = (color[:-1] if i == 1 else color), "of_mars" if i == 2 else "rgb8"
            if i != 3:
                log.ros(COLOR, ros_image(pixels, encoding, int(at), COLOR_FRAME), int(at))
            pixels = depth[:-1] if i == 5 else depth
            image = ros_image(pixels, "16UC1", int(depth_at), DEPTH_FRAME)
            image.data = image.data[: -9 if i == 4 else None]
            log.ros(DEPTH, image, int(depth_at))
    options = LogOptions(pair_tolerance_s=0.01, scan=request.param)
    with open_log(str(tmp_path / "log.mcap"), options) as log:
        yield log, scene


def statuses(batch):
    assert [bool(error) for error in batch.errors] == [status != "ok" for status in batch.status]
    assert not any("\n" in error for error in batch.errors)
    assert batch.frames.valid.tolist()[: len(batch.status)] == [s == "ok" for s in batch.status]
    return [str(status) for status in batch.status]


def test_bad_frames_have_their_status_and_the_others_are_read(bad_log):
    log, scene = bad_log
    [batch] = log.batches(8)
    assert statuses(batch) == BAD and batch.frames.color is None
    stamps = np.where(np.arange(8) == 3, -1, np.append(scene.color_ns, -1))
    np.testing.assert_array_equal(batch.frames.color_stamp_ns, stamps)
    np.testing.assert_array_equal(batch.nearest_color_ns, stamps[:7])
    assert not batch.notes.bad_color and not batch.frames.depth[4:6].any()


def test_bad_colour_is_only_reported_in_a_note(bad_log):
    log, scene = bad_log
    [batch] = log.batches(8, color=True)
    assert statuses(batch) == BAD and not batch.frames.color[1:4].any()
    good = [0, 1, 2, 3, 6]
    np.testing.assert_array_equal(batch.frames.depth[good], scene.depth[good])
    np.testing.assert_array_equal(batch.frames.color[[0, 6]], scene.color[[0, 6]])
    stamps = np.where(np.isin(np.arange(8), [1, 2, 3]), -1, np.append(scene.color_ns, -1))
    np.testing.assert_array_equal(batch.frames.color_stamp_ns, stamps)
    about = log.described(batch.notes)
    assert batch.notes.bad_color == 2 and about.pairing.num_with_color == 6
    assert any(text.startswith("2 colour images can't be decoded: ") for text in about.notes)
    assert "colour missing for 1 of 7 frames" in " ".join(about.notes)


def test_bad_colour_loses_frames_if_colour_is_required(bad_log):
    log, scene = bad_log
    [batch] = log.batches(8, color=True, need_color=True)
    assert statuses(batch) == ["ok", *["no_color"] * 3, *BAD[4:]]
    np.testing.assert_array_equal(batch.frames.depth[:4], scene.depth[:4])
    assert "no colour image within 0.01 s" in batch.errors[3]


def repeated(image, scale):
    return image.repeat(scale, 0).repeat(scale, 1)


@pytest.mark.parametrize("infos", [1, 9])
@pytest.mark.parametrize("odd", [1, 3])
@pytest.mark.parametrize("of_depth", [False, True])
def test_first_frames_of_another_size_do_not_affect_the_others(tmp_path, odd, infos, of_depth):
    scene = make_scene(12)
    with LogFile(tmp_path / "log.mcap") as log:
        log.ros("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, *T_DEPTH_COLOR)), START)
        for i, (color, depth, at, depth_at) in enumerate(zip(*scene, strict=True)):
            scale = 2 if i < odd else 1
            scales = (1, scale) if of_depth else (scale, 1)
            for topic, size, K, frame, n in (
                (COLOR_INFO, COLOR_SIZE, COLOR_K, COLOR_FRAME, scales[0]),
                (DEPTH_INFO, DEPTH_SIZE, DEPTH_K, DEPTH_FRAME, scales[1]),
            ):
                values = tuple(np.multiply(size, n).tolist()), tuple(np.multiply(K, n).tolist())
                for _ in range(infos):
                    log.ros(topic, ros_info(*values, int(depth_at), frame), int(depth_at))
            image = ros_image(repeated(color, scales[0]), "rgb8", int(at), COLOR_FRAME)
            log.ros(COLOR, image, int(at))
            image = ros_image(repeated(depth, scales[1]), "16UC1", int(depth_at), DEPTH_FRAME)
            log.ros(DEPTH, image, int(at))
    with open_log(str(tmp_path / "log.mcap"), LogOptions(scan=True)) as log:
        (batch,) = log.batches(12, color=True)
        bad = "bad_calibration" if of_depth else "ok"
        assert batch.status == (bad,) * odd + ("ok",) * (12 - odd)
        assert batch.frames.color is not None
        np.testing.assert_array_equal(batch.frames.color[odd:], scene.color[odd:])
        np.testing.assert_array_equal(batch.frames.depth[odd:], scene.depth[odd:])
        (text,) = (text for text in log.description.warnings if "changes" in text)
        if of_depth:
            assert "frames with another calibration are skipped" in text
        else:
            assert "boxes and pictures of later frames may be misplaced" in text
            assert not batch.frames.color[:odd].any() and batch.notes.bad_color == odd
        calibration = log.calibration
    with open_log(str(tmp_path / "log.mcap")) as log:
        assert log.calibration == calibration


def test_errors_name_the_image_that_was_not_decoded(tmp_path):
    with LogFile(tmp_path / "log.mcap") as log:
        info = ros_info(COLOR_SIZE, COLOR_K, START, COLOR_FRAME)
        name = info.__msgtype__
        schema = name, "ros2msg", STORE.generate_msgdef(name, ros_version=2)[0].encode()
        log.raw(COLOR_INFO, "cdr", schema, bytes(STORE.serialize_cdr(info, name))[:60], START)
        write_images(log, make_scene())
    with pytest.raises(CalibrationError, match="/cam/color/camera_info: 1 of 1 messages can't"):
        open_log(str(tmp_path / "log.mcap"))


@pytest.mark.parametrize("encoding", ["of_mars", "8UC2", "32FC3"])
def test_unsupported_encodings_are_named(tmp_path, encoding):
    scene = make_scene(2)
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log)
        for color, depth, at in zip(scene.color, scene.depth, scene.color_ns.tolist(), strict=True):
            log.ros(COLOR, ros_image(color[..., 0], encoding, at, COLOR_FRAME), at)
            log.ros(DEPTH, ros_image(depth, "16UC1", at, DEPTH_FRAME), at)
    with open_log(str(tmp_path / "log.mcap")) as log:
        assert not log.has_color and f"unsupported: '{encoding}' of {COLOR}; " in log.color_problem
        assert any(f"'{encoding}' of {COLOR}" in text for text in log.description.notes)
        np.testing.assert_array_equal(log.read([0, 1], color=True).frames.depth, scene.depth)
    with pytest.raises(TopicError, match=f"encoding '{encoding}' is not a supported colour"):
        open_log(str(tmp_path / "log.mcap"), LogOptions(color=COLOR))
    with pytest.raises(
        TopicError, match=rf"{DEPTH}: the topic has depth images .*change --log.color"
    ):
        open_log(str(tmp_path / "log.mcap"), LogOptions(color=DEPTH))


def test_zero_timestamps_are_replaced_by_log_times_and_frames_are_sorted(tmp_path):
    scene = make_scene(3)
    with LogFile(tmp_path / "zero.mcap") as log:
        write_calibration(log)
        for i in range(3):
            at = int(scene.color_ns[i])
            log.ros(COLOR, ros_image(scene.color[i], "rgb8", 5, COLOR_FRAME), at)
            log.ros(DEPTH, ros_image(scene.depth[i], "16UC1", 0, DEPTH_FRAME), at + 1)
    with open_log(str(tmp_path / "zero.mcap")) as log:
        assert any("log times" in text for text in log.description.warnings)
        assert_holds(log, scene._replace(depth_ns=scene.color_ns + 1))
    backward = Scene(*(part[::-1] for part in scene))
    write_log(tmp_path / "back.mcap", backward)
    with open_log(str(tmp_path / "back.mcap")) as log:
        assert any("backward" in text for text in log.description.warnings)
        assert_holds(log, scene)


def test_memory_does_not_grow_with_the_log(tmp_path):
    def peak(count: int) -> int:
        path = tmp_path / f"long{count}.mcap"
        scene = make_scene(8, size=(320, 240))
        with LogFile(path, compression="lz4", chunk_size=200_000) as log:
            log.ros(COLOR_INFO, ros_info(COLOR_SIZE, COLOR_K, START, COLOR_FRAME), START)
            log.ros(
                DEPTH_INFO, ros_info((320, 240), (300, 300, 160, 120), START, DEPTH_FRAME), START
            )
            log.ros("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, *T_DEPTH_COLOR)), START)
            for i in range(count):
                at = START + i * SECOND // 30
                image = ros_image(scene.depth[i % 8], "16UC1", at, DEPTH_FRAME)
                log.ros(DEPTH, image, at)
                log.ros(COLOR, ros_image(scene.color[i % 8], "rgb8", at, COLOR_FRAME), at)
        tracemalloc.start()
        with opening.open_log(str(path)) as log:
            assert sum(batch.frames.valid.sum() for batch in log.batches(4)) == count
            _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        path.unlink()
        return most

    # 600 frames have 90 MB of depth; the cache of chunks (64 MiB) is full after 440 frames.
    assert peak(900) < peak(600) + 1_000_000


def test_chunks_in_memory_are_bounded_in_any_order_of_reading(tmp_path, monkeypatch):
    """With one chunk in memory, several threads read the same images out of order."""
    scene = make_scene(12)
    path = write_log(tmp_path / "log.mcap", scene, chunk_size=6000)
    monkeypatch.setattr(log_module, "_FRAMES_KEPT", 0)
    monkeypatch.setattr(store.ChunkStore.__init__, "__defaults__", (4, 1, 1 << 30))
    alive: set[int] = set()
    most = 0
    plain = McapFile.chunk

    def counted(file: McapFile, position: int) -> bytes | memoryview:
        nonlocal most
        alive.add(position)
        most = max(most, len(alive))
        data = plain(file, position)
        alive.discard(position)
        return data

    monkeypatch.setattr(McapFile, "chunk", counted)
    with open_log(str(path)) as log:
        alive.clear()
        most = 0
        assert_holds(log, scene, 5)
        order = [11, 0, 7, 7, 3]
        np.testing.assert_array_equal(log.read(order, color=True).frames.color, scene.color[order])
    assert most == 1


def test_an_error_does_not_keep_its_batch_in_memory(tmp_path):
    scene = make_scene(4)
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log)
        for color, depth, at, _ in zip(*scene, strict=True):
            log.ros(COLOR, ros_image(color, "rgb8", int(at), COLOR_FRAME), int(at))
            image = ros_image(depth, "16UC1", int(at), DEPTH_FRAME)
            image.data = image.data[:-9]
            log.ros(DEPTH, image, int(at))
    with open_log(str(tmp_path / "log.mcap")) as log:
        batch = log.read([0, 1, 2, 3])
        assert not batch.frames.valid.any()
        held = weakref.ref(batch.frames.depth)
        del batch
        gc.collect()
        assert held() is None


@pytest.mark.parametrize("whole", [True, False])
def test_an_unreadable_chunk_is_read_again(tmp_path, monkeypatch, whole):
    plain, failures = McapFile.chunk, [1] if whole else [1, 1]  # first scanned, then read

    def failing(file: McapFile, position: int) -> bytes | memoryview:
        if failures:
            raise DamageError(f"file can't be read (try {failures.pop()})")
        return plain(file, position)

    path = write_log(tmp_path / "log.mcap", make_scene(40), chunk_size=6000)
    monkeypatch.setattr(store.ChunkStore.__init__, "__defaults__", (1, 1, 1 << 30))
    monkeypatch.setattr(log_module, "_FRAMES_KEPT", 0)
    with open_log(str(path), LogOptions(scan=whole)) as log:
        monkeypatch.setattr(McapFile, "chunk", failing)
        if whole:
            assert "file can't be read (try 1)" in " ".join(log.read([20]).errors)
        else:
            with pytest.raises(RescanError, match=r"file can't be read \(try 1"):
                log.read([20])
        assert log.read([20]).errors == ("",)


def test_one_chunk_is_in_memory_if_two_exceed_the_limit(tmp_path, monkeypatch):
    size = 4 << 20
    scene = make_scene(6, size=(1024, 1024))
    path = write_log(tmp_path / "log.mcap", scene, compression="zstd", chunk_size=size)
    small = partial(ChunkStore, threads=1, cache_bytes=0)
    monkeypatch.setattr(mcap_scan, "ChunkStore", small)
    file = McapFile(path, 1 << 30)
    tracemalloc.start()
    index = mcap_scan.rebuild_mcap_index(file)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    places = set(index.messages.position.tolist())
    largest = max(file.chunk_head(place).uncompressed_size for place in places)
    file.close()
    assert len(places) > 3
    assert peak < 1.5 * (size + largest)
