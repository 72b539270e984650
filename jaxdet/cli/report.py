"""Summary of a run as lines of text."""

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.engine import GroundRecord
    from jaxdet.results.summary import LogSummary, Summary


MANY_LOGS = 12
"""Maximum number of logs in a complete list; if there are more, only the worst are listed."""
MOST_WORST = 12
"""Maximum number of worst logs listed in a report."""
MOST_REMARKS = 12
"""Maximum number of different warnings, and of notes, listed for many logs."""
MOST_NAMED = 3
"""Maximum number of log names per remark."""


def summary_lines(summary: "Summary", output: Path, *, every: bool = False) -> list[str]:
    """Return the lines that are printed after a run.

    Args:
        summary: Summary of the run.
        output: Folder of the results.
        every: List every log, even if there are many.
    """
    done = [log for log in summary.logs if log.log not in summary.kept]
    brief, text = len(done) > MANY_LOGS, []
    if brief and not every:
        text += _worst(done)
    for log in done if every or not brief else ():
        if log.error:
            if log.frames or len(summary.logs) > 1:  # otherwise the error is reported already
                text.append(f"{_label(log)}: failed after {many(log.frames, 'frame')}")
        elif brief:
            counts = many(log.frames, "frame"), many(log.obstacles, "obstacle")
            text.append(f"{_label(log)}: {counts[0]} ({_states(log)}), {counts[1]}")
        else:
            text += [_label(log), *(f"  {line}" for line in _log_lines(log))]
    if brief:
        whole = [log for log in done if not log.error]
        text += _remarks("warning", [(log, log.warnings) for log in whole])
        text += _remarks("note", [(log, log.notes) for log in whole]) if every else []
    failed = len(summary.failed)
    some = f"{failed} of {many(len(summary.logs), 'log')} failed"
    if failed == len(summary.logs) and not summary.frames:
        return [*text, f"{some}; no results" if failed > 1 else "no results"]
    if summary.kept:
        stay = [log for log in summary.whole if log.log in summary.kept]
        count = len({log.log for log in stay})
        text.append(f"{many(count, 'log')} processed earlier: {_counts(stay)}")
    done = [log for log in done if not log.error]
    frames, found = sum(log.frames for log in done), _counts(done)
    timed = frames and summary.seconds
    rate = f"{frames / summary.seconds:.1f} frames/s with start-up" if timed else ""
    nothing_new = summary.kept and not done
    text.append(f"{'nothing new' if nothing_new else found} in {summary.seconds:.1f} s")
    text[-1] += f" ({rate})" if rate else ""
    text[-1] += f"; {some}" if failed else ""
    return [*text, _results_line(summary, output)]


def _worst(logs: Sequence["LogSummary"]) -> list[str]:
    """Return a table of the logs that failed, lost frames or have most frames that are not ok."""
    bad = [log for log in logs if log.error or log.lost or log.num_bad]
    bad.sort(key=lambda log: (not log.error, not log.lost, -log.num_bad / max(1, log.frames)))
    if not bad:
        return []
    shown = bad[:MOST_WORST]
    width = max(len(_label(log)) for log in shown)
    lines = [f"{'log':<{width}}  {'frames':>7}  {'not ok':>7}  status"]
    for log in shown:
        states = "failed" if log.error else _states(log)
        lines.append(f"{_label(log):<{width}}  {log.frames:>7}  {log.num_bad:>7}  {states}")
    left = len(bad) - len(shown)
    return [*lines, f"and {left} more, see summary.json of each log"] if left else lines


def _counts(logs: Sequence["LogSummary"]) -> str:
    frames, obstacles = sum(log.frames for log in logs), sum(log.obstacles for log in logs)
    return f"{many(frames, 'frame')}, {many(obstacles, 'obstacle')}"


def _results_line(summary: "Summary", output: Path) -> str:
    """Return the line that names the results folder and its contents."""
    counts = {
        "picture": sum(len(log.pictures) for log in summary.logs),
        "map": sum(bool(log.map) for log in summary.logs),
    }
    made = ["tables", *(many(count, what) for what, count in counts.items() if count)]
    return f"results: {output} ({', '.join(made)})"


def _remarks(kind: str, each: Sequence[tuple["LogSummary", Sequence[str]]]) -> list[str]:
    """Return each distinct remark once with the logs that have it, the most common first."""
    found: dict[str, list[str]] = {}
    for log, remarks in each:
        for remark in dict.fromkeys(remarks):
            found.setdefault(remark, []).append(_label(log))
    common = sorted(found.items(), key=lambda item: -len(item[1]))[:MOST_REMARKS]
    lines = [f"{kind:<10} {_named(labels)}: {remark}" for remark, labels in common]
    left = len(found) - len(lines)
    return [*lines, f"{kind:<10} {left} more, see summary.json of each log"] if left else lines


def _named(labels: Sequence[str]) -> str:
    """Join the first ``MOST_NAMED`` labels with commas, and append the number of other labels."""
    left = len(labels) - MOST_NAMED
    return ", ".join(labels[:MOST_NAMED]) + (f" and {left} more" if left > 0 else "")


def many(count: int, what: str) -> str:
    """Return a count with its noun, in the plural unless the count is 1."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def aligned(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Return the rows of a table as lines of text with columns of equal width.

    Args:
        rows: Cells of each row.
        right: Indices of the columns that are aligned to the right.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = enumerate(zip(row, widths, strict=True))
        padded = (c.rjust(wide) if i in right else c.ljust(wide) for i, (c, wide) in cells)
        lines.append("  ".join(padded).rstrip())
    return lines


def _label(log: "LogSummary") -> str:
    """Return the log's name, with the camera if the log has several."""
    several = log.description is not None and log.description.cameras
    return f"{log.log}, {log.camera}" if several else log.log


def _states(log: "LogSummary") -> str:
    """Return the number of frames per status."""
    return ", ".join(f"{count} {n}" for n, count in log.status.most_common()) or "none"


def _log_lines(log: "LogSummary") -> list[str]:
    rate = f", {log.frames_per_s:.1f} frames/s after the first batch" if log.frames_per_s else ""
    text = [
        f"frames     {log.frames} ({_states(log)}){rate}",
        f"obstacles  {log.obstacles}",
        f"ground     {ground_text(log.ground)}",
    ]
    if log.frame_errors:
        text.insert(1, f"bad frame  {log.frame_errors[0]}")
    if log.floor_sources["frame"] or log.floor_refused:
        text.append(f"floor      {_floor_text(log)}")
    if log.short_rectangles:
        what = "start more than 2 cm behind the nearest point, to which distance_m refers"
        text.append(f"rectangles {log.short_rectangles} of {log.obstacles} {what}")
    if log.overflow_frames:
        frames = many(log.overflow_frames, "frame")
        what = "had more surfaces, obstacles or (paper) corners than slots, see jaxdet help tuning"
        text.append(f"overflow   {frames} {what}")
    if "score" in log.observed:
        text += _score_lines(log.observed["score"], log.frames)
    text += [f"lost       {lost}" for lost in log.lost]
    text += [f"warning    {warning}" for warning in log.warnings]
    return text + [f"note       {note}" for note in log.notes]


def _floor_text(log: "LogSummary") -> str:
    """Return the number of frames with a floor of their own, and the sources of other floors."""

    def source_text(name: str) -> str:
        return "none" if name == "none" else f"that of {name}"

    others = [
        f"{count} {'has' if count == 1 else 'have'} {source_text(name)}"
        for name, count in sorted(log.floor_sources.items())
        if count and name != "frame"
    ]
    own = log.floor_sources["frame"]
    shows = f"found in {many(own, 'frame')}"
    text = ", ".join([shows, *others])
    reasons = ", ".join(f"{count} {name}" for name, count in log.floor_refused.most_common())
    return f"{text} (refused: {reasons})" if reasons else text


def _score_lines(score: Mapping[str, Any] | None, frames: int) -> list[str]:
    """Return the comparison with the ground truth; the first line has the number of frames."""
    if score is None:
        return [f"truth      not compared in any of {many(frames, 'frame')}"]
    if "error" in score:
        return [f"truth      not compared: {score['error']}"]
    compared = "" if score["frames"] == frames else f"in {score['frames']} of {frames} frames "
    others = f", {score['ignored']} not counted" if score["ignored"] else ""
    return [
        f"truth      {compared}{score['found']} of {score['visible']} visible obstacles found "
        f"(recall {score['recall']:.3f}), {score['found']} of "
        f"{score['found'] + score['false']} detections right "
        f"(precision {score['precision']:.3f}){others}, F1 {score['f1']:.3f}",
        f"           distance_m {_off(score)}; {score['splits']} splits, "
        f"{score['merges']} merges, {score['on_floor']} on the floor",
        *_claimed_lines(score["free_claimed"], score["free_claimed_worst"]),
    ]


def _off(score: Mapping[str, Any]) -> str:
    """Return the error of the distances and its bias, as text."""
    middle, most, bias = (
        score[name] * 100 for name in ("nearest_error_m", "nearest_error_p90_m", "nearest_bias_m")
    )
    if math.isnan(middle):
        return "not compared: the floor or the true distances are unknown"
    side = f"bias {bias:+.1f} cm (too {'near' if bias < 0 else 'far'})"
    return f"error {middle:.1f} cm (median), {most:.1f} cm (90th percentile), {side}"


def _claimed_lines(share: float, worst: float) -> list[str]:
    """Return the fraction of the drivable floor that lies inside outlines, as lines of text."""
    if math.isnan(share):
        return []
    text = f"           {share:.1%} of the drivable floor is in outlines"
    return [text if math.isnan(worst) else f"{text}, {worst:.1%} in the worst frame"]


def ground_text(records: Sequence["GroundRecord"]) -> str:
    """Return the floor plane, or the planes, of a log in one line."""
    known = [record for record in records if record.height_m is not None]
    if not known:
        if not records:
            return "unknown"
        shown = any(record.frames_used for record in records)
        return f"{'estimated per frame' if shown else 'unknown'} ({records[0].message})"
    first = known[0]
    degrees = [math.degrees(angle or 0.0) for angle in (first.pitch_rad, first.roll_rad)]
    spread = first.height_spread_m
    about = "" if spread is None else f" ± {spread * 100:.1f} cm"
    text = f"camera {first.height_m:.3f} m{about} up, {degrees[0]:.1f}° down"
    text += f", roll {degrees[1]:+.1f}°"
    text += f", from {first.source}"
    if len(records) > 1:
        text += f"; found in {len(known)} of {len(records)} time windows"
    return text
