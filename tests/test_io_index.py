"""Logs opened by their index: the same as scanned, or an error that asks for the scan."""

import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from jaxdet.errors import RescanError
from jaxdet.io import LogOptions, indexed, reading, windows
from jaxdet.io import open_log as open_only
from jaxdet.io.container import McapFile
from jaxdet.io.findings import find_indexed
from jaxdet.io.notes import total
from tests.io_both_ways import assert_same_batch, assert_same_log, is_indexed, scanning
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_INFO,
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


class Sender:
    """Writes messages of few contents with many stamps."""

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


def write_random(path: Path, seed: int) -> LogOptions:
    """A log with jitter, gaps, double and swapped stamps, late messages, moving transforms."""
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 70))
    period = int(random.choice([10, 33, 100])) * MS
    events: list[tuple[int, str, int, int]] = []
    for topic, offset in ((COLOR, 0), (DEPTH, int(random.integers(-40, 40)) * MS)):
        stamps = START + SECOND + np.arange(count) * period + offset
        stamps += random.integers(-4, 5, count) * MS * int(random.integers(0, 4))
        kept = random.random(count) > random.choice([0, 0.1, 0.5])
        kept[0] = True
        if random.random() < 0.3:
            stamps[count // 2 :] += int(random.integers(0, 5)) * SECOND  # a gap
        if random.random() < 0.3:
            stamps[:: int(random.integers(2, 7))] //= 50 * MS  # doubles
            stamps[:: int(random.integers(2, 7))] *= 1
            stamps[stamps < START] *= 50 * MS
        delay = random.integers(0, 30, count) * MS * int(random.integers(0, 3))
        for i in np.flatnonzero(kept).tolist():
            events.append((int(stamps[i] + delay[i]), topic, i, int(stamps[i])))
    last = max((event[0] for event in events), default=START) + SECOND
    rate = int(random.choice([5, 20, 300, 1500])) * MS
    for at in range(START, last, rate):
        events.append((at + int(random.integers(0, 30)) * MS, "/tf", at // rate, at))
    for at in range(START, last, 400 * MS):
        events.append((at, "/tf slow", 0, at))
        events.append((at + 3 * MS, "/odom", 0, at))
    events.sort()
    if random.random() < 0.3:  # not in the order of log times
        for i in range(0, len(events) - 3, 5):
            events[i], events[i + 2] = events[i + 2], events[i]
    forms = {
        "compression": str(random.choice(["none", "lz4", "zstd"])),
        "chunk_size": int(random.choice([500, 5000, 60_000])),
        "crc": bool(random.random() < 0.7),
    }
    with LogFile(path, **forms) as log:
        sender = Sender(log)
        write_calibration(log)
        edge = "base_link", DEPTH_FRAME, (0.1, 0, 0.3), NO_TURN
        log.ros("/tf_static", ros_tf(edge), START)
        for log_ns, topic, number, stamp in events:
            if topic in (COLOR, DEPTH):
                sender.image(topic, number, stamp, log_ns)
                continue
            x = (stamp - START) / SECOND
            if topic == "/odom":
                message = ros_odometry("odom", "base_link", (x, x * x, 0), NO_TURN, stamp)
                log.ros(topic, message, log_ns)
                continue
            edges = [("odom", "base_link", (x, 1, 0), NO_TURN)]
            if topic == "/tf slow":
                edges = [("map", "odom", (np.sin(x), 0, 0), NO_TURN)]
            edges.append(("base_link", "wheel", (1, 2, 3), NO_TURN))
            log.ros("/tf", ros_tf(*edges, stamp_ns=stamp), log_ns)
    odom = "/odom" if random.random() < 0.3 else None
    tolerance = float(random.choice([0, 0.004, 0.03, 0.15, 2.0]))
    return LogOptions(pair_tolerance_s=tolerance, odom=odom)


@pytest.mark.parametrize("few", [False, True])
def test_random_logs_are_the_same_both_ways(tmp_path, monkeypatch, few):
    """``few``: transforms are read about frames only, not all at opening."""
    if few:
        monkeypatch.setattr(indexed, "_MAX_MOTIONS", 0)
    monkeypatch.setattr(windows, "_BESIDE", 1)
    same = asked = 0
    for seed in range(60):
        path = tmp_path / "x.mcap"
        options = write_random(path, seed)
        try:
            with open_only(str(path), options) as found:
                if not is_indexed(found):
                    asked += 1
                    continue
                with open_only(str(path), scanning(options)) as scanned:
                    assert_same_log(found, scanned, (3, 16))
                    same += 1
        except RescanError:
            asked += 1
    print(same, asked)
    assert same >= 40
