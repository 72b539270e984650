"""What parts, checksums and waiting for the disk cost: ``python -m benchmarks.parts [FRAMES]``.

Whole runs by one process, in turns: as ``jaxdet run`` makes them, and with parts that stay in
memory, no checksums and no waiting for the disk. Both turns of a round meet the same machine; the
least of all rounds is what others on it disturbed least.
"""

import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.feed_logs import FORMS, drive, write
from jaxdet import engine
from jaxdet.config import Config
from jaxdet.engine import log_run, part
from jaxdet.engine.plan import Unit
from jaxdet.io import LogOptions, find_logs
from jaxdet.results import commit, manifest

ROUNDS = 12


@contextmanager
def without_parts() -> Iterator[None]:
    """Nothing of a run is kept on the disk before it is whole, nor checked."""
    held: dict[tuple[Path, Unit], part.Part] = {}

    def save(self: part.Part, folder: Path, unit: Unit) -> None:
        held[folder, unit] = self

    def load(folder: Path, unit: Unit) -> part.Part | None:
        return held.get((folder, unit))

    with (
        mock.patch.object(part.Part, "save", save),
        mock.patch.object(part.Part, "load", load),
        mock.patch.object(log_run, "flush", lambda *paths: None),
        mock.patch.object(commit, "flush", lambda *paths: None),
        mock.patch.object(manifest, "sha256", lambda path: ""),
        mock.patch("os.fsync", lambda descriptor: None),
    ):
        yield


def run(log: Path, output: Path) -> tuple[float, float]:
    """CPU time and time of a run [s]."""
    options = engine.RunOptions(output, workers=1, pictures=0, overwrite=True)
    before = time.process_time(), time.perf_counter()
    summary = engine.run(find_logs([log]), Config(), LogOptions(), options)
    assert not summary.failed
    return time.process_time() - before[0], time.perf_counter() - before[1]


def main() -> None:
    """Measures on raw frames of 640x480, which take the least beside."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "raw.mcap"
        write(log, FORMS["raw"], drive(), count)
        run(log, Path(folder) / "out")  # compiles
        times = []
        for _ in range(ROUNDS):
            whole = run(log, Path(folder) / "out")
            with without_parts():
                times.append((whole, run(log, Path(folder) / "out")))
    print(f"{count} frames, {ROUNDS} rounds: as it is, without, cost")
    for number, what in enumerate(("CPU time", "time")):
        one, other = np.array(times)[..., number].T
        ratios = 100 * (one / other - 1)
        low, middle, high = np.percentile(ratios, [25, 50, 75])
        print(
            f"{what:<9} least {one.min():.3f} s, {other.min():.3f} s, "
            f"{100 * (one.min() / other.min() - 1):+.1f} %; of the rounds {middle:+.1f} % "
            f"(half of them {low:+.1f} to {high:+.1f})"
        )


if __name__ == "__main__":
    main()
