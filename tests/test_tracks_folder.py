"""Writing of tracks into a results folder: one command at a time, all files or none."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxdet.cli import main
from jaxdet.errors import ConfigError
from jaxdet.results.lock import Lock
from jaxdet.sim import SimConfig, write_log
from jaxdet.tracks import folder as tracks_folder
from jaxdet.tracks import track_results
from jaxdet.verify import verify
from tests.pools import same_results
from tests.runs import run_logs
from tests.stops import stop
from tests.test_tracks import results

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sim = SimConfig("moving", 8, 3, 8.0, 160, 120, camera_height_m=0.5)
    return results(tmp_path_factory.mktemp("tracks"), "log", sim)


def test_only_one_command_at_a_time_writes_to_a_folder(folder: Path, tmp_path: Path, monkeypatch):
    """Neither another ``jaxdet track`` nor a run starts meanwhile."""
    copy, refused = shutil.copytree(folder.parent, tmp_path / "copy"), []
    log, how = folder.parents[1] / "log.mcap", {"backend": "reference", "overwrite": True}
    others = {"track": lambda: track_results(copy), "run": lambda: run_logs(log, copy, **how)}
    plain = tracks_folder.draw_map

    def draw_map(*given: Any) -> np.ndarray:
        for name, other in others.items():
            with pytest.raises(ConfigError, match=r"copy: another run works here \(process \d+"):
                other()
            refused.append(name)
        return plain(*given)

    with monkeypatch.context() as patch:
        patch.setattr(tracks_folder, "draw_map", draw_map)
        track_results(copy)
    assert refused == ["track", "run"] and not (copy / ".jaxdet").exists()
    assert not verify(copy, sample=0).findings
    lock = Lock(copy / ".jaxdet" / "lock")
    with pytest.raises(ConfigError, match="another run works here"):
        track_results(copy)
    lock.release()


def test_two_simultaneous_commands_leave_valid_results(folder: Path, tmp_path: Path):
    copy = shutil.copytree(folder.parent, tmp_path / "copy")
    command = [sys.executable, "-m", "jaxdet", "track", str(copy)]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    printed = [process.communicate()[1] for process in both]
    ends = sorted((process.returncode, text) for process, text in zip(both, printed, strict=True))
    assert ends[0] == (0, "")
    assert ends[1] == (0, "") or (ends[1][0] == 2 and "another run works here" in ends[1][1])
    assert not verify(copy, sample=0).findings


def test_a_run_stopped_while_tracking_is_resumed(tmp_path: Path, monkeypatch, capsys):
    """The results are complete, so the same command only tracks, and reports when it is done."""
    write_log(tmp_path / "log.mcap", SimConfig(frames=6, width=96, height=72))
    command = ["run", str(tmp_path / "log.mcap"), "--backend", "reference", "--pictures", "0"]
    command += ["--tracks", "--output"]

    def run(name: str, *more: str) -> tuple[int, str, str]:
        return main([*command, str(tmp_path / name), *more]), *capsys.readouterr()

    assert run("whole", "--quiet") == (0, "", "")
    for number in (signal.SIGINT, signal.SIGTERM):
        with monkeypatch.context() as patch:
            patch.setattr(tracks_folder, "write_tracks", lambda *_, n=number: stop(n))
            code, _, printed = run("a", *["--quiet"] * (number == signal.SIGINT))
        assert code == 128 + number
        assert printed.splitlines()[-1] == (
            "jaxdet: error: interrupted while linking; run the same command again to resume"
        )
    code, out, printed = run("a")
    assert (code, printed) == (0, "")
    assert "1 log processed earlier" in out and "obstacles linked" in out
    same_results(tmp_path / "a", tmp_path / "whole")
    code, out, printed = run("a")
    assert (code, printed) == (0, "") and "nothing new" in out and "obstacles linked" not in out
    assert run("a", "--quiet") == (0, "", "")
    assert json.loads(run("a", "--json")[1])["frames"] == 6
    code, _, printed = run("a", "--quiet", "--ground.max-depth-m", "3")
    assert code == 2 and "ground.max_depth_m was 4.0 and is 3.0 now" in printed
    assert not verify(tmp_path / "a", sample=0).findings


def test_other_files_are_kept(folder: Path, tmp_path: Path):
    """Files that jaxdet did not write are kept, whatever their names."""
    copy = shutil.copytree(folder.parent, tmp_path / "copy")
    own = copy / folder.name / "mine.png"
    own.write_bytes(b"mine")
    track_results(copy)
    track_results(copy)
    assert own.read_bytes() == b"mine"
