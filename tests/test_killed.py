"""Commands that are killed: complete results or none, old or new ones, never a mixture."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxdet.results.reading import open_results
from jaxdet.sim import SimConfig, write_log
from jaxdet.verify import verify
from tests.pools import same_results
from tests.runs import run_logs

ROOT = Path(__file__).resolve().parents[1]


WAYS = ("run", "overwrite", "overwrite-slow", "track", "track-slow")
EVERY = {"run": 17, "overwrite": 61, "overwrite-slow": 61, "track": 31, "track-slow": 31}
EACH = [pytest.param(way, 3, marks=pytest.mark.slow, id=f"{way}-each") for way in WAYS]


@pytest.mark.parametrize(("way", "every"), [*EVERY.items(), *EACH])
def test_results_are_complete_whichever_system_call_was_the_last(
    tmp_path: Path, way: str, every: int
) -> None:
    command = [sys.executable, "-m", "tests.killed_runs", str(tmp_path), str(every), way]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    assert int(re.findall(r"killed (\d+) times", done.stdout)[0]) > 5


STOPS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
MANY = [pytest.param(stop, 7, marks=pytest.mark.slow) for stop in STOPS]


@pytest.mark.parametrize(("number", "times"), [(signal.SIGKILL, 2), (signal.SIGINT, 1), *MANY])
def test_a_command_that_was_killed_with_its_workers_goes_on(
    tmp_path: Path, number: signal.Signals, times: int
) -> None:
    """The next command leaves nothing of the killed one, which ended at a random moment."""
    (logs := tmp_path / "logs").mkdir()
    for seed in range(4):
        write_log(logs / f"{seed}.mcap", SimConfig(frames=8, width=96, height=72, seed=seed))
    how = {"backend": "reference", "pictures": 0, "preset": "wheeled"}
    run_logs(logs, tmp_path / "plain", workers=1, **how)
    command = [sys.executable, "-m", "jaxdet", "run", str(logs), "-o", str(tmp_path / "out")]
    command += ["--backend", "reference", "--pictures", "0", "--workers", "2"]
    draw = random.Random(int(number))
    for _ in range(times):
        process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
        time.sleep(draw.uniform(1.0, 5.0))
        os.killpg(process.pid, number)
        assert process.wait() in (-number, 128 + number, 0)
        if (tmp_path / "out" / "run.json").exists():
            with open_results(tmp_path / "out") as results:
                results.tables()
    done = subprocess.run(command, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    assert not (tmp_path / "out" / ".jaxdet").exists()
    same_results(tmp_path / "plain", tmp_path / "out")
    assert not verify(tmp_path / "out", sample=0).findings
