"""``jaxdet diff``: compares the detections of two runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import aligned, many
from jaxdet.cli.terminal import SPINNER, tell
from jaxdet.errors import ConfigError, InputError, printable

if TYPE_CHECKING:
    from jaxdet.verify.difference import Difference, Found, FrameDifference, LogDifference

DESCRIPTION = """\
Compares two runs on the same logs, for instance before and after a parameter change. Obstacles
are matched per frame by the overlap of their footprints. Prints the parameters that
differ, and the frames that differ most; with --pictures both runs are drawn side by side.

Exit code: 0 if both found the same, 1 if not, 2 if they can't be compared.

Examples:
  jaxdet diff results other-results
  jaxdet diff results other-results --pictures differences
"""

MOST_FRAMES = 20
"""Maximum number of frames per log that are printed and drawn."""
MOST_NAMED = 2
"""Maximum number of obstacles, or columns, named per frame."""


@dataclass(frozen=True)
class DiffCommand:
    """Arguments of ``jaxdet diff``."""

    a: Path = field(metadata={"positional": True, "takes": "A"})
    """Results of jaxdet run, or the folder of one log in them."""
    b: Path = field(metadata={"positional": True, "takes": "B"})
    """Results to compare with A."""
    pictures: Path | None = field(default=None, metadata={"takes": "DIR"})
    """New folder for pictures of the listed frames of both runs, side by side."""
    log: tuple[str, ...] = field(default=(), metadata={"takes": "LOG..."})
    """Current paths of the logs, if they were moved. Needed to draw frames without a picture."""


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    command = parse_flags(DiffCommand, args, "jaxdet diff", DESCRIPTION)
    try:
        with SPINNER.shown("comparing"):
            found, problems = _compare(command)
    except InputError as error:  # exit code 1 of an InputError would mean that the runs differ
        raise ConfigError(error.problem, path=error.path, remedy=error.remedy) from error
    for problem in problems:
        tell(f"jaxdet: warning: {problem}")
    print("\n".join(map(printable, difference_lines(found))))
    return 0 if found.equal else 1


def _compare(command: DiffCommand) -> tuple["Difference", list[str]]:
    """Return the differences, and the problems that occurred while drawing."""
    from jaxdet.results.reading import Results
    from jaxdet.verify.difference import difference

    with Results(command.a) as a, Results(command.b) as b:
        found = difference(a, b)
        if command.pictures is None:
            return found, []
        from jaxdet.verify.side_by_side import draw_differences

        chosen = [(log, [frame.frame for frame in most_different(log)]) for log in found.logs]
        some = [(log, numbers) for log, numbers in chosen if numbers]
        return found, draw_differences((a, b), some, command.pictures, command.log)


def difference_lines(found: "Difference") -> list[str]:
    """Return the differences as lines of text."""
    lines = [f"{name}: {one} in A, {other} in B" for name, one, other in found.settings]
    lines += [f"only in A: {log}" for log in found.only_a]
    lines += [f"only in B: {log}" for log in found.only_b]
    for log in found.logs:
        lines += _log_lines(log)
    return [*lines, "equal" if found.equal else "different"]


def most_different(log: "LogDifference") -> list["FrameDifference"]:
    """Return the frames that differ most, by obstacles and then by distance, in frame order."""

    def size(frame: "FrameDifference") -> tuple[int, float]:
        lost = frame.status[0] != frame.status[1]
        return len(frame.only_a) + len(frame.only_b) + lost, frame.moved_m

    return sorted(sorted(log.different, key=size, reverse=True)[:MOST_FRAMES])


def _log_lines(log: "LogDifference") -> Iterator[str]:
    frames = len(log.different)
    only_a = sum(len(frame.only_a) for frame in log.different)
    only_b = sum(len(frame.only_b) for frame in log.different)
    changed = sum(len(frame.changed) for frame in log.different)
    yield f"{log.a.label}: {many(log.frames, 'frame')}, {frames} different"
    for name, number in (("A", log.only_a), ("B", log.only_b)):
        if number:
            yield f"  {many(number, 'frame')} only in {name}"
    a, b = log.obstacles
    yield (
        f"  {many(a, 'obstacle')} in A, {b} in B: {only_a} only in A, {only_b} only in B, "
        f"{changed} changed, {a - only_a - changed} equal"
    )
    if not frames:
        return
    rows = [("frame", "A", "B", "only in A", "only in B", "changed")]
    shown = most_different(log)
    rows += [_row(frame) for frame in shown]
    yield from (f"  {line}" for line in aligned(rows, right=(0, 1, 2)))
    if frames > len(shown):
        yield f"  and {frames - len(shown)} more"


def _row(frame: "FrameDifference") -> tuple[str, str, str, str, str, str]:
    same = frame.status[0] == frame.status[1]
    of_a, of_b = map(str, frame.obstacles if same else frame.status)
    changed = [f"{len(frame.changed)} by up to {frame.moved_m:.3f} m"] if frame.changed else []
    names = dict.fromkeys(_brief(name) for name in frame.columns if name != "num_obstacles")
    changed += [_some([*names])] if names else []
    return (
        str(frame.frame),
        of_a,
        of_b,
        _metres(frame.only_a),
        _metres(frame.only_b),
        "; ".join(changed),
    )


def _brief(column: str) -> str:
    """Return the group of a column for display, else the column's name."""
    about = {"free_": "free floor", "floor_": "floor", "camera_": "camera pose"}
    return next((text for start, text in about.items() if column.startswith(start)), column)


def _metres(obstacles: Sequence["Found"]) -> str:
    from jaxdet.results.metric import distance_text

    texts = [distance_text(one.distance_m, one.depth_m) for one in obstacles]
    return _some([f"{one.obstacle} at {text}" for one, text in zip(obstacles, texts, strict=True)])


def _some(names: Sequence[str]) -> str:
    more = len(names) - MOST_NAMED
    return ", ".join([*names[:MOST_NAMED], *([f"{more} more"] if more > 0 else [])]) or "-"
