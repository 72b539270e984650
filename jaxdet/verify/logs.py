"""Rows against the log that they are of: which frames there are, and a sample computed again."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxdet.engine import decide_planes
from jaxdet.engine.color import method_frames
from jaxdet.engine.floors import evenly
from jaxdet.errors import FrameStatus, JaxdetError
from jaxdet.export.recordings import open_modes, some
from jaxdet.floor.plane import unknown_plane
from jaxdet.io import Log, LogFiles, open_log
from jaxdet.pipeline import detect
from jaxdet.results.manifest import fingerprint
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.rows import batch_rows, no_inputs, row_inputs
from jaxdet.results.schemas import OBSTACLES_SCHEMA
from jaxdet.results.tables import Tables
from jaxdet.results.writer import table_bytes
from jaxdet.verify.report import Report

if TYPE_CHECKING:
    import pyarrow as pa

_OF_LOG = [
    "frame",
    "stamp_ns",
    "color_stamp_ns",
    "log_time_ns",
    "camera_frame",
    "world_frame",
    "camera_position_world",
    "camera_orientation_world",
]
"""Columns that need no image."""
_LOST = (FrameStatus.WORKER_CRASHED, FrameStatus.TIMEOUT)
_NAMES = ("frames.parquet", "obstacles.parquet")


def check_inputs(files: LogFiles, told: Sequence[Mapping[str, Any]], report: Report) -> None:
    """Finds files of a log that are not those that were read.

    Args:
        files: The log.
        told: What the manifest says of its files, see
            :func:`jaxdet.results.manifest.fingerprint`. Their paths and times may differ.
        report: Gets what is found.
    """
    if len(files.paths) != len(told):
        problem = f"has {len(files.paths)} files, {len(told)} were read"
        report.add("log", files.name, problem)
    for path, before in zip(files.paths, told, strict=False):
        now = fingerprint(path)
        if now.get("size") != before.get("size"):
            problem = f"has {now.get('size')} bytes, the file that was read {before.get('size')}"
        elif now.get("fingerprint") != before.get("fingerprint"):
            problem = "is not the file that was read: the checksum of its ends differs"
        else:
            continue
        report.add("log", str(path), problem)


def check_log(
    results: Results, log: ResultLog, files: LogFiles, sample: int, report: Report
) -> None:
    """Compares all frames with those of the log, and some with what the reference finds in them.

    Args:
        results: The results.
        log: One of its logs.
        files: Where that is.
        sample: So many frames are computed again, spread evenly.
        report: Gets what is found.
    """
    found = Report()
    for options in open_modes(results, log):
        found = Report()
        try:
            with open_log(files, options) as opened:
                same = _check_frames(results, log, opened, found)
                if same and sample:
                    _check_sample(results, log, opened, sample, found)
        except JaxdetError as error:
            found.add("log", log.label, str(error))
        if not found.findings:  # else the run may have found the index not to be enough
            break
    report.findings += found.findings
    report.frames_of_logs += found.frames_of_logs
    report.frames_again += found.frames_again


def _check_frames(results: Results, log: ResultLog, opened: Log, report: Report) -> bool:
    """Whether the rows are of the log's frames."""
    count, done = len(opened.frames), 0
    if count != log.num_frames:
        problem = f"the log has {count} frames, the results {log.num_frames}"
        report.add("log", log.label, problem)
        return False
    for chunk in results.chunks(log, _OF_LOG, ()):
        rows = chunk.frames.num_rows
        numbers = list(opened.frames[done : done + rows])
        batch = opened.without_images(numbers, FrameStatus.DECODE_ERROR, "")
        given = unknown_plane(rows), ["none"] * rows, no_inputs(rows), results.method
        want = batch_rows(log.name, log.camera, batch, *given)
        frames = Tables.of(want.frames, want.obstacles).frames
        if columns := _different(frames, chunk.frames.select(_OF_LOG)):
            where = f"in frames {numbers[0]} to {numbers[-1]}"
            report.add("log", log.label, f"{', '.join(columns)} {where} are not the log's")
            return False
        done += rows
    report.frames_of_logs += done
    return True


def _check_sample(
    results: Results, log: ResultLog, opened: Log, sample: int, report: Report
) -> None:
    """Computes the rows of some frames again; those without results in the run are left out."""
    numbers = [np.zeros(0, np.int64)]
    for chunk in results.chunks(log, ["status"], ()):
        there = ~np.isin(np.array(chunk.frames["status"].to_pylist(), object), _LOST)
        numbers.append(chunk.frames["frame"].to_numpy()[there])
    wanted, config = evenly(np.concatenate(numbers), sample), results.method
    if not wanted.size:
        return
    planes = decide_planes(opened, config, "reference", wanted)
    for chunk in some(results, log, wanted, OBSTACLES_SCHEMA.names):  # without tracks
        again = chunk.frames["frame"].to_pylist()
        batch = opened.read(again, color=config.cluster.points, need_color=config.cluster.points)
        stamps = batch.frames.stamp_ns
        plane = planes.of(stamps)
        frames = method_frames(batch.frames._replace(plane=plane), config)
        found = row_inputs(detect(frames, config, backend="reference"))
        given = plane, planes.sources(stamps), found, config
        rows = batch_rows(log.name, log.camera, batch, *given)
        want = Tables.of(rows.frames, rows.obstacles)
        _compare(log, want, chunk, report)
        report.frames_again += len(again)


def _compare(log: ResultLog, want: Tables, found: Tables, report: Report) -> None:
    """Names the frames and columns that are not those of the reference."""
    if not any(_different(*tables) for tables in zip(want, found, strict=True)):
        return
    for row, number in enumerate(found.frames["frame"].to_pylist()):
        one = zip(_NAMES, want.take(np.array([row])), found.take(np.array([row])), strict=True)
        for name, *tables in one:
            if columns := _different(*tables):
                problem = f"{', '.join(columns)} of {name} is not what the reference finds"
                report.add("sample", log.label, f"frame {number}: {problem}")


def _different(want: "pa.Table", found: "pa.Table") -> list[str]:
    """The columns that would not be written as the same bytes, of those of ``found``."""
    if want.num_rows != found.num_rows:
        return ["number of rows"]
    if table_bytes(want.select(found.column_names)) == table_bytes(found):
        return []
    names = [[name] for name in found.column_names]
    return [n[0] for n in names if table_bytes(want.select(n)) != table_bytes(found.select(n))]
