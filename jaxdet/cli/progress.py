"""Progress of a run: a bar on a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from jaxdet.cli.terminal import SPINNER, on_terminal, tell

if TYPE_CHECKING:
    from jaxdet.engine import Progress, ProgressCallback

LINE_EVERY_S = 10.0
FEW_LOGS = 12
"""Maximum number of logs that get their own lines in plain output."""
MAX_NAME = 20
"""Maximum width of a log's name [column], so that the line fits in 80 columns."""


@contextmanager
def reporting(silent: bool) -> Iterator["ProgressCallback | None"]:
    """Yield the progress callback of a run, which writes to standard error; None if silent."""
    if silent:
        yield None
    elif on_terminal():
        with _bars() as callback:
            yield callback
    else:
        yield _Lines()


@contextmanager
def _bars() -> Iterator["ProgressCallback"]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.table import Column

    name = Column(no_wrap=True, overflow="ellipsis", max_width=MAX_NAME)
    columns = (
        TextColumn("{task.description}", markup=False, table_column=name),
        BarColumn(bar_width=None, table_column=Column(ratio=1)),  # takes the remaining width
        TextColumn("{task.fields[text]}", markup=False, table_column=Column(no_wrap=True)),
        TimeRemainingColumn(compact=True),
    )
    bars = Progress(*columns, console=Console(stderr=True), expand=True)
    task = bars.add_task("", total=None, text="")

    def show(now: "Progress") -> None:
        with suppress(OSError):  # the terminal may be closed
            SPINNER.stop()
            bars.start()
            if now.num_logs > 1:
                total, done, name, text = now.num_logs, now.logs_done, "logs", _logs_text(now)
            else:
                total, done, name, text = now.total, now.done, now.log, _text(now, _slowest)
            bars.update(task, description=name, text=text, total=total or None, completed=done)

    try:
        yield show
    finally:
        with suppress(OSError):
            bars.stop()


class _Lines:
    """Plain-text progress: a line at most every few seconds, and one at the end of each log."""

    def __init__(self) -> None:
        self.last = time.monotonic()
        self.finished = ""  # log or camera whose end was reported last

    def __call__(self, now: "Progress") -> None:
        unfinished = now.doing or now.done < now.total
        if now.num_logs > FEW_LOGS:
            unfinished = now.logs_done < now.num_logs
        if unfinished and time.monotonic() - self.last < LINE_EVERY_S:
            return
        if not unfinished:
            if now.log == self.finished:
                return
            self.finished = now.log
        self.last = time.monotonic()
        if now.num_logs > FEW_LOGS:
            tell(_logs_text(now))
        elif now.doing or now.total:  # otherwise the log failed, which is reported as an error
            tell(f"{_which(now)}{now.log}: {_text(now, _steps)}")


def _which(now: "Progress") -> str:
    return f"[{now.log_number + 1}/{now.num_logs}] " if now.num_logs > 1 else ""


def _logs_text(now: "Progress") -> str:
    """Return the numbers of finished and failed logs, and the progress of the current log."""
    failed = f", {now.logs_failed} failed" if now.logs_failed else ""
    name = now.log if len(now.log) <= MAX_NAME else f"{now.log[: MAX_NAME - 1]}…"
    doing = now.doing or f"{now.done}/{now.total} frames"
    return f"{now.logs_done}/{now.num_logs} logs{failed}; {name}: {doing}"


def _text(now: "Progress", steps: Callable[["Progress"], str]) -> str:
    """Return frame count, rate, slowest step and the number of frames that are not ok."""
    if now.doing:
        return now.doing
    parts = [
        f"{now.done}/{now.total} frames",
        f"{_thousands(now.frames_per_s)}/s" if now.frames_per_s else "",
        steps(now) if now.bottleneck else "",
        f"{now.bad} not ok" if now.bad else "",
    ]
    return ", ".join(part for part in parts if part)


def _slowest(now: "Progress") -> str:
    """Return a text that names the step that limits the rate."""
    return f"slowest: {now.bottleneck}"


def _steps(now: "Progress") -> str:
    """Return the slowest step and its rate, then the rates of the other steps."""
    others = [
        f"{what} {_thousands(rate)}" for what, rate in now.rates.items() if what != now.bottleneck
    ]
    slowest = f"{_slowest(now)} {_thousands(now.rates[now.bottleneck])}/s"
    return f"{slowest} ({', '.join(others)})" if others else slowest


def _thousands(rate: float) -> str:
    """Format a rate with two or three digits."""
    if rate < 1000:
        return f"{rate:.1f}" if rate < 10 else f"{rate:.0f}"
    return f"{rate / 1000:.{1 if rate < 10_000 else 0}f}k"
