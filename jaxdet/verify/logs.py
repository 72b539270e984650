"""Check of table rows against the log: all frames, and a sample computed again."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxdet.engine import decide_planes
from jaxdet.engine.device import OwnDevice, color_to_read, detected
from jaxdet.engine.floors import evenly
from jaxdet.errors import FrameStatus, JaxdetError
from jaxdet.export.recordings import open_modes, some
from jaxdet.floor.plane import unknown_plane
from jaxdet.io import Log, LogFiles, open_log
from jaxdet.results.manifest import fingerprint
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.rows import batch_rows, no_inputs
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
"""Columns that do not depend on images."""
_LOST = (FrameStatus.WORKER_CRASHED, FrameStatus.TIMEOUT)
_NAMES = ("frames.parquet", "obstacles.parquet")


def check_inputs(files: LogFiles, recorded: Sequence[Mapping[str, Any]], report: Report) -> None:
    """Report files of a log that differ from the files that the run read.

    Args:
        files: Files of the log.
        recorded: Description of the files in the manifest, see
            :func:`jaxdet.results.manifest.fingerprint`. Paths and modification times may differ.
        report: Report to add to.
    """
    if len(files.paths) != len(recorded):
        problem = f"expected {len(recorded)} files as in the run, got {len(files.paths)}"
        report.add("log", files.name, problem)
    for path, before in zip(files.paths, recorded, strict=False):
        now = fingerprint(path)
        if now.get("size") != before.get("size"):
            problem = f"expected {before.get('size')} bytes as in the run, got {now.get('size')}"
        elif now.get("fingerprint") != before.get("fingerprint"):
            problem = "not the file of the run: the checksum of its ends differs"
        else:
            continue
        report.add("log", str(path), problem)


def check_log(
    results: Results, log: ResultLog, files: LogFiles, sample: int, report: Report
) -> None:
    """Compare all frames with the log, and a sample of frames with results of the reference.

    Args:
        results: Results.
        log: Log in the results.
        files: Files of the log.
        sample: Number of frames to compute again, evenly spaced.
        report: Report to add to.
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
        if not found.findings:  # otherwise the next mode scans the log, as the run may have done
            break
    report.findings += found.findings
    report.frames_of_logs += found.frames_of_logs
    report.frames_again += found.frames_again


def _check_frames(results: Results, log: ResultLog, opened: Log, report: Report) -> bool:
    """Compare timestamps and poses of all frames with the log; return whether they are equal."""
    count, done = len(opened.frames), 0
    if count != log.num_frames:
        problem = f"the log has {count} frames, but the results have {log.num_frames}"
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
            report.add("log", log.label, f"{', '.join(columns)} {where} differ from the log")
            return False
        done += rows
    report.frames_of_logs += done
    return True


def _check_sample(
    results: Results, log: ResultLog, opened: Log, sample: int, report: Report
) -> None:
    """Compute the rows of some frames again; frames without results in the run are skipped."""
    numbers = [np.zeros(0, np.int64)]
    for chunk in results.chunks(log, ["status"], ()):
        there = ~np.isin(np.array(chunk.frames["status"].to_pylist(), object), _LOST)
        numbers.append(chunk.frames["frame"].to_numpy()[there])
    wanted, config = evenly(np.concatenate(numbers), sample), results.method
    if not wanted.size:
        return
    planes = decide_planes(opened, config, "reference", wanted)
    # obstacle columns without tracks
    chunks = some(results, log, wanted, OBSTACLES_SCHEMA.names)
    read = color_to_read(config)
    batches = ((chunk, opened.read(chunk.frames["frame"].to_pylist(), **read)) for chunk in chunks)
    for chunk, batch, found in detected(batches, planes, OwnDevice(config, "reference")):
        plane, stamps = batch.frames.plane, batch.frames.stamp_ns
        assert plane is not None
        given = plane, planes.sources(stamps), found.inputs, config
        rows = batch_rows(log.name, log.camera, batch, *given)
        want = Tables.of(rows.frames, rows.obstacles)
        _compare(log, want, chunk, report)
        report.frames_again += chunk.frames.num_rows


def _compare(log: ResultLog, want: Tables, found: Tables, report: Report) -> None:
    """Report the frames and columns that differ from the reference."""
    if not any(_different(*tables) for tables in zip(want, found, strict=True)):
        return
    for row, number in enumerate(found.frames["frame"].to_pylist()):
        one = zip(_NAMES, want.take(np.array([row])), found.take(np.array([row])), strict=True)
        for name, *tables in one:
            if columns := _different(*tables):
                problem = f"{', '.join(columns)} of {name} differs from the reference"
                report.add("sample", log.label, f"frame {number}: {problem}")


def _different(want: "pa.Table", found: "pa.Table") -> list[str]:
    """Return the names of columns that differ between two tables if they are written as bytes."""
    if want.num_rows != found.num_rows:
        return ["number of rows"]
    if table_bytes(want.select(found.column_names)) == table_bytes(found):
        return []
    names = [[name] for name in found.column_names]
    return [n[0] for n in names if table_bytes(want.select(n)) != table_bytes(found.select(n))]
