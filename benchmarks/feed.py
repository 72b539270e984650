"""``python -m benchmarks feed --json FILE``: throughput of whole logs, by format and by step.

Measured in turns are ``jaxdet run`` as a command, each of its steps alone, and how fast other
libraries read the same depth images, or colour and depth, without processing them. The logs are
written by the benchmark and are in the page cache.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Annotated, NamedTuple

import jax
import numpy as np
import pyarrow.parquet as pq
import tyro
import warp as wp
from mcap.reader import make_reader

from benchmarks import gate
from benchmarks.feed_logs import CONFIG, FORMS, Form, Topics, drive, topics_of, write
from benchmarks.feed_peers import PEERS, Read
from benchmarks.mounts import depth_plane
from benchmarks.run import Metric
from jaxdet import detect
from jaxdet.config import Config
from jaxdet.cores import cores
from jaxdet.floor.plane import repeat_plane
from jaxdet.io import Log, open_log
from jaxdet.io.compressed import decode_compressed_depth
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.images import decode_depth
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.messages import CompressedImageMessage, ImageMessage
from jaxdet.results.rows import batch_rows, row_inputs
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.tables import to_table

BATCHES = {"cpu": 16, "gpu": 256}
"""Frames per batch when steps are timed alone."""
_CHECKED = 8
"""Number of frames of a log whose images are compared with those of the peers."""
_RECORD_HEAD = 9
_MAX_BYTES = 1 << 30
_SAMPLE_S = 0.1


@dataclass(frozen=True)
class Options:
    """Time ``jaxdet run``, its steps and its peers on logs written by this benchmark."""

    frames: int = 300
    """Number of frames in each log."""
    rounds: int = 3
    """Number of rounds in which all are timed; medians are reported."""
    forms: tuple[str, ...] = tuple(FORMS)
    """Log formats: raw, lz4, zstd, jpeg_png, jpeg_rvl."""
    folder: Path | None = None
    """Folder for the logs; default: a temporary folder, which is removed afterwards."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """File for the metrics."""


class Run(NamedTuple):
    """Measurements of one run of the command."""

    fps: float
    """Steady rate after the first batch [frames/s]."""
    start_s: float
    """Time from the start of the command to the end of the first batch [s]."""
    wall_s: float
    rss_mib: float
    """Peak memory of all processes, with shared memory counted once [MiB]."""


def main(options: Options) -> int:
    """Run the benchmark; return the exit code."""
    wp.config.log_level = wp.LOG_WARNING
    frames, metrics = drive(), []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.forms:
            log = folder / f"{name}.mcap"
            write(log, FORMS[name], frames, options.frames)
            found = form_metrics(name, log, folder / "results", options.rounds)
            log.unlink()
            metrics += found
            print("\n".join(map(str, [*found, ""])), flush=True)
    if options.json_file:
        gate.write(options.json_file, metrics)
    return 0


def form_metrics(name: str, log: Path, results: Path, rounds: int) -> list[Metric]:
    """Return the metrics of a log format."""
    topics = topics_of(FORMS[name])
    check(log, topics, _CHECKED)
    runs, rates = [], defaultdict(list)
    with open_log(str(log)) as opened:
        detecting = Detecting(opened, BATCHES[jax.default_backend()])
        batch = len(detecting.frames.depth)
        timed = {
            "read": Reading(log).run,
            "decode": Decoding(log, FORMS[name], opened).run,
            "read_decode": lambda: sum(len(found.status) for found in opened.batches(batch)),
            "detect": detecting.run,
            "rows_write": Writing(opened, detecting, log.parent).run,
        }
        for peer, read in PEERS.items():
            timed[peer] = partial(_frames_read, read, log, topics)
            timed[f"{peer}_depth"] = partial(_frames_read, read, log, (topics.depth,))
        run_command(log, results)  # fills the caches
        for function in timed.values():
            function()
        for _ in range(rounds):
            runs.append(run_command(log, results))
            for key, function in timed.items():
                start = time.perf_counter()
                rates[key].append(function() / (time.perf_counter() - start))
    return _metrics(f"feed.{name}", runs, {key: statistics.median(r) for key, r in rates.items()})


def _frames_read(read: Read, log: Path, topics: Sequence[str]) -> int:
    """Read all images of some topics with a peer; return the number of frames."""
    return sum(1 for _ in read(log, topics)) // len(topics)


def _metrics(key: str, runs: list[Run], rates: dict[str, float]) -> list[Metric]:
    fps = statistics.median(run.fps for run in runs)
    peers = [name for peer in PEERS for name in (f"{peer}_depth", peer)]
    parts = {part: rate for part, rate in rates.items() if part not in peers}
    metrics = [Metric(f"{key}.fps", fps, "frames/s", "higher", 0.3)]
    metrics += [Metric(f"{key}.vs_{peer}", fps / rates[peer], "x", "higher", 0.3) for peer in peers]
    share = fps / min(parts.values())
    metrics.append(Metric(f"{key}.share_of_slowest_part", share, "", "higher", 0.3))
    metrics += [
        Metric(f"{key}.{part}.fps", rate, "frames/s", "info", 0.0) for part, rate in parts.items()
    ]
    start, wall, rss = (statistics.median(column) for column in list(zip(*runs, strict=True))[1:])
    return metrics + [
        Metric(f"{key}.start_s", start, "s", "lower", 0.3),
        Metric(f"{key}.wall_s", wall, "s", "info", 0.0),
        Metric(f"{key}.rss_mib", rss, "MiB", "lower", 0.2),
    ]


def run_command(log: Path, results: Path) -> Run:
    """Run ``jaxdet run`` on a log."""
    command = [sys.executable, "-m", "jaxdet", "run", str(log), "--output", str(results)]
    start = time.perf_counter()
    command += ["--overwrite", "--quiet", "--pictures", "0"]
    with subprocess.Popen(command) as process, PeakMemory(process.pid) as peak:
        code = process.wait()
    wall = time.perf_counter() - start
    if code:
        raise RuntimeError(f"jaxdet run {log} ended with exit code {code}")
    about = json.loads(next(results.glob("*/summary.json")).read_text("utf-8"))["logs"][0]
    if about["frames_per_s"] is None:
        raise RuntimeError(f"{log} has too few frames for a steady rate: use --frames")
    steady = about["seconds"] - about["first_batch_s"]
    return Run(about["frames_per_s"], wall - steady, wall, peak.mib)


class PeakMemory:
    """Sample the memory of a process and its descendants; 0 without ``/proc``."""

    def __init__(self, pid: int) -> None:
        self.mib, self._pid, self._done = 0.0, pid, Event()
        self._thread = Thread(target=self._sample, daemon=True)

    def __enter__(self) -> "PeakMemory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._done.wait(_SAMPLE_S):
            self.mib = max(self.mib, sum(map(_pss_kib, _tree(self._pid))) / 1024)


def _tree(pid: int) -> Iterator[int]:
    """Yield the process ids of a process and its descendants."""
    yield pid
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        children = [child for task in tasks for child in (task / "children").read_text().split()]
    except OSError:
        return
    for child in children:
        yield from _tree(int(child))


def _pss_kib(pid: int) -> int:
    """Return the proportional set size (PSS) of a process [KiB]."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


class Reading:
    """Read and decompress chunks and check their CRC, with one thread per core."""

    def __init__(self, log: Path) -> None:
        self._file = McapFile(log, _MAX_BYTES)
        with log.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None and summary.statistics is not None
        self._chunks = [index.chunk_start_offset + _RECORD_HEAD for index in summary.chunk_indexes]
        counts = summary.statistics.channel_message_counts
        depth = [c.id for c in summary.channels.values() if "depth/image_rect_raw" in c.topic]
        self._frames = sum(counts[number] for number in depth)

    def run(self) -> int:
        """Read all chunks; return the number of frames."""
        with ThreadPoolExecutor(cores()) as pool:
            for _ in pool.map(lambda position: len(self._file.chunk(position)), self._chunks):
                pass
        return self._frames


class Decoding:
    """Decode depth messages in memory into the rows of a batch, with one thread per core."""

    def __init__(self, log: Path, form: Form, opened: Log) -> None:
        self._pool = ThreadPoolExecutor(cores())
        self._depth = np.zeros((CONFIG.frames, *opened.depth_shape), np.uint16)
        self._unit_m = opened.calibration.depth_unit
        self._messages: list[tuple[int, bytes]] = []
        topic = topics_of(form).depth
        with log.open("rb") as file:
            for schema, _, message in make_reader(file).iter_messages(topics=[topic]):
                assert schema is not None
                if not self._messages:
                    about = schema.name, schema.encoding, schema.data
                    self._decoder = MessageDecoder(ChannelInfo(topic, "cdr", *about))
                self._messages.append((len(self._messages), message.data))
                if len(self._messages) == CONFIG.frames:
                    break
        self._turns = max(1, opened.num_frames // CONFIG.frames)

    def run(self) -> int:
        """Decode the messages; return the number of frames."""
        for _ in range(self._turns):
            list(self._pool.map(self._one, self._messages))
        return self._turns * CONFIG.frames

    def _one(self, item: tuple[int, bytes]) -> None:
        row, payload = item
        message, limit = self._decoder.decode(payload), self._depth[0].size
        if isinstance(message, CompressedImageMessage):
            decode_compressed_depth(message, self._depth[row], self._unit_m, limit)
        elif isinstance(message, ImageMessage):
            decode_depth(message, self._depth[row], self._unit_m, limit)


class Detecting:
    """Detect obstacles in batches of frames in memory."""

    def __init__(self, opened: Log, batch: int) -> None:
        frames = next(opened.batches(batch)).frames
        self.frames = frames._replace(plane=repeat_plane(depth_plane(CONFIG), batch))
        self._batch, self._turns = batch, max(1, opened.num_frames // batch)

    def run(self) -> int:
        """Detect obstacles; return the number of frames."""
        for _ in range(self._turns):
            jax.block_until_ready(detect(self.frames))
        return self._turns * self._batch


class Writing:
    """Convert the results of a batch to rows and write them as Parquet, on one thread."""

    def __init__(self, opened: Log, detecting: Detecting, folder: Path) -> None:
        size = len(detecting.frames.depth)
        assert detecting.frames.plane is not None
        self._batch, self._plane = next(opened.batches(size)), detecting.frames.plane
        self._found = row_inputs(jax.device_get(detect(detecting.frames)))
        self._folder, self._turns = folder, max(1, opened.num_frames // size)

    def run(self) -> int:
        """Write the tables; return the number of frames."""
        count = len(self._batch.status)
        for _ in range(self._turns):
            given = "log", "camera", self._batch, self._plane, ("tf",) * count
            rows = batch_rows(*given, self._found, Config())
            for name, columns, schema in (
                ("frames", rows.frames, FRAMES_SCHEMA),
                ("obstacles", rows.obstacles, OBSTACLES_SCHEMA),
            ):
                path = self._folder / f"{name}.parquet"
                pq.write_table(to_table(columns, schema), path)
        return self._turns * count


def check(log: Path, topics: Topics, count: int) -> None:
    """Check that the peers read the same images for the first ``count`` frames.

    Raises:
        AssertionError: They are not.
    """
    with open_log(str(log)) as opened:
        frames = opened.read(range(count), color=True).frames
    assert frames.color is not None
    for name, images in PEERS.items():
        seen: dict[str, int] = dict.fromkeys(topics, 0)
        for topic, image in images(log, topics):
            if (number := seen[topic]) < count:
                ours = (frames.color if topic == topics.color else frames.depth)[number]
                where = f"{name} reads another image: frame {number} of {topic}"
                np.testing.assert_array_equal(ours, image, where)
            seen[topic] += 1
            if min(seen.values()) >= count:
                break
