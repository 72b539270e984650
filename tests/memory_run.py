"""Run on large images that prints its peak memory; started by ``tests/test_memory.py``.

The images are synthetic, and detection is skipped.
"""

import json
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from jaxdet.config import Config, GroundConfig
from jaxdet.engine import device, process_log
from jaxdet.io import Batch, LogFiles
from jaxdet.pipeline import detect
from tests.runs import only_log, run_logs
from tests.test_engine import FakeLog

SHAPE = 3072, 5120


class LargeLog(FakeLog):
    """Depth images of 16 megapixels."""

    depth_shape, num_frames, frames = SHAPE, 48, range(48)

    def batches(
        self, size: int, start: int = 0, stop: int | None = None, **how: Any
    ) -> Iterator[Batch]:
        for first in range(start, stop or 48, size):
            numbers = np.arange(first, min(first + size, stop or 48))
            batch = self._batch(numbers % 10, size)
            depth = np.ones((size, *SHAPE), np.uint16)
            padded = np.pad(numbers, (0, size - len(numbers)))
            frames = batch.frames._replace(depth=depth, number=padded)
            yield batch._replace(frames=frames)


@lru_cache
def nothing(count: int) -> Any:
    frames = FakeLog()._batch(np.arange(0), count).frames
    return detect(frames, Config(GroundConfig(source="none")), backend="reference")


def detect_nothing(frames: Any, config: Config, **how: Any) -> Any:
    """Return detections without obstacles."""
    return nothing(len(frames.valid))


def main(output: Path, memory: str | None) -> None:
    process_log.open_log = lambda files, options, memory: LargeLog()
    device.detect = detect_nothing
    how = {"backend": "reference", "memory": memory, "pictures": 0, "workers": 1}
    file = output.with_suffix(".mcap")
    file.write_bytes(b"made")
    logs = [LogFiles("a", (file,))]
    summary = run_logs(logs, output, Config(GroundConfig(source="none")), **how)
    assert not summary.failed, summary.failed[0].error
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) << 10
    rows = (only_log(output) / "frames.parquet").read_bytes()
    print(json.dumps({"peak": peak, "batch": summary.batch_size, "rows": rows.hex()}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2] or None)
