"""Runs among others: folders that are replaced, links, races, full disks, clocks that jump."""

import json
import re
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from jaxdet import engine
from jaxdet.engine import log_run
from jaxdet.engine.part import Part
from jaxdet.errors import ConfigError, InputError, Interrupted, OutputError
from jaxdet.io import LogFiles
from jaxdet.results import versions
from jaxdet.results.lock import Lock
from jaxdet.results.reading import Results
from jaxdet.verify import verify
from tests.killed_runs import named
from tests.test_resume import interrupt, part_of, stop_at
from tests.test_resume import run as run_logs
from tests.test_workers import same_results

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> list[LogFiles]:
    """Two logs of ten frames."""
    fake = lambda files, options, memory: named(files.name)  # noqa: E731
    monkeypatch.setattr(log_run, "open_log", fake)
    return [LogFiles(name, (Path(f"{name}.mcap"),)) for name in "ab"]


def run(output: Path, logs: list[LogFiles], **more: Any) -> engine.Summary:
    return run_logs(logs, output, **more)


def test_a_process_that_outlives_its_run_finds_no_place_to_write_to(two, tmp_path):
    """A worker that was stopped by SIGSTOP, or hung in a file system, wakes up in the next run."""
    with pytest.raises(Interrupted):
        run(tmp_path, two, progress=stop_at("b", interrupt))
    path = part_of(tmp_path, "a-*/0/00000001")
    late, unit = Part.load(path.parent, engine.Unit(1, 5, 10)), engine.Unit(1, 5, 10)
    assert late is not None
    with pytest.raises(Interrupted):
        run(tmp_path, two, overwrite=True, height=0.5, progress=stop_at("b", interrupt))
    with pytest.raises(OutputError, match="No such file or directory"):
        late.save(path.parent, unit)
    assert part_of(tmp_path, "a-*/0/00000001") != path


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


def block(place: Path, way: str) -> None:
    """Puts something where results would be."""
    place.parent.mkdir()
    if way == "folder":
        place.mkdir()
    elif way == "file":
        place.write_text("mine", encoding="utf-8")
    else:
        place.symlink_to(way)


@pytest.mark.parametrize(
    ("name", "way", "said"),
    [
        ("frames.parquet", "folder", "is a folder, where a file of the results would be"),
        ("manifest.json", "folder", "is a folder, where a file of the results would be"),
        ("pictures", "file", "is no folder, where one of the results would be"),
        ("pictures", "nowhere", "is no folder, where one of the results would be"),
        ("pictures", "/dev/shm", "is on another disk than the folder that it is in"),
    ],
)
def test_what_results_can_not_replace_is_found_at_the_start(two, tmp_path, name, way, said):
    if way == "/dev/shm" and (
        not Path(way).is_dir() or Path(way).stat().st_dev == tmp_path.stat().st_dev
    ):
        pytest.skip("no other file system here")
    place, seen = tmp_path / "out" / name, []
    block(place, way)
    with pytest.raises(ConfigError, match=f"out/{name}: {said}; move it or give another --output"):
        run(tmp_path / "out", two, pictures=2, overwrite=True, progress=seen.append)
    assert not seen and [path.name for path in place.parent.iterdir()] == [name]
    if way in ("file", "nowhere"):
        run(tmp_path / "out", two, pictures=0)  # which has no need of the place


def test_results_that_are_replaced_while_they_are_opened(two, tmp_path, monkeypatch):
    """Of as many rows, so that nothing else tells."""
    run(tmp_path, two)
    real, opened = Results._table, []

    def table(results: Results, name: str) -> Any:
        found = real(results, name)
        if not opened:
            opened.append(name)
            run(tmp_path, two, overwrite=True, height=0.5)
        return found

    monkeypatch.setattr(Results, "_table", table)
    with pytest.raises(InputError, match="were replaced while they were opened; read them again"):
        Results(tmp_path)
    with Results(tmp_path) as results:
        assert results.summary["frames"] == 20


def test_a_disk_that_fills_up_while_tables_are_written(two, tmp_path):
    """When all parts are there."""

    def fill(now: engine.Progress) -> None:
        if now.log == "b" and now.done == 10:
            resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))

    run(tmp_path / "a", two[:1])
    old = (tmp_path / "a" / "manifest.json").read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OutputError, match="make room or give another --output; the same comm"):
            run(tmp_path / "a", two, overwrite=True, progress=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "a" / "manifest.json").read_bytes() == old
    assert not verify(tmp_path / "a", sample=0).findings
    run(tmp_path / "a", two, overwrite=True)
    run(tmp_path / "b", two)
    same_results(tmp_path / "a", tmp_path / "b")


RACE = """
import os, sys, time
from pathlib import Path
from jaxdet.errors import ConfigError
from jaxdet.results.lock import Lock
from tests.runs import run_logs

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


def test_a_lock_that_many_race_for(tmp_path):
    """Each removes the folder behind itself, as a run does."""
    end = str(time.monotonic() + 3)
    command = [sys.executable, "-c", RACE, str(tmp_path / "out"), end]
    ends = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    many = [subprocess.Popen(command, **ends, text=True, cwd=ROOT) for _ in range(3)]
    said = [process.communicate() for process in many]
    assert [process.returncode for process in many] == [0] * 3, said
    assert sum(int(out) for out, _ in said) > 20


@pytest.mark.parametrize("since", [4e9, -1.0, 1e300])
def test_a_clock_that_jumped(tmp_path, since):
    """Only the system says whether a lock is held; the time is for people."""
    path = tmp_path / ".jaxdet" / "lock"
    path.parent.mkdir()
    owner = {"pid": 1, "host": "here", "since": since}
    path.write_text(json.dumps(owner), encoding="utf-8")
    lock = Lock(path)
    assert lock.before is None or re.fullmatch(r"process 1 on here since .*, \d+ min", lock.before)
    with pytest.raises(ConfigError, match="another run works here"):
        Lock(path)
    lock.release()


def test_another_build_of_the_same_version_is_refused(two, tmp_path, monkeypatch):
    with pytest.raises(Interrupted):
        run(tmp_path, two, progress=stop_at("b", interrupt))
    monkeypatch.setattr("jaxdet.engine.record.source_digest", lambda: "f" * 16)
    with pytest.raises(ConfigError, match=r"but jaxdet's own code was .* and is .ffff"):
        run(tmp_path, two)


def test_the_digest_of_the_source_sees_every_byte(tmp_path, monkeypatch):
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
