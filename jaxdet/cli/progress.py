"""Progress while a run goes on: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxdet.engine import Progress, ProgressCallback

LINE_EVERY_S = 10.0
MAX_BARS = 6
"""Logs shown at a time."""


@contextmanager
def reporting(silent: bool) -> Iterator["ProgressCallback | None"]:
    """The callback for a run's progress, on standard error; None when silent."""
    if silent:
        yield None
    elif sys.stderr.isatty():
        with _bars() as callback:
            yield callback
    else:
        yield _Lines()


@contextmanager
def _bars() -> Iterator["ProgressCallback"]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} frames"),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeRemainingColumn(),
        TextColumn("{task.fields[bad]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[int, int] = {}

        def show(now: "Progress") -> None:
            if now.log_number not in tasks:
                for task in bars.tasks[: len(tasks) + 1 - MAX_BARS]:
                    bars.update(task.id, visible=False)
                name = f"{_which(now)}{now.log}"
                tasks[now.log_number] = bars.add_task(name, total=now.total, rate="", bad="")
            task = bars.tasks[tasks[now.log_number]].id
            bars.update(task, completed=now.done, rate=_rate(now), bad=_bad(now))

        yield show


class _Lines:
    """A line at most every few seconds, and one at the end of each log."""

    def __init__(self) -> None:
        self.last = time.monotonic()

    def __call__(self, now: "Progress") -> None:
        if now.done < now.total and time.monotonic() - self.last < LINE_EVERY_S:
            return
        self.last = time.monotonic()
        parts = [f"{_which(now)}{now.log}: {now.done}/{now.total} frames", _rate(now), _bad(now)]
        print(", ".join(part for part in parts if part), file=sys.stderr, flush=True)


def _which(now: "Progress") -> str:
    return f"[{now.log_number + 1}/{now.num_logs}] " if now.num_logs > 1 else ""


def _rate(now: "Progress") -> str:
    return f"{now.frames_per_s:.1f} frames/s" if now.frames_per_s else ""


def _bad(now: "Progress") -> str:
    return f"{now.bad} not ok" if now.bad else ""
