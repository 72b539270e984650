"""Latency of single frames: ``python -m benchmarks.latency [LOG]``.

Times ``jaxdet.Detector`` on single depth images, from NumPy arrays to obstacles, and OpenCV's
features of the same frames (grey image, Canny, Shi-Tomasi). Both are timed in turns, so that other
load on the machine affects both; the result is their ratio.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import jaxdet
from jaxdet.sim import SimConfig, write_log

CALLS, WARM = 300, 10


def features(color: np.ndarray) -> None:
    """Compute the features of the paper with OpenCV."""
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    edges = cv2.Canny(grey, 50, 100)
    cv2.goodFeaturesToTrack(edges, 1024, 0.01, 3)


def measure(path: Path) -> None:
    """Print minimum, median and 95th percentile of both, and of their ratio."""
    with jaxdet.open_log(path) as log:
        frames = [frame for frame in log[:20] if frame.status == "ok"]
        detector = jaxdet.Detector.from_log(log)

    def timed(work: Callable[[], object]) -> float:
        start = time.perf_counter()
        work()
        return 1000 * (time.perf_counter() - start)

    times = []
    for call in range(WARM + CALLS):
        color, depth = frames[call % len(frames)].color, frames[call % len(frames)].depth
        assert color is not None

        def ours(depth: np.ndarray = depth) -> None:
            detector(depth).nearest_m  # noqa: B018  (which makes the objects)

        def theirs(color: np.ndarray = color) -> None:
            features(color)

        times.append((timed(ours), timed(theirs)))
    first, rows = times[0][0], np.array(times[WARM:])
    shape = frames[0].depth.shape
    print(f"{len(rows)} calls, {shape[1]}x{shape[0]}, first call {first:.0f} ms")
    both = np.percentile(rows, [0, 50, 95], axis=0).T
    for name, values in zip(
        ("Detector, ms", "OpenCV's features, ms", "ratio"), (*both, both[0] / both[1]), strict=True
    ):
        least, median, high = values
        print(f"{name:<24} minimum {least:.2f}, median {median:.2f}, 95th percentile {high:.2f}")


def main() -> None:
    """Measure on a log, or on a simulated one."""
    if len(sys.argv) > 1:
        measure(Path(sys.argv[1]))
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "demo.mcap"
        write_log(path, SimConfig(frames=20))
        measure(path)


if __name__ == "__main__":
    main()
