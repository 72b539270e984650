"""Parts of a log: formats of times, and frames with the numbers of the complete log."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from jaxdet.errors import ConfigError, InputError, RescanError
from jaxdet.io import LogOptions
from jaxdet.io import open_log as open_only
from jaxdet.io.moments import Moment, find_part, parse_moment
from tests.io_both_ways import assert_same_batch, is_indexed, scanning
from tests.io_helpers import (
    COLOR,
    DEPTH,
    SECOND,
    START,
    LogFile,
    make_scene,
    write_calibration,
    write_log,
)
from tests.test_io_index import Sender

PERIOD_NS = 33_333_333
FRAMES = 60


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("log") / "log.mcap", make_scene(FRAMES), chunk_size=1)


def numbers(path: Path, **part: Any) -> list[int]:
    """Return the numbers of the frames of a part, read by the index and by a scan."""
    options = LogOptions(**part)
    with open_only(str(path), options) as log, open_only(str(path), scanning(options)) as scanned:
        assert is_indexed(log) and not is_indexed(scanned)
        pairs = list(zip(log.batches(7), scanned.batches(7), strict=True))
        for one, other in pairs:
            assert_same_batch(one, other)
        assert log.description.part == scanned.description.part
        found = [n for one, _ in pairs for n in one.frames.number[: len(one.status)].tolist()]
        assert found == list(log.frames) and log.num_frames == FRAMES
        return found


@pytest.mark.parametrize(
    "text, moment",
    [
        ("12.5", Moment(12_500_000_000, False)),
        (".5", Moment(500_000_000, False)),
        ("90s", Moment(90_000_000_000, False)),
        ("0", Moment(0, False)),
        ("1714557600000000001", Moment(1714557600000000001, True)),
        ("2024-05-01T10:00:00Z", Moment(1714557600000000000, True)),
        ("2024-05-01T12:00:00.000001+02:00", Moment(1714557600000001000, True)),
        ("2024-05-01 10:00:00", Moment(1714557600000000000, True)),
    ],
)
def test_times_are_parsed(text, moment):
    assert parse_moment(text, "--start") == moment


@pytest.mark.parametrize(
    "text", ["", "-1", "5 m", "nan", "1e3", "today", "10:00", "१२", "9" * 13, "9" * 400]
)
def test_invalid_times_are_errors_that_name_the_flag(text):
    with pytest.raises(
        ConfigError, match=r"--stop: invalid time .*; use a form like 12.5, 90s, 2024"
    ):
        LogOptions(stop=text)


def test_the_flag_every_must_be_at_least_1():
    with pytest.raises(ConfigError, match="--every must be at least 1"):
        LogOptions(every=0)


def test_start_is_inclusive_and_stop_exclusive(log_path):
    assert numbers(log_path) == list(range(60))
    assert numbers(log_path, start="1.0") == list(range(31, 60))  # frame 30 is at 0.99999999 s
    assert numbers(log_path, start="1", stop="1.5s") == list(range(31, 46))
    at = [str(START + n * PERIOD_NS - 4_000_000) for n in (10, 12)]
    assert numbers(log_path, start=at[0], stop=at[1]) == [10, 11]
    assert numbers(log_path, start=str(int(at[0]) + 1), stop=at[1]) == [11]
    time = "2023-11-14T22:13:20.5Z"
    assert numbers(log_path, start=time) == list(range(16, 60))
    assert numbers(log_path, stop="1000") == list(range(60))


def test_consecutive_parts_cover_the_log(log_path):
    ends = ["0", "0.4", "1.1", "9"]
    for every in (1, 7):
        parts = [
            numbers(log_path, start=start, stop=stop, every=every) for start, stop in pairwise(ends)
        ]
        joined = [number for part in parts for number in part]
        assert joined == numbers(log_path, every=every) == list(range(0, 60, every))


def test_a_part_has_the_images_timestamps_and_pairs_of_the_complete_log(log_path):
    with open_only(str(log_path)) as whole:
        for part in ({"start": "0.5", "stop": "1.2"}, {"every": 9}):
            with open_only(str(log_path), LogOptions(**part)) as log:
                (batch,) = log.batches(len(log.frames))
                assert_same_batch(batch, whole.read(log.frames))


def test_batches_of_a_part_have_its_frames(log_path):
    with open_only(str(log_path), LogOptions(start="0.5", every=4)) as log:
        assert list(log.frames) == list(range(16, 60, 4))
        found = [batch.frames.number.tolist() for batch in log.batches(2, 17, 30)]
        assert found == [[20, 24], [28, -1]]


def test_an_empty_range_is_an_error_that_names_the_span_of_the_log(log_path):
    for part in ({"start": "5"}, {"stop": "0"}, {"start": "1", "stop": "0.5"}):
        with pytest.raises(InputError) as caught:
            open_only(str(log_path), LogOptions(**part))
        text = str(caught.value)
        assert all(f"--{name} {value}" in text for name, value in part.items())
        assert "the log has 60 depth images from 0 to 1.967 s, 2023-11-14T22:13:19.996Z to " in text
    with pytest.raises(InputError, match=r"no depth image matches --start 1.9 --every 100"):
        open_only(str(log_path), LogOptions(start="1.9", every=100))


def test_only_the_chunks_of_a_part_are_read(log_path, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxdet.io.windows._LOOKS", 8)  # frame 40 is not among the samples
    with log_path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    at = START + 40 * PERIOD_NS  # log time of frame 40
    torn = next(c for c in summary.chunk_indexes if c.message_start_time == at)
    data = bytearray(log_path.read_bytes())
    data[torn.chunk_start_offset + torn.chunk_length - 3] ^= 0xFF
    damaged = tmp_path / "log.mcap"
    damaged.write_bytes(data)
    with open_only(str(damaged), LogOptions(stop="1.0")) as log:
        assert is_indexed(log)
        assert sum(len(batch.status) for batch in log.batches(8)) == 31
    with open_only(str(damaged), LogOptions(start="0.8", stop="1.4")) as log:
        if is_indexed(log):
            with pytest.raises(RescanError):
                list(log.batches(8))


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("topic", [COLOR, DEPTH])
def test_a_clock_that_steps_back_is_noticed(tmp_path, compression, topic):
    with LogFile(tmp_path / "log.mcap", compression, chunk_size=5000) as file:
        write_calibration(file)
        sender = Sender(file)
        for i in range(FRAMES):
            at = START + i * PERIOD_NS
            for name in (DEPTH, COLOR):
                back = SECOND if name == topic and i >= 45 else 0
                sender.image(name, i, at - back, at)
    path = str(tmp_path / "log.mcap")
    with open_only(path, LogOptions(scan=True)) as whole:
        stamps = whole.stamps_ns
        for part, wanted in (
            ({"stop": "0.4"}, stamps < START + 4 * SECOND // 10),
            ({"start": "0.6", "stop": "0.9"}, np.abs(stamps - START - 0.75e9) <= 0.15e9),
            ({"every": 20}, np.arange(FRAMES) % 20 == 0),
        ):
            with open_only(path, LogOptions(**part)) as log:
                assert list(log.frames) == np.flatnonzero(wanted).tolist()
                (batch,) = log.batches(FRAMES)
                same = whole.read(log.frames)
                found = batch.frames.stamp_ns[: len(log)]
                np.testing.assert_array_equal(found, same.frames.stamp_ns)
                assert batch.status == same.status


@pytest.mark.parametrize("scan", [False, True])
@pytest.mark.parametrize("zero", [0, 40])
def test_a_timestamp_of_zero_is_replaced_by_the_log_time(tmp_path, scan, zero):
    scene = make_scene(FRAMES)
    expected, scene.depth_ns[zero] = scene.depth_ns.copy(), 0
    with LogFile(tmp_path / "log.mcap") as file:
        write_calibration(file)
        sender = Sender(file)
        for i, (at, depth_at) in enumerate(zip(scene.color_ns, scene.depth_ns, strict=True)):
            sender.image(DEPTH, i, int(depth_at), START + i * PERIOD_NS)
            sender.image(COLOR, i, int(at), START + i * PERIOD_NS)
    options = LogOptions(start="1.5", scan=scan)
    with open_only(str(tmp_path / "log.mcap"), options) as log:
        wanted = np.flatnonzero(expected >= expected[0] + 3 * SECOND // 2)
        assert list(log.frames) == wanted.tolist()
        assert log.description.duration_s == np.ptp(expected) / 1e9
        np.testing.assert_array_equal(log.stamps_ns, expected)
        text = f"{DEPTH}: of {FRAMES} timestamps, 1 is zero, by the log times"
        assert any(text in item for item in log.description.warnings)


def test_the_search_for_a_time_reads_few_frames():
    seen = []

    def stamp_ns(number):
        seen.append(number)
        return 10 * (1 + number)

    for first in (0, 1, 7, 500_000, 999_999):
        seen.clear()
        start = f"{10 * first / 1e9:.9f}"
        assert find_part(10**6, stamp_ns, start, None, 1, "log") == range(first, 10**6)
        assert len(seen) <= 21
