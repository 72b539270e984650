"""Runs under adverse conditions: replaced folders, links, races, full disks, clock changes."""

import fcntl
import json
import os
import re
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from jaxdet import engine
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import ConfigError, InputError, OutputError
from jaxdet.results import reading, versions
from jaxdet.results.lock import Lock
from jaxdet.results.reading import Results
from jaxdet.results.summary import Summary
from jaxdet.sim import SimConfig, write_log
from jaxdet.verify import verify
from tests.pools import same_results
from tests.runs import run_logs

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of two logs of three frames."""
    folder = tmp_path_factory.mktemp("two")
    for seed, name in enumerate("ab"):
        write_log(folder / f"{name}.mcap", SimConfig(frames=3, width=96, height=72, seed=seed))
    return folder


def run(output: Path, logs: Path, **more: Any) -> Summary:
    height = more.pop("height", None)
    pitch = None if height is None else 0.0
    config = Config(GroundConfig(camera_height_m=height, camera_pitch_rad=pitch))
    return run_logs(logs, output, config, workers=1, **more)


def test_a_working_folder_that_is_a_link_is_left_alone(two, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letters.txt").write_text("mine", encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".jaxdet").symlink_to(tmp_path / "mine")
    with pytest.raises(InputError, match=r"\.jaxdet: is a link; remove it"):
        run(tmp_path / "out", two)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["letters.txt"]
    (tmp_path / "out" / ".jaxdet").unlink()
    (tmp_path / "out" / ".jaxdet").mkdir()
    (tmp_path / "out" / ".jaxdet" / "lock").symlink_to(tmp_path / "mine" / "letters.txt")
    with pytest.raises(InputError, match="can't be written to"):
        run(tmp_path / "out", two)
    assert (tmp_path / "mine" / "letters.txt").read_text(encoding="utf-8") == "mine"


def test_results_replaced_while_they_are_opened_are_read_again(two, tmp_path, monkeypatch):
    """Old and new results have equally many rows, so the mixture is not revealed by row counts."""
    run(tmp_path, two)
    real, opened = reading.entries_of, []

    def entries(root: Any, where: Path) -> Any:
        if not opened:
            opened.append(where)
            run(tmp_path, two, overwrite=True, height=0.5)
        return real(root, where)

    monkeypatch.setattr(reading, "entries_of", entries)
    with Results(tmp_path) as results:
        assert results.stale or [log.name for log in results.logs] == ["a"]
    with Results(tmp_path) as results:
        assert results.tables().frames.num_rows == 6


def test_a_disk_that_becomes_full_during_a_run_keeps_finished_results(two, tmp_path):
    """The previous log is finished, and existing results are kept."""

    def fill(now: engine.Progress) -> None:
        if now.log == "b" and now.done == 3 and now.logs_done == 1:
            resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))

    run(tmp_path / "a", two / "b.mcap", pictures=0)
    old = (tmp_path / "a" / "b" / "manifest.json").read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OutputError, match="make room or pass another --output; 1 of 2 logs"):
            run(tmp_path / "a", two, overwrite=True, pictures=0, progress=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "a" / "b" / "manifest.json").read_bytes() == old
    assert not verify(tmp_path / "a", sample=0).findings
    assert run(tmp_path / "a", two, pictures=0).kept == {"a", "b"}
    run(tmp_path / "b", two, pictures=0)
    same_results(tmp_path / "a", tmp_path / "b")


RACE = """
import os, sys, time
from pathlib import Path
from jaxdet.errors import ConfigError
from jaxdet.results.lock import Lock

folder, end, had = Path(sys.argv[1]), float(sys.argv[2]), 0
while time.monotonic() < end:
    try:
        lock = Lock(folder / ".jaxdet" / "lock")
    except ConfigError:
        continue
    os.close(os.open(folder.parent / "marker", os.O_CREAT | os.O_EXCL))  # nobody else is here
    had += 1
    os.unlink(folder.parent / "marker")
    lock.release()
    for place in (folder / ".jaxdet", folder):
        try:
            place.rmdir()
        except OSError:
            pass
print(had)
"""


def test_a_lock_is_held_by_one_of_many_processes(tmp_path):
    """Each process removes the folder afterwards, as a run does."""
    end = str(time.monotonic() + 1)
    command = [sys.executable, "-c", RACE, str(tmp_path / "out"), end]
    ends = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    many = [subprocess.Popen(command, **ends, text=True, cwd=ROOT) for _ in range(3)]
    outputs = [process.communicate() for process in many]
    assert [process.returncode for process in many] == [0] * 3, outputs
    assert sum(int(out) for out, _ in outputs) > 5


def test_a_lock_file_replaced_before_it_is_locked_is_not_used(tmp_path, monkeypatch):
    """The previous owner removes its file after the next one has opened but not locked it."""
    path, files, flock = tmp_path / ".jaxdet" / "lock", [], fcntl.flock

    def replaced(file: int, how: int) -> None:
        if not files:
            path.unlink()
            path.touch()
        files.append(os.fstat(file).st_ino)
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", replaced)
    lock = Lock(path)
    assert len(files) == 2 and path.stat().st_ino == files[1] and path.read_bytes()
    lock.release()


@pytest.mark.parametrize("since", [4e9, -1.0, 1e300])
def test_a_lock_does_not_depend_on_the_clock(tmp_path, since):
    """The lock of the operating system decides; the time is only informational."""
    path = tmp_path / ".jaxdet" / "lock"
    path.parent.mkdir()
    owner = {"pid": 1, "host": "here", "since": since}
    path.write_text(json.dumps(owner), encoding="utf-8")
    lock = Lock(path)
    assert lock.before is None or re.fullmatch(r"process 1 on here since .*, \d+ min", lock.before)
    with pytest.raises(ConfigError, match="another run works here"):
        Lock(path)
    lock.release()


def test_texts_of_a_lock_are_escaped(tmp_path):
    path = tmp_path / ".jaxdet" / "lock"
    path.parent.mkdir()
    owner = {"pid": "\x1b[31m", "host": "here", "since": 1.0}
    path.write_text(json.dumps(owner), encoding="utf-8")
    lock = Lock(path)
    assert lock.before and lock.before.isprintable()
    lock.release()


def test_another_build_of_the_same_version_is_refused(two, tmp_path, monkeypatch):
    run(tmp_path, two / "a.mcap")
    monkeypatch.setattr("jaxdet.results.record.source_digest", lambda: "f" * 16)
    with pytest.raises(ConfigError, match=r"but jaxdet's own code was .* and is .ffff"):
        run(tmp_path, two)


def test_the_digest_of_the_source_depends_on_every_byte(tmp_path, monkeypatch):
    for name in ("a.py", "native/b.h", "tables/c.json", "d.md", "__pycache__/a.pyc"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1", encoding="utf-8")
    found = type("Spec", (), {"submodule_search_locations": [str(tmp_path)]})
    monkeypatch.setattr("importlib.util.find_spec", lambda name: found)

    def digest() -> str:
        versions.source_digest.cache_clear()
        return versions.source_digest()

    seen = [digest()]
    for name in ("a.py", "native/b.h", "tables/c.json"):
        (tmp_path / name).write_text("2", encoding="utf-8")
        seen.append(digest())
    (tmp_path / "a.py").rename(tmp_path / "e.py")
    seen.append(digest())
    assert len(set(seen)) == 5
    (tmp_path / "d.md").write_text("2", encoding="utf-8")
    (tmp_path / "__pycache__" / "a.pyc").write_text("2", encoding="utf-8")
    assert digest() == seen[-1]
    versions.source_digest.cache_clear()
