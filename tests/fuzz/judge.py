"""Verdicts on mutated logs: frames are compared with those of the log before the mutation."""

from pathlib import Path
from typing import NamedTuple

from jaxdet.errors import FrameStatus, RescanError
from jaxdet.io import Log, LogFrame, LogOptions, open_log
from jaxdet.io.timeline import total
from jaxdet.types import Calibration
from tests.fuzz.case import Verdict, ended
from tests.fuzz.formats import FORMATS, FRAMES
from tests.fuzz.mutations import WRITER_IS_WRONG


class Truth(NamedTuple):
    """Images by timestamp, and calibration, of a log before it is mutated."""

    color: dict[int, bytes]
    depth: dict[int, bytes]
    calibration: Calibration


def truth_of(path: Path) -> Truth:
    """Read the frames of an intact log."""
    color, depth = {}, {}
    with open_log(str(path)) as log:
        for frame in log:
            assert frame.status is FrameStatus.OK and frame.color is not None
            color[frame.color_stamp_ns] = frame.color.tobytes()
            depth[frame.stamp_ns] = frame.depth.tobytes()
        assert len(color) == len(depth) == FRAMES
        return Truth(color, depth, log.calibration)


def judge(path: Path, truth: Truth, format_name: str, mutation: str) -> Verdict:
    """Read the log as a run does, by its index or by a scan, and compare it with the truth."""
    return ended(lambda: _judge(path, truth, format_name, mutation))


def _judge(path: Path, truth: Truth, format_name: str, mutation: str) -> Verdict:
    try:
        return _read(path, LogOptions(), truth, format_name, mutation)
    except RescanError:
        return _read(path, LogOptions(scan=True), truth, format_name, mutation)


def _read(
    path: Path, options: LogOptions, truth: Truth, format_name: str, mutation: str
) -> Verdict:
    seen, bad, wrong = 0, 0, []
    with open_log(str(path), options) as log:
        batches = list(log.batches(3, color=log.has_color))
        about = log.described(total(batch.notes for batch in batches))
        messages = [*about.warnings, *(file.text for file in about.integrity)]
        same = log.calibration == truth.calibration
        if not log.has_color and log.color_problem:  # the calibration of colour was damaged
            same = log.calibration == truth.calibration._replace(color=None, color_from_depth=None)
        recovered = any(file.recovered for file in log.description.integrity)
        for batch in batches:
            for frame in batch.one_by_one():
                seen += 1
                if frame.status is not FrameStatus.OK:
                    bad += 1
                    if not frame.error:
                        return Verdict("silently lost", "a frame that is not ok has no reason")
                elif not _is_of(frame, truth):
                    wrong.append(frame.stamp_ns)
        counts = seen, bad, wrong, same, recovered
        return _verdict(log, (format_name, mutation), counts, messages)


def _is_of(frame: LogFrame, truth: Truth) -> bool:
    color = frame.color is None or frame.color.tobytes() == truth.color.get(frame.color_stamp_ns)
    return color and frame.depth.tobytes() == truth.depth.get(frame.stamp_ns)


def _verdict(
    log: Log,
    how: tuple[str, str],
    counts: tuple[int, int, list[int], bool, bool],
    messages: list[str],
) -> Verdict:
    seen, bad, wrong, same, recovered = counts
    form, honest = FORMATS[how[0]], how[1] not in WRITER_IS_WRONG
    checked = form.has_crc and honest
    text = f"{seen} frames, {bad} bad, wrong {wrong}: {'; '.join(messages)}"
    if (wrong or not same) and checked:
        return Verdict("wrong pixels", text)
    if seen < FRAMES and not recovered and honest and form.is_counted and _tells(log):
        return Verdict("silently lost", text)
    if wrong or not same:
        return Verdict("unseen", text)
    if seen > FRAMES:
        known = recovered or not checked or "occur twice" in text
        return Verdict("doubled" if known else "wrong pixels", text)
    if recovered:
        return Verdict("lost", text)
    return Verdict("frames" if bad else "clean", text)


def _tells(log: Log) -> bool:
    """Return whether the summary is readable and gives the number of messages."""
    return all(
        not file.summary_problem and file.declared_messages is not None
        for file in log.description.integrity
    )
