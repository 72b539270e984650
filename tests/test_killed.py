"""Killed commands leave complete results or none, old or new ones, never a mixture."""

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


WAYS = ("run:23", "overwrite:53", "overwrite-slow:53", "track:43", "track-slow:43")
EACH = [pytest.param((f"{way.partition(':')[0]}:3",), marks=pytest.mark.slow) for way in WAYS]


@pytest.mark.parametrize(
    "ways", [WAYS, *EACH], ids=lambda ways: ways[0] if len(ways) == 1 else "all"
)
def test_results_are_complete_if_killed_before_any_system_call(
    tmp_path: Path, ways: tuple[str, ...]
) -> None:
    command = [sys.executable, "-m", "tests.killed_runs", str(tmp_path), *ways]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    kills = dict(re.findall(r"(\S+): killed (\d+) times", done.stdout))
    assert tuple(kills) == ways and all(int(count) > 5 for count in kills.values())


KILL, INT, TERM = signal.SIGKILL, signal.SIGINT, signal.SIGTERM
MANY = [pytest.param([stop] * 7, marks=pytest.mark.slow) for stop in (KILL, INT, TERM)]


@pytest.mark.parametrize("stops", [[KILL, INT, KILL], *MANY])
def test_a_command_killed_with_its_workers_is_resumed(
    tmp_path: Path, stops: list[signal.Signals]
) -> None:
    """The command is killed at a random time; the next command removes what the first one left."""
    (logs := tmp_path / "logs").mkdir()
    for seed in range(4):
        write_log(logs / f"{seed}.mcap", SimConfig(frames=8, width=96, height=72, seed=seed))
    how = {"backend": "reference", "pictures": 0, "preset": "wheeled"}
    run_logs(logs, tmp_path / "plain", workers=1, **how)
    command = [sys.executable, "-m", "jaxdet", "run", str(logs), "-o", str(tmp_path / "out")]
    command += ["--backend", "reference", "--pictures", "0", "--workers", "2"]
    draw = random.Random(len(stops))
    for number in stops:
        process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
        time.sleep(draw.uniform(0.5, 4.0))
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
