"""Memory does not grow with the log: ``pytest -m slow tests/test_long_logs.py``, one minute."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import feed_logs
from benchmarks.feed import PeakMemory
from jaxdet.sim import SimConfig

SHORT, TIMES = 640, 5
"""Number of frames of 0.4 MB in the short log, which fill the cache of chunks; and the ratio of the
lengths of both logs.
"""


def peak_mib(log: Path, output: Path) -> float:
    """Return the peak memory of all processes of a run [MiB]; shared memory counts once."""
    command = [sys.executable, "-m", "jaxdet", "run", str(log), "--output", str(output)]
    command += ["--quiet", "--pictures", "0", "--workers", "2"]
    with subprocess.Popen(command) as process, PeakMemory(process.pid) as peak:
        assert process.wait() == 0
    return peak.mib


@pytest.mark.slow
@pytest.mark.parametrize("form", ["raw", "zstd"])
def test_a_log_five_times_as_long_uses_no_more_memory(form, tmp_path, monkeypatch):
    monkeypatch.setattr(feed_logs, "CONFIG", SimConfig(frames=4, width=320, height=240))
    frames, found = feed_logs.drive(), []
    for count in (SHORT, TIMES * SHORT):
        log = tmp_path / f"{count}.mcap"
        feed_logs.write(log, feed_logs.FORMS[form], frames, count)
        found.append(peak_mib(log, tmp_path / f"{count}"))
    assert 0 < found[1] <= 1.1 * found[0] and found[1] < 2048, found
