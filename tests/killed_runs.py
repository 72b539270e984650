"""End runs at their system calls, one after the other; started by ``tests/test_killed.py``.

After each end, a reader finds complete old or new results of a log, or no results. Repeating the
command then writes the results of an uninterrupted run.
"""

import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

from jaxdet.config import Config, GroundConfig
from jaxdet.engine import device, unit
from jaxdet.engine.output import OutputFolder
from jaxdet.results import durable
from jaxdet.results.durable import sha256
from jaxdet.results.layout import RUN, is_complete, is_run, log_folders
from jaxdet.results.manifest import read_manifest
from jaxdet.results.reading import open_results
from jaxdet.sim import SimConfig, write_log
from jaxdet.tracks import TrackConfig, track_results
from tests.killed import killed_at
from tests.runs import run_logs

TIMES = ("summary.json", "manifest.json")


def run(logs: Path, output: Path, **more: Any) -> None:
    """Run logs in this process."""
    config = Config(GroundConfig(source="none"))
    how = {"backend": "reference", "batch_size": 4, "workers": 1, "pictures": 1, **more}
    assert not run_logs(logs, output, config, **how).failed


def files(output: Path) -> dict[str, bytes]:
    """Return the contents of the files of a run, empty for files that contain times."""
    found = {str(p.relative_to(output)): p for p in output.rglob("*") if p.is_file()}
    return {n: b"" if p.name in TIMES else p.read_bytes() for n, p in found.items()}


def check(output: Path, wanted: set[tuple[str, ...]]) -> None:
    """Assert that results found by a reader are complete and among the wanted results."""
    if not is_run(output):
        assert not [*output.glob("*/manifest.json")]
        return
    with open_results(output) as results:
        names = {folder.name for folder in results.manifests} | {*results.stale}
    found = {name: folder for name, folder in log_folders(output).items() if is_complete(folder)}
    assert names == {*found}
    for folder in found.values():
        files_of = read_manifest(folder)["files"]
        assert all(sha256(folder / name) == about["sha256"] for name, about in files_of.items())
        own = tuple(about["sha256"] for n, about in files_of.items() if n not in TIMES)
        assert own in wanted, folder


def kinds(output: Path) -> set[tuple[str, ...]]:
    """Return the checksums of the files of each log in the results, without files with times."""
    with open_results(output) as results:
        files_of = [manifest["files"] for manifest in results.manifests.values()]
    return {tuple(a["sha256"] for n, a in t.items() if n not in TIMES) for t in files_of}


def main(folder: Path, commands: Sequence[str]) -> None:
    """End commands at their system calls.

    Args:
        folder: Empty folder.
        commands: Commands with an interval, such as ``run:17``: the command is killed at every 17th
            system call, each time in a new process, and killed again while it is repeated.
    """
    device.detect = remembered(device.detect)
    unit.detect_on_cpu = remembered(unit.detect_on_cpu)
    unit.draw_frame = remembered(unit.draw_frame)
    # A run after one that was killed leaves its logs to worker processes, which take seconds to
    # start; tests/test_killed.py kills commands with workers.
    OutputFolder.taken_over = property(lambda output: False, lambda output, value: None)  # pyright: ignore
    (logs := folder / "logs").mkdir()
    for seed, name in enumerate("ab"):
        write_log(logs / f"{name}.mcap", SimConfig(frames=4, width=96, height=72, seed=seed))
    run(logs, folder / "old")
    exchange = durable.exchange
    for command in commands:
        name, _, every = command.partition(":")
        durable.exchange = (lambda one, other: False) if name.endswith("-slow") else exchange
        (own := folder / command).mkdir()
        kills = end_at_each_call(logs, folder / "old", own, name, int(every))
        print(f"{command}: killed {kills} times")
        rmtree(own)


def end_at_each_call(logs: Path, old: Path, folder: Path, command: str, every: int) -> int:
    """Kill a command at every ``every``-th system call; return how often it was killed."""
    before = copytree(old, folder / "before")
    if command.startswith("track"):
        track_results(before, TrackConfig(min_frames=1))
        rewrite: Callable[[Path], Any] = partial(track_results, config=TrackConfig(min_frames=3))
    elif command.startswith("overwrite"):
        rewrite = partial(run, logs, overwrite=True, pictures=2)
    else:
        before, rewrite = folder / "none", partial(run, logs)
        before.mkdir()
    rewrite(copytree(before, folder / "new"))
    want, wanted = files(folder / "new"), kinds(folder / "new")
    assert RUN in want
    wanted |= kinds(before) if is_run(before) else set()
    call, kills, ended, later = 0, 0, True, max(3, every // 4)
    while ended:
        output, tries = copytree(before, folder / f"{call}"), 0
        while killed_at(call + later * tries, partial(rewrite, output)):
            tries += 1
            check(output, wanted)
        if tries and command == "run":
            rewrite(output)  # in case it was killed while cleaning up
        found = files(output)
        assert found == want, (call, [n for n in {*found, *want} if found.get(n) != want.get(n)])
        rmtree(output)
        ended, call, kills = tries > 0, call + every, kills + tries
    return kills


def remembered(compute: Callable[..., Any]) -> Callable[..., Any]:
    """Cache what the first run computes from batches, for the processes forked later."""
    known: dict[Any, Any] = {}

    def computed(frames: Any, *more: Any, **how: Any) -> Any:
        values = *more, *how.values()
        plain = [value for value in values if isinstance(value, str | int | Config)]
        key = frames.stamp_ns.tobytes() + frames.depth.tobytes(), *plain
        if key not in known:
            known[key] = compute(frames, *more, **how)
        return known[key]

    return computed


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
    os._exit(0)
