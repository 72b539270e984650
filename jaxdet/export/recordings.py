"""The logs that results are of, read and looked at again where a format shows images or points."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jaxdet.engine import Planes, decide_planes, start_up
from jaxdet.engine.color import method_frames
from jaxdet.errors import CalibrationError, FrameStatus, InputError, RescanError, TopicError
from jaxdet.io import Batch, Log, LogFiles, LogOptions, find_logs, open_log
from jaxdet.pipeline import detect
from jaxdet.results.manifest import fingerprint
from jaxdet.results.reading import MOST_NAMED, Chunk, ResultLog, Results
from jaxdet.results.rows import to_host
from jaxdet.types import Detections

BATCH = 16
"""Frames read together."""


class Seen(NamedTuple):
    """Some frames of a log, and what was found in them."""

    batch: Batch
    """:data:`BATCH` frames, with what was known of their floor; after the last row of the chunk the
    last frame is repeated."""
    found: Detections
    """NumPy arrays, of the same frames."""
    chunk: Chunk
    """Their rows of the results."""


def find(results: Results, given: Sequence[str]) -> dict[str, LogFiles]:
    """The logs of the results among files, folders and globs.

    They are told by their names, else by what is in them; a single one is that of results of a
    single log. Logs that failed in the run are passed over.

    Returns:
        By name in the results.

    Raises:
        InputError: One of them is no log of the results.
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
            problem = f"no log {log.name!r}; it holds {some}"
            remedy = "logs are known by their names, else by what is in them"
            raise InputError(problem, path=str(results.folder), remedy=remedy)
        found[name] = log
    return found


def _best(given: Sequence[str], names: Collection[str]) -> list[LogFiles]:
    """Return the logs that are named, with splits joined or not, as the results have them."""
    if not given:
        return []
    logs = find_logs(given)
    if any(log.about and log.name not in names for log in logs):
        apart = find_logs(given, join=False)
        if all(log.name in names for log in apart):
            return apart
    return logs


def _by_content(results: Results, log: LogFiles) -> str | None:
    """Return the log of the results that has the content of another one's files; None: none."""

    def contents(inputs: Iterable[Mapping[str, Any]]) -> list[tuple[Any, Any]]:
        return [(file.get("size"), file.get("fingerprint")) for file in inputs]

    own = contents(map(fingerprint, log.paths))
    for manifest in results.manifests.values():
        if contents(manifest.get("inputs", ())) == own:
            return manifest["log"]
    return None


def recorded(log: ResultLog, flag: str = "--log") -> LogFiles:
    """Where a log was when the results were made.

    Args:
        log: One of the results.
        flag: What names it where it is now.

    Raises:
        InputError: It isn't there any more.
    """
    for path in log.paths:
        if not path.exists():  # a file, or a folder of images
            problem = "the log isn't where it was when the results were made"
            raise InputError(problem, path=str(path), remedy=f"name it with {flag}")
    return LogFiles(log.name, log.paths)


def images(
    results: Results,
    log: ResultLog,
    files: LogFiles,
    wanted: np.ndarray | None = None,
    *,
    color: bool = False,
) -> Iterator[tuple[Batch, Chunk]]:
    """The frames of a log with their rows, :data:`BATCH` at a time, see :class:`Seen`.

    Args:
        results: What a run wrote.
        log: One of its logs.
        files: Where that is.
        wanted: ``(n,)`` numbers of frames; None: all.
        color: Whether to read colour images as well; the preset ``paper`` always does.

    Raises:
        InputError: It is another log, or it can't be read.
    """
    chunks = results.chunks(log, size=BATCH) if wanted is None else some(results, log, wanted)
    waiting, paper = next(chunks, None), results.method.cluster.points
    for options in ways(results, log):
        try:
            with _opened(log, files, options) as opened:
                while waiting is not None:
                    numbers = waiting.frames["frame"].to_numpy()
                    if numbers.max() >= opened.num_frames:
                        raise _other(log, files)
                    last = np.full(BATCH - len(numbers), numbers[-1])
                    batch = opened.read(
                        [*numbers.tolist(), *last.tolist()], color=color or paper, need_color=paper
                    )
                    stamps = batch.frames.stamp_ns[: len(numbers)]
                    if not np.array_equal(stamps, waiting.frames["stamp_ns"].to_numpy()):
                        raise _other(log, files)
                    yield batch, waiting
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
    """The frames of a log with all that is found in them, as the run found it.

    Args:
        results: What a run wrote.
        log: One of its logs.
        files: Where that is.
        wanted: ``(n,)`` numbers of frames; None: all.
        with_cells: Whether to return the depth cells with their obstacles as well.
        color: Whether to read colour images as well.

    Raises:
        InputError: It is another log, or it can't be read.
    """
    start_up()
    config = results.method
    planes = _planes(results, log, files)
    for batch, chunk in images(results, log, files, wanted, color=color):
        frames = batch.frames._replace(plane=planes.of(batch.frames.stamp_ns))
        found = detect(method_frames(frames, config), config, with_cells=with_cells)
        found = to_host(found)
        good = frames.valid & found.has_depth
        counts = np.where(good, found.num_obstacles, 0)[: chunk.frames.num_rows]
        ok = chunk.frames["status"].to_numpy() == FrameStatus.OK
        if (counts != chunk.frames["num_obstacles"].to_numpy())[ok].any():
            raise _other(log, files)
        yield Seen(batch._replace(frames=frames), found, chunk)


def some(
    results: Results,
    log: ResultLog,
    wanted: np.ndarray,
    obstacles: Sequence[str] | None = None,
) -> Iterator[Chunk]:
    """The rows of some frames, with these columns of obstacles, at most :data:`BATCH` at a time."""
    for chunk in results.chunks(log, None, obstacles):
        rows = np.flatnonzero(np.isin(chunk.frames["frame"].to_numpy(), wanted))
        for start in range(0, len(rows), BATCH):
            yield chunk.take(rows[start : start + BATCH])


def _planes(results: Results, log: ResultLog, files: LogFiles) -> Planes:
    """The floor that the run gave each frame."""
    by_index, whole = ways(results, log)
    try:
        with _opened(log, files, by_index) as opened:
            return decide_planes(opened, results.method, "jax")
    except RescanError:
        with _opened(log, files, whole) as opened:
            return decide_planes(opened, results.method, "jax")


def ways(results: Results, log: ResultLog) -> Iterator[LogOptions]:
    """How to open a log: by its index, and where that isn't enough by reading all of it."""
    options = results.options_of(log)
    yield options
    yield replace(options, scan=True)


@contextmanager
def _opened(log: ResultLog, files: LogFiles, options: LogOptions) -> Iterator[Log]:
    """The log, opened as the run opened it; what lacks its topics is another one."""
    try:
        opened = open_log(files, options)
    except (TopicError, CalibrationError) as error:
        raise _other(log, files) from error
    with opened:
        yield opened


def _other(log: ResultLog, files: LogFiles) -> InputError:
    problem = f"is not the log {log.label!r} that the results are of"
    return InputError(problem, path=str(files.paths[0]), remedy="name the right one with --log")
