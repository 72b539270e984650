"""Logs of results, read again for exports with images or points."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jaxdet.engine import Planes, decide_planes, start_up
from jaxdet.engine.device import OwnDevice, color_to_read, detected
from jaxdet.errors import CalibrationError, FrameStatus, InputError, RescanError, TopicError
from jaxdet.io import Batch, Log, LogFiles, LogOptions, find_logs, open_log
from jaxdet.results.manifest import fingerprint
from jaxdet.results.reading import MOST_NAMED, ResultLog, Results
from jaxdet.results.tables import Tables
from jaxdet.types import Detections

BATCH = 16
"""Number of frames per batch."""


class Seen(NamedTuple):
    """A batch of frames with their detections."""

    batch: Batch
    """Batch of :data:`BATCH` frames with their floor priors; the last frame is repeated as padding.
    """
    found: Detections
    """Detections of these frames, NumPy arrays."""
    chunk: Tables
    """Rows of the results for these frames."""


def find(results: Results, given: Sequence[str]) -> dict[str, LogFiles]:
    """Find the logs of the results in files, folders and globs.

    Logs are identified by name, else by content. A single log is not checked if the results have
    only one. Logs that failed in the run are ignored.

    Returns:
        Logs by their names in the results.

    Raises:
        InputError: A log is not one of the results.
    """
    names = {log.name for log in results.logs}
    logs = _best(given, names)
    if len(logs) == len(names) == 1:
        return dict(zip(names, logs, strict=True))
    failed = {failure.log for failure in results.failed} - names
    logs = [log for log in logs if log.name not in failed]
    found = {log.name: log for log in logs if log.name in names}
    for log in logs:
        if log.name in names:
            continue
        name = _by_content(results, log)
        if name is None or name in found:
            some = ", ".join(sorted(names)[:MOST_NAMED]) or "none"
            problem = f"the results have no log {log.name!r}; their logs are {some}"
            remedy = "logs are identified by name, else by content"
            raise InputError(problem, path=str(results.folder), remedy=remedy)
        found[name] = log
    return found


def _best(given: Sequence[str], names: Collection[str]) -> list[LogFiles]:
    """Find logs; splits of a recording are joined unless the results have separate logs of them."""
    if not given:
        return []
    logs = find_logs(given)
    if any(log.about and log.name not in names for log in logs):
        apart = find_logs(given, join=False)
        if all(log.name in names for log in apart):
            return apart
    return logs


def _by_content(results: Results, log: LogFiles) -> str | None:
    """Return the name of the log in the results with the same content; None if there is none."""

    def contents(inputs: Iterable[Mapping[str, Any]]) -> list[tuple[Any, Any]]:
        return [(file.get("size"), file.get("fingerprint")) for file in inputs]

    own = contents(map(fingerprint, log.paths))
    for manifest in results.manifests.values():
        if contents(manifest.get("inputs", ())) == own:
            return manifest["log"]
    return None


def recorded(log: ResultLog, flag: str = "--log") -> LogFiles:
    """Return the files of a log at their original paths.

    Args:
        log: Log of the results.
        flag: Flag that names a moved log, for the error.

    Raises:
        InputError: A file no longer exists.
    """
    for path in log.paths:
        if not path.exists():  # a file, or a folder of images
            problem = "the log is not at its original path"
            raise InputError(problem, path=str(path), remedy=f"pass it with {flag}")
    return LogFiles(log.name, log.paths)


def images(
    results: Results,
    log: ResultLog,
    files: LogFiles,
    wanted: np.ndarray | None = None,
    *,
    color: bool = False,
) -> Iterator[tuple[Tables, Batch]]:
    """Yield rows of a log with their frames, :data:`BATCH` at a time, see :class:`Seen`.

    Args:
        results: Results of a run.
        log: Log in the results.
        files: Files of the log.
        wanted: Frame numbers ``(n,)``; None: all.
        color: Whether to read colour images; the preset ``paper`` always does.

    Raises:
        InputError: The files are not this log, or are unreadable.
    """
    chunks = results.chunks(log, size=BATCH) if wanted is None else some(results, log, wanted)
    waiting, read = next(chunks, None), color_to_read(results.method, color)
    for options in open_modes(results, log):
        try:
            with _opened(log, files, options) as opened:
                while waiting is not None:
                    numbers = waiting.frames["frame"].to_numpy()
                    if numbers.max() >= opened.num_frames:
                        raise _other(log, files)
                    last = np.full(BATCH - len(numbers), numbers[-1])
                    batch = opened.read([*numbers.tolist(), *last.tolist()], **read)
                    stamps = batch.frames.stamp_ns[: len(numbers)]
                    if not np.array_equal(stamps, waiting.frames["stamp_ns"].to_numpy()):
                        raise _other(log, files)
                    yield waiting, batch
                    waiting = next(chunks, None)
            return
        except RescanError:
            if options.scan:
                raise


def look_again(
    results: Results,
    log: ResultLog,
    files: LogFiles,
    wanted: np.ndarray | None = None,
    *,
    with_cells: bool = False,
    color: bool = False,
) -> Iterator[Seen]:
    """Detect the obstacles in the frames of a log again, with the same results as in the run.

    Args:
        results: Results of a run.
        log: Log in the results.
        files: Files of the log.
        wanted: Frame numbers ``(n,)``; None: all.
        with_cells: Whether to return the depth cells with their labels.
        color: Whether to read colour images.

    Raises:
        InputError: The files are not this log, or are unreadable.
    """
    start_up()
    planes, device = (
        _planes(results, log, files),
        OwnDevice(results.method, "jax", with_cells=with_cells),
    )
    batches = images(results, log, files, wanted, color=color)
    for chunk, batch, found in detected(batches, planes, device):
        detections = found.detections
        assert detections
        good = batch.frames.valid & detections.has_depth
        counts = np.where(good, detections.num_obstacles, 0)[: chunk.frames.num_rows]
        ok = chunk.frames["status"].to_numpy() == FrameStatus.OK
        if (counts != chunk.frames["num_obstacles"].to_numpy())[ok].any():
            raise _other(log, files)
        yield Seen(batch, detections, chunk)


def some(
    results: Results,
    log: ResultLog,
    wanted: np.ndarray,
    obstacles: Sequence[str] | None = None,
) -> Iterator[Tables]:
    """Yield the rows of selected frames, up to :data:`BATCH` at a time."""
    for chunk in results.chunks(log, None, obstacles):
        rows = np.flatnonzero(np.isin(chunk.frames["frame"].to_numpy(), wanted))
        for start in range(0, len(rows), BATCH):
            yield chunk.take(rows[start : start + BATCH])


def _planes(results: Results, log: ResultLog, files: LogFiles) -> Planes:
    """Compute the floor priors of the run."""
    by_index, by_scan = open_modes(results, log)
    try:
        with _opened(log, files, by_index) as opened:
            return decide_planes(opened, results.method, "jax")
    except RescanError:
        with _opened(log, files, by_scan) as opened:
            return decide_planes(opened, results.method, "jax")


def open_modes(results: Results, log: ResultLog) -> Iterator[LogOptions]:
    """Yield the options to open a log: by its index, and as a fallback by a scan."""
    options = results.options_of(log)
    yield options
    yield replace(options, scan=True)


@contextmanager
def _opened(log: ResultLog, files: LogFiles, options: LogOptions) -> Iterator[Log]:
    """Open a log as in the run; if it lacks the run's topics, it is rejected as a different log."""
    try:
        opened = open_log(files, options)
    except (TopicError, CalibrationError) as error:
        raise _other(log, files) from error
    with opened:
        yield opened


def _other(log: ResultLog, files: LogFiles) -> InputError:
    problem = f"the file is not the log {log.label!r} of the results"
    return InputError(problem, path=str(files.paths[0]), remedy="pass the right one with --log")
