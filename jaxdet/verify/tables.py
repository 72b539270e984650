"""Check of the tables: readable, in order, consistent with each other, and complete."""

from collections import Counter
from dataclasses import fields

import numpy as np

from jaxdet.errors import InputError
from jaxdet.results.layout import FRAMES, OBSTACLES
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.schemas import OBSTACLES_SCHEMA
from jaxdet.results.summary import Counts
from jaxdet.results.tables import Tables, vectors
from jaxdet.results.writer import INPUTS_KEY, VERSION_KEY, Inputs, table_metadata
from jaxdet.verify.report import Report


def check_tables(results: Results, report: Report) -> None:
    """Read and check all rows of the tables of a log.

    Args:
        results: Results of one log.
        report: Report to add to.
    """
    read, complete = Inputs(), True
    for log in results.logs:
        try:
            _check_log(results, log, read, report)
        except InputError as error:
            complete = False
            report.add("tables", log.label, error.problem)
        report.notes += [f"lost in the run: {lost}" for lost in log.summary["lost"]]
    report.notes += [
        f"{failure.log} failed in the run and has no rows: {failure.reason}"
        for failure in results.failed
    ]
    if complete and results.logs:
        _check_metadata(results, read, report)


def _check_log(results: Results, log: ResultLog, read: Inputs, report: Report) -> None:
    counts, numbers, problems = Counts(), [], set[str]()
    # obstacle columns without tracks
    for chunk in results.chunks(log, None, OBSTACLES_SCHEMA.names):
        read.add(chunk.frames)
        counts.count(_columns(chunk), _outlines(chunk))
        numbers.append(chunk.frames["frame"].to_numpy())
        problems |= _problems(chunk)
        report.frames += chunk.frames.num_rows
        report.obstacles += chunk.obstacles.num_rows
    for problem in sorted(problems):
        report.add("tables", log.label, problem)
    if problem := _gap(results, np.concatenate([*numbers, np.zeros(0, np.int64)])):
        report.add("tables", log.label, problem)
    for part in fields(Counts):
        found, stored = getattr(counts, part.name), log.summary[part.name]
        if part.name != "busy_s" and found != (
            Counter(stored) if isinstance(stored, dict) else stored
        ):
            found = dict(found) if isinstance(found, Counter) else found
            problem = f"{part.name} is {found} in the rows, but {stored} in summary.json"
            report.add("tables", log.label, problem)


def _columns(chunk: Tables) -> dict[str, np.ndarray]:
    """Return the frame columns needed by :meth:`jaxdet.results.summary.Counts.count`."""
    columns = {name: np.array(chunk.frames[name].to_pylist(), object) for name in _WORDS}
    refused = columns["floor_refused"]
    columns["floor_refused"] = np.ma.array(refused, mask=[word is None for word in refused])
    poses = vectors(chunk.frames["camera_orientation_world"], 4)
    numbers = {name: chunk.frames[name].to_numpy() for name in _NUMBERS}
    return {**columns, **numbers, "camera_orientation_world": poses}


def _outlines(chunk: Tables) -> dict[str, np.ndarray]:
    """Return the obstacle columns needed by :meth:`jaxdet.results.summary.Counts.count`."""
    return {
        "corners_ground": vectors(chunk.obstacles["corners_ground"], 8),
        "distance_m": chunk.obstacles["distance_m"].to_numpy(),
    }


_WORDS = ("status", "floor_source", "floor_refused")
_NUMBERS = ("num_obstacles", "overflow", "camera_pitch_rad", "camera_roll_rad")


def _problems(chunk: Tables) -> set[str]:
    """Describe the inconsistencies between rows of obstacles and rows of frames."""
    found, count = set(), chunk.frames["num_obstacles"].to_numpy()
    labels = np.arange(chunk.obstacles.num_rows) - np.repeat(chunk.first[:-1], count)
    if not np.array_equal(chunk.obstacles["obstacle"].to_numpy(), labels):
        found.add("obstacles of a frame are not numbered from 0")
    stamps = np.repeat(chunk.frames["stamp_ns"].to_numpy(), count)
    if not np.array_equal(chunk.obstacles["stamp_ns"].to_numpy(), stamps):
        found.add("stamp_ns of obstacles differs from their frames")
    return found


def _gap(results: Results, numbers: np.ndarray) -> str:
    """Describe the first missing, repeated or misplaced frame; empty if there is none."""
    options = results.log_options
    if not numbers.size:
        return ""
    if options.start is None and numbers[0]:
        return f"expected frame 0 first, got {numbers[0]}"
    for at in np.flatnonzero(np.diff(numbers) != options.every)[:1]:
        this, following = numbers[at], numbers[at + 1]
        missing = following > this + options.every
        what = f"frame {this + options.every} is missing" if missing else "is out of order"
        return f"{what}: frame {following} follows {this}"
    return ""


def _check_metadata(results: Results, read: Inputs, report: Report) -> None:
    """Check configuration and inputs in the metadata of both tables."""
    log = results.logs[0]
    summary = results.summaries[log.folder]
    expected = table_metadata(results.config, summary, read)
    expected[VERSION_KEY] = summary["jaxdet"]
    for name in (FRAMES, OBSTACLES):
        stored = results.metadata(log, name)
        for key, value in expected.items():
            if stored.get(key) != value:
                what = (
                    "timestamps and calibrations differ from its rows or summary.json"
                    if key == INPUTS_KEY
                    else f"{key} in its metadata differs from config.json or summary.json"
                )
                report.add("tables", name, what)
