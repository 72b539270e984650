"""Ends whole runs at their system calls; started by ``tests/test_resume.py``.

Each is asked for again until it ends by itself, and then has written what an unbroken run writes.
"""

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from shutil import copytree
from typing import Any

from jaxdet import engine
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import device, log_run, sharing
from jaxdet.engine.plan import UnitSizes
from jaxdet.errors import CamerasError, ResultsError
from jaxdet.io import LogFiles, LogOptions
from tests.killed import killed_at
from tests.test_engine import FakeLog

SIZES = UnitSizes(4, 0, 4)


LOGS = [LogFiles(name, (Path(f"{name}.mcap"),)) for name in "ab"]


def run(output: Path, logs: Sequence[LogFiles] = LOGS, **more: Any) -> engine.Summary:
    """Two logs of ten frames in units of four, one of two cameras; nothing is compiled."""
    config = Config(GroundConfig(source="none"))
    options = engine.RunOptions(output, "reference", batch_size=4, pictures=1, workers=1, **more)
    return engine.run(logs, config, LogOptions(), options)


def run_shared(output: Path) -> None:
    """By two machines that share it, one after the other, and a third."""
    place = f"{output}.parts"
    for number in (1, 2):
        run(Path(f"{output}.{number}"), parts=place, share=f"{number}/2")
    run(output, parts=place)


def run_updated(output: Path) -> None:
    """Brings results of the first log up to date."""
    with suppress(ResultsError):  # of a run that had ended, and only cleaned up
        run(output, update=True)


def files(output: Path) -> dict[str, bytes]:
    """What a run writes, but its times."""
    found = {str(p.relative_to(output)): p for p in output.rglob("*") if p.is_file()}
    found.pop(".jaxdet/lock", None)  # of a run that had ended, and only cleaned up
    assert {"summary.json", "manifest.json", "pictures/a_000000.png"} <= set(found)
    times = ("summary.json", "manifest.json")
    return {name: b"" if name in times else p.read_bytes() for name, p in found.items()}


def main(folder: Path, every: int, function: Callable[[Path], Any]) -> None:
    """Ends runs at every so many-th call, and what goes on with them at the same."""
    log_run.open_log, log_run.SIZES, sharing.SIZES = opened, SIZES, SIZES
    device.detect = remembered(device.detect)
    os.chdir(folder)
    for log in LOGS:
        log.paths[0].write_text(log.name, encoding="utf-8")
    run(folder / "whole")
    want = files(folder / "whole")
    updates = function is run_updated
    if updates:
        run(folder / "first", LOGS[:1])
    call, ended = 1, True
    while ended:
        output, tries = folder / f"{call}", 0
        if updates:
            copytree(folder / "first", output)
        while killed_at(call + 3 * tries, partial(function, output)):
            tries += 1
            there = (output / "manifest.json").exists()
            if there and not (updates or (output / ".jaxdet/commit").exists()):
                break  # it had ended, and only cleaned up
        assert files(output) == want, call
        ended, call = tries > 0, call + every
    print(f"ends at {call - every} calls")


def opened(files: LogFiles, options: LogOptions, memory: Any) -> Any:
    """The second log has two cameras."""
    if files.name == "b" and not options.camera:
        raise CamerasError(("front", "rear"))
    log = named(files.name)
    if options.camera:
        log.camera, log.label = options.camera, f"{log.name}, {options.camera}"
    return log


def remembered(detect: Callable[..., Any]) -> Callable[..., Any]:
    """Computes a batch once: the first run does, and what is forked from here has all of them."""
    known: dict[tuple[Any, ...], Any] = {}

    def found(frames: Any, config: Config, *, backend: str, with_cells: bool) -> Any:
        key = *frames.number.tolist(), config, with_cells
        if key not in known:
            known[key] = detect(frames, config, backend=backend, with_cells=with_cells)
        return known[key]

    return found


def named(name: str) -> Any:
    """A log of that name."""
    log = FakeLog()
    log.name = log.label = name
    return log


if __name__ == "__main__":
    ways = {"alone": run, "shared": run_shared, "updated": run_updated}
    main(Path(sys.argv[1]), int(sys.argv[2]), ways[sys.argv[3]])
