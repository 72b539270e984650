"""Runs that were stopped go on, and end with the bytes of an unbroken run; nothing is mixed."""

import errno
import json
import os
import pickle
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet import engine
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import device, log_run, pool, workspace
from jaxdet.engine.part import Part
from jaxdet.engine.workspace import Workspace
from jaxdet.errors import (
    ConfigError,
    InputError,
    Interrupted,
    JaxdetError,
    OutputError,
    ResultsError,
)
from jaxdet.io import LogFiles, LogOptions, find_logs
from jaxdet.pipeline import detect
from jaxdet.results.commit import commit
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import fingerprint, result_files, sha256
from jaxdet.results.writer import ResultWriter
from jaxdet.sim import SimConfig, write_log
from jaxdet.tracks import track_results
from jaxdet.verify import verify
from tests.io_helpers import make_scene
from tests.io_helpers import write_log as write_made
from tests.killed_runs import named, remembered
from tests.scenes import assert_equal, blocks, frames, level, small, smooth_depth
from tests.test_io_index import chunks_of, flip
from tests.test_workers import Odd, alive, descendants, same_results

ROOT = Path(__file__).resolve().parents[1]


FIFTY = [LogFiles(f"{number:02d}", (Path(f"{number}.mcap"),)) for number in range(50)]


COMPUTED = remembered(device.detect)
"""All logs hold the same frames."""


def opened(files: LogFiles, options: LogOptions, memory: Any) -> Any:
    return named(files.name)


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> list[LogFiles]:
    """Fifty logs of ten frames."""
    monkeypatch.setattr(log_run, "open_log", opened)
    monkeypatch.setattr(device, "detect", COMPUTED)
    return FIFTY


def run(logs: list[LogFiles], output: Path, **more: Any) -> engine.Summary:
    """Nothing is compiled, and no floor looked for."""
    height = more.pop("height", None)
    config = Config(GroundConfig(source="none", camera_height_m=height, camera_pitch_rad=0.0))
    own = {name: more.pop(name) for name in ("progress", "say") if name in more}
    how = {"backend": "reference", "batch_size": 5, "pictures": 0, "workers": 1, **more}
    return engine.run(logs, config, LogOptions(), engine.RunOptions(output, **how), **own)


def stop_at(log: str, how: Callable[[], Any]) -> Callable[[engine.Progress], None]:
    """Ends a run in the middle of a log."""

    def progress(now: engine.Progress) -> None:
        if now.log == log and now.done == 5:
            how()

    return progress


def part_of(output: Path, name: str) -> Path:
    (found,) = output.glob(f".jaxdet/logs-*/{name}.part")
    return found


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("how", ["commits", "runs 29 alone", "runs 29 updated"])
def test_whatever_system_call_is_the_last(tmp_path: Path, how: str) -> None:
    name, *arguments = how.split()
    ends = [sys.executable, "-m", f"tests.killed_{name}", str(tmp_path), *arguments]
    done = subprocess.run(ends, cwd=ROOT, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    assert min(map(int, re.findall(r"(\d+) calls", done.stdout))) > 50


@pytest.mark.slow
@pytest.mark.parametrize("how", ["1 alone", "7 shared", "1 updated"])
def test_every_system_call_of_a_run(tmp_path: Path, how: str) -> None:
    ends = [sys.executable, "-m", "tests.killed_runs", str(tmp_path), *how.split()]
    subprocess.run(ends, cwd=ROOT, check=True)


@pytest.fixture
def hangups() -> Iterator[None]:
    """SIGHUP ends a process, also where nohup runs the tests."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hangups")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 2), (signal.SIGTERM, 15), (signal.SIGHUP, 1)]
)
def test_signals_keep_what_is_done(many: list, tmp_path: Path, number: int, code: int) -> None:
    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    stop = stop_at("02", lambda: signal.raise_signal(number))
    with pytest.raises(Interrupted) as caught:
        run(many[:4], tmp_path / "a", progress=stop)
    text = "interrupted; 2 of 4 logs and 1 of 2 units of 02 are done; the same command goes on"
    assert (str(caught.value), caught.value.signal) == (text, code)
    after = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    assert after == before
    said: list[str] = []
    opened: list[str] = []

    def progress(now: engine.Progress) -> None:
        opened.extend([now.log] * (now.doing == "opening"))

    run(many[:4], tmp_path / "a", say=said.append, progress=progress)
    assert said == ["continuing: 2 of 4 logs and 1 of 2 units of 02 are there"]
    assert opened == ["02", "03"]
    run(many[:4], tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


def test_a_log_that_failed_is_not_done(many: list, tmp_path: Path, monkeypatch) -> None:
    def torn(files: LogFiles, options: LogOptions, memory: Any) -> Any:
        if files.name == "00":
            raise InputError("is torn", path=files.name)
        return opened(files, options, memory)

    monkeypatch.setattr(log_run, "open_log", torn)
    with pytest.raises(Interrupted, match=r"; 0 of 2 logs and 1 of 2 units of 01 are done"):
        run(many[:2], tmp_path, progress=stop_at("01", interrupt))


def test_a_signal_while_results_move_comes_too_late(many: list, tmp_path: Path, monkeypatch):
    def moved(*given: Any) -> None:
        interrupt()
        commit(*given)

    monkeypatch.setattr(workspace, "commit", moved)
    assert run(many[:1], tmp_path).frames == 10
    assert not verify(tmp_path, sample=0).findings


def test_the_summary_is_the_same_but_for_its_times(many: list, tmp_path: Path) -> None:
    with pytest.raises(Interrupted):
        run(many[:3], tmp_path / "a", progress=stop_at("01", interrupt))
    run(many[:3], tmp_path / "a")
    run(many[:3], tmp_path / "b")
    read = [json.loads((tmp_path / name / "summary.json").read_text("utf-8")) for name in "ab"]
    for summary in read:
        for values in (summary, *summary["logs"]):
            for name in (
                "seconds",
                "first_batch_s",
                "frames_per_s",
                "busy_s",
                "bottleneck",
                "rates",
            ):
                values.pop(name, None)
    assert read[0] == read[1]
    assert json.dumps(read[0]) == json.dumps(read[1])  # in the same order, too


def test_a_bug_in_the_49th_log_costs_that_log(many: list, tmp_path: Path, monkeypatch) -> None:
    def open_log(files: LogFiles, options: LogOptions, memory: Any) -> Any:
        if files.name == "48":
            raise ZeroDivisionError("by nothing")
        return named(files.name)

    monkeypatch.setattr(log_run, "open_log", open_log)
    summary = run(many, tmp_path)
    (failed,) = summary.failed
    assert failed.error == (
        "48: ZeroDivisionError: by nothing; a fault of jaxdet: please send its developers "
        "report_48.txt"
    )
    rows = pq.read_table(tmp_path / "frames.parquet")["log"].to_pylist()
    assert rows == [f"{number:02d}" for number in range(50) if number != 48 for _ in range(10)]
    report = (tmp_path / "report_48.txt").read_text(encoding="utf-8")
    assert 'raise ZeroDivisionError("by nothing")' in report and "48.mcap" in report


@pytest.fixture
def on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[LogFiles]:
    """Four logs of ten frames, each with a file in the folder ``disk``."""

    def open_log(files: LogFiles, options: LogOptions, memory: Any) -> Any:
        if not files.paths[0].exists():
            raise InputError("can't be read", path=str(files.paths[0]))
        return named(files.name)

    monkeypatch.setattr(log_run, "open_log", open_log)
    monkeypatch.setattr(device, "detect", COMPUTED)
    (tmp_path / "disk").mkdir()
    logs = [LogFiles(name, (tmp_path / "disk" / f"{name}.mcap",)) for name in "abcd"]
    for log in logs:
        log.paths[0].write_text(log.name, encoding="utf-8")
    return logs


@pytest.mark.parametrize(
    ("count", "last", "standing"),
    [(4, "b", "2 of 4 logs"), (1, "a", "0 of 1 logs and 1 of 2 units of a")],
)
def test_a_disk_of_logs_that_is_gone_for_a_while(
    on_disk: list, tmp_path: Path, count: int, last: str, standing: str
) -> None:
    disk = tmp_path / "disk"

    def unplug() -> None:
        disk.rename(tmp_path / "unplugged")
        if count == 1:  # the log is read no further
            raise InputError("can't be read")

    text = f"see that its disk is there; the same command goes on: {standing} are done"
    with pytest.raises(InputError, match=f"[ac].mcap: is not there any more; {text}"):
        run(on_disk[:count], tmp_path / "a", progress=stop_at(last, unplug))
    (tmp_path / "unplugged").rename(disk)
    said: list[str] = []
    assert not run(on_disk[:count], tmp_path / "a", say=said.append).failed
    assert said == [f"continuing: {standing} are there"]
    run(on_disk[:count], tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


def test_a_log_that_is_removed_costs_no_other(on_disk: list, tmp_path: Path) -> None:
    stop = stop_at("a", on_disk[1].paths[0].unlink)
    summary = run(on_disk, tmp_path / "a", progress=stop)
    assert [log.log for log in summary.failed] == ["b"] and summary.frames == 30


def test_a_log_that_changes_before_it_is_opened(on_disk: list, tmp_path: Path) -> None:
    """The manifest names what was there when the run began."""
    path = on_disk[1].paths[0]
    stop = stop_at("a", lambda: path.write_text("longer", encoding="utf-8"))
    (failed,) = run(on_disk, tmp_path / "a", progress=stop).failed
    text = "was changed since the run began; read it again when nothing writes to it"
    assert failed.error == f"{path}: {text}"


def test_no_memory_for_the_rows_of_a_log(many: list, tmp_path: Path, monkeypatch) -> None:
    """Some are in the tables by then, and would stay there without the log."""
    added: list[Any] = []

    def add(writer: ResultWriter, rows: Any) -> None:
        added.append(rows)
        if len(added) == 4:  # the second half of the second log
            raise MemoryError("malloc of size 67108864 failed")
        real(writer, rows)

    real = ResultWriter.add
    with monkeypatch.context() as patch:
        patch.setattr(ResultWriter, "add", add)
        text = "01: no memory for its rows; end other programs; the same command goes on: 2 of 3"
        with pytest.raises(OutputError, match=text):
            run(many[:3], tmp_path / "a")
    assert not (tmp_path / "a" / "frames.parquet").exists()
    said: list[str] = []
    run(many[:3], tmp_path / "a", say=said.append)
    assert said == ["continuing: 2 of 3 logs are there"]
    run(many[:3], tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


def test_times_of_what_was_there_count_when_a_run_goes_on(many: list, tmp_path: Path) -> None:
    """As its frames do."""
    with pytest.raises(Interrupted):
        run(many[:1], tmp_path, progress=stop_at("00", interrupt))
    folder, unit = part_of(tmp_path, "00-*/0/00000000").parent, engine.Unit(0, 0, 5)
    part = Part.load(folder, unit)
    assert part and part.counts.busy_s["compute"] > 0
    part.counts.busy_s["compute"] += 1000
    part.save(folder, unit)
    rates: list[Any] = []
    log = run(many[:1], tmp_path, progress=lambda now: rates.append(now.rates)).logs[0]
    assert log.frames == 10 and log.rates["compute"] == pytest.approx(10 / 1000, rel=0.01)
    assert rates[-1]["compute"] == pytest.approx(10 / 1000, rel=0.01)


def crash_in_the_49th(output: Path) -> None:
    """In a process of its own, which ends there."""
    log_run.open_log, device.detect = opened, COMPUTED
    run(FIFTY, output, progress=stop_at("48", lambda: os._exit(9)))


def test_a_crash_in_the_49th_log_keeps_48(many: list, tmp_path: Path) -> None:
    code = "import sys; from tests.test_resume import Path, crash_in_the_49th\n"
    code += "crash_in_the_49th(Path(sys.argv[1]))"
    child = [sys.executable, "-c", code, str(tmp_path / "a")]
    assert subprocess.run(child, cwd=ROOT).returncode == 9
    said: list[str] = []
    opened: list[str] = []

    def progress(now: engine.Progress) -> None:
        opened.extend([now.log] * (now.doing == "opening"))

    run(many, tmp_path / "a", workers=None, say=said.append, progress=progress)
    owner, rest = said
    assert "taken over from a run that ended without a word" in owner
    assert rest == "continuing: 48 of 50 logs and 1 of 2 units of 48 are there"
    assert opened == ["48", "49"]
    run(many, tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


def test_another_run_is_refused_with_the_reason(many: list, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "0.mcap"
    path.write_bytes(b"first")
    logs = [many[0]._replace(paths=(path,)), *many[1:3]]
    output = tmp_path / "results"
    with pytest.raises(Interrupted):
        run(logs, output, progress=stop_at("01", interrupt))

    def refused(match: str, *given: Any, **more: Any) -> None:
        with pytest.raises(ConfigError, match=match) as caught:
            run(*given, output, **more)
        assert "--overwrite to begin anew" in str(caught.value)

    refused("ground.camera_height_m was not set and is 0.5 now", logs, height=0.5)
    refused("pictures was 0 and is 3 now", logs, pictures=3)
    refused("the log 03 was not among its logs", many[3:4])
    refused("the log 02 was among its logs", logs[:2])
    with monkeypatch.context() as patch:
        patch.setattr("jaxdet.__version__", "0.2.0")
        refused('jaxdet was "0.1.0" and is "0.2.0" now', logs)
    moved = path.with_name("moved.mcap")
    moved.write_bytes(b"first")
    refused(
        rf"moved.mcap was {re.escape(str(path))}", [logs[0]._replace(paths=(moved,)), *logs[1:]]
    )
    refused("00 had 1 files and has 2 now", [logs[0]._replace(paths=(path, moved)), *logs[1:]])
    path.write_bytes(b"other")
    refused(f"{re.escape(str(path))} has changed", logs)
    said: list[str] = []
    run(logs, output, overwrite=True, say=said.append)
    assert said == [f"dropped an unfinished run: {path} has changed"]


def test_another_version_ends_the_move_of_whole_results(many, tmp_path, monkeypatch) -> None:
    """It may not know the classes of the one that was killed."""

    def killed(working: Path) -> None:
        raise OutputError("is gone", path=str(working))

    with monkeypatch.context() as patch, pytest.raises(OutputError):
        patch.setattr("jaxdet.results.commit.settle", killed)
        run(many[:1], tmp_path)
    assert not result_files(tmp_path)
    with monkeypatch.context() as patch, pytest.raises(ResultsError, match=r"is \"0\.2\.0\" now"):
        patch.setattr("jaxdet.__version__", "0.2.0")
        patch.delattr("jaxdet.results.summary.Summary")
        run(many[:1], tmp_path)
    assert not verify(tmp_path, sample=0).findings
    assert not (tmp_path / ".jaxdet").exists()


def test_overwrite_keeps_the_old_results_until_the_new_are_whole(many, tmp_path) -> None:
    def held() -> set[str]:
        return set(pq.read_table(tmp_path / "frames.parquet")["log"].to_pylist())

    run(many[:2], tmp_path)
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    known = r"holds results already \(frames\.parquet\), but "
    with pytest.raises(ConfigError, match=f"{known}the log 02 was not among its logs; give"):
        run(many[1:3], tmp_path)
    changed = r"ground\.camera_height_m was not set and is 0\.5 now"
    with pytest.raises(ConfigError, match=f"{known}{changed}; give"):
        run(many[:2], tmp_path, height=0.5)
    with pytest.raises(ConfigError, match=f"{known}pictures was 0 and is 1 now; give"):
        run(many[:2], tmp_path, pictures=1)
    for _ in range(2):
        with pytest.raises(Interrupted):
            run(many[1:3], tmp_path, overwrite=True, progress=stop_at("02", interrupt))
        assert held() == {"00", "01"}
        part_of(tmp_path, "02-*/0/00000000").unlink()
    said: list[str] = []
    run(many[1:3], tmp_path, overwrite=True, say=said.append)
    assert said == ["continuing: 1 of 2 logs are there"]
    assert held() == {"01", "02"}
    assert (tmp_path / "mine.txt").read_text(encoding="utf-8") == "mine"
    assert not (tmp_path / ".jaxdet").exists()


def test_results_of_older_versions_are_known(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    names = "frames.parquet", "map_a.npz", "map_mine.npz", "pictures/a.png", "pictures/b.png"
    for name in (*names, "../outside.png"):
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).touch()
    log = {"map": "map_a", "pictures": ["pictures/a.png", "../outside.png"]}
    (folder / "summary.json").write_text(json.dumps({"logs": [log]}), encoding="utf-8")
    want = {"frames.parquet", "summary.json", "map_a.npz", "pictures/a.png"}
    assert set(result_files(folder)) == want


def test_files_of_others_are_not_replaced(many: list, tmp_path: Path) -> None:
    """The folder may hold what it likes, but nothing of a result's name."""
    (tmp_path / "mine").mkdir()
    for name in ("mine/map_a.png", "readme.txt", "data.parquet"):
        (tmp_path / name).write_text("mine", encoding="utf-8")
    for name, problem in {
        "manifest.json": r"holds results already \(manifest\.json\)",
        "map_00.npz": r"holds map_00\.npz, which is named as results are; give another --output",
        "pictures/a.png": r"holds pictures/a\.png, which is named",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("{}", encoding="utf-8")
        with pytest.raises(ConfigError, match=problem):
            run(many[:1], tmp_path)
        assert (tmp_path / name).read_text(encoding="utf-8") == "{}"
        assert not (tmp_path / ".jaxdet").exists()
        run(many[:1], tmp_path, overwrite=True)
        for path in tmp_path.glob("*.*"):
            if path.name not in ("readme.txt", "data.parquet"):
                path.unlink()
        (tmp_path / name).unlink(missing_ok=True)
    run(many[:1], tmp_path)
    for name in ("mine/map_a.png", "readme.txt", "data.parquet"):
        assert (tmp_path / name).read_text(encoding="utf-8") == "mine"


def test_a_damaged_part_is_done_again(many: list, tmp_path: Path) -> None:
    with pytest.raises(Interrupted):
        run(many[:2], tmp_path / "a", progress=stop_at("01", interrupt))
    part = part_of(tmp_path / "a", "01-*/0/00000000")
    content = bytearray(part.read_bytes())
    content[-100] ^= 1
    part.write_bytes(content)
    assert Part.load(part.parent, engine.Unit(0, 0, 5)) is None
    run(many[:2], tmp_path / "a")
    run(many[:2], tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


def test_a_damaged_part_of_a_whole_log_is_done_again(many: list, tmp_path: Path) -> None:
    with pytest.raises(Interrupted):
        run(many[:2], tmp_path / "a", progress=stop_at("01", interrupt))
    part = part_of(tmp_path / "a", "00-*/0/00000001")
    part.write_bytes(b"")
    with pytest.raises(OutputError, match="was changed or removed; run the command again"):
        run(many[:2], tmp_path / "a")
    run(many[:2], tmp_path / "a")
    run(many[:2], tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


@pytest.mark.parametrize("whole", [False, True])
def test_a_damaged_picture_is_drawn_again(many: list, tmp_path: Path, *, whole: bool) -> None:
    """A power cut leaves what the system had not put on the disk yet empty, or away."""
    with pytest.raises(Interrupted):
        run(many[:2], tmp_path / "a", pictures=2, progress=stop_at("01", interrupt))
    log = "00" if whole else "01"
    (picture,) = (tmp_path / "a").glob(f".jaxdet/logs-*/{log}-*/0/pictures/{log}_000000.png")
    picture.write_bytes(b"")
    if whole:
        with pytest.raises(OutputError, match="was changed or removed; run the command again"):
            run(many[:2], tmp_path / "a", pictures=2)
        picture.unlink()
    run(many[:2], tmp_path / "a", pictures=2)
    run(many[:2], tmp_path / "b", pictures=2)
    same_results(tmp_path / "a", tmp_path / "b")


def test_what_is_done_of_a_log_is_on_the_disk_before_the_next(many, tmp_path, monkeypatch) -> None:
    flushed = set[str]()
    fsync = os.fsync

    def kept(handle: int) -> None:
        flushed.add(os.readlink(f"/proc/self/fd/{handle}"))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", kept)
    with pytest.raises(Interrupted):
        run(many[:2], tmp_path, pictures=2, progress=stop_at("01", interrupt))
    (folder,) = tmp_path.glob(".jaxdet/logs-*/00-*/0")
    done = {str(path) for way in ("*.part", "pictures/*") for path in folder.glob(way)}
    assert len(done) == 3 and done <= flushed


def test_two_runs_never_share_a_folder(many: list, tmp_path: Path) -> None:
    def second() -> None:
        with pytest.raises(ConfigError, match="another run works here") as caught:
            run(many[:1], tmp_path)
        owner = rf"process {os.getpid()} on \S+ since [-\d]+ [:\d]+ UTC, 0 min"
        assert re.search(owner, str(caught.value))

    run(many[:1], tmp_path, progress=stop_at("00", second))
    assert not (tmp_path / ".jaxdet").exists()


def test_control_c_while_a_folder_is_left(many: list, tmp_path: Path, monkeypatch) -> None:
    """Its lock would be this process's for good, as a notebook's."""
    release = Lock.release
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Lock, "release", lambda self: (interrupt(), release(self)))
        run(many[:1], tmp_path / "a")
    run(many[:1], tmp_path / "a", overwrite=True)


def test_the_lock_of_a_dead_run_is_taken_over(many: list, tmp_path: Path) -> None:
    code = "import os, sys; from pathlib import Path; from jaxdet.results.lock import Lock\n"
    code += "lock = Lock(Path(sys.argv[1])); os._exit(9)"
    path = tmp_path / ".jaxdet" / "lock"
    child = subprocess.Popen([sys.executable, "-c", code, str(path)], cwd=ROOT)
    assert child.wait() == 9
    (tmp_path / ".jaxdet-mine").mkdir()
    said: list[str] = []
    run(many[:1], tmp_path, say=said.append, workers=None)
    [owner] = said
    assert f"taken over from a run that ended without a word (process {child.pid} on" in owner
    assert (tmp_path / ".jaxdet-mine").is_dir()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no procfs")
def test_a_file_system_that_never_makes_folders() -> None:
    with pytest.raises(InputError, match="can't be written to"):
        Lock(Path("/proc/jaxdet/.jaxdet/lock"))


def test_a_lock_goes_with_its_folder(tmp_path: Path) -> None:
    lock = Lock(tmp_path / ".jaxdet" / "lock")
    assert lock.before is None
    lock.release()
    assert list((tmp_path / ".jaxdet").iterdir()) == []


def test_a_lock_on_a_full_disk(tmp_path: Path, monkeypatch) -> None:
    """What the last owner said stays; where nobody was there nothing is left."""

    def full(*_: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    path, said = tmp_path / ".jaxdet" / "lock", b'{"pid": 7, "host": "h", "since": 0}'
    for before in (b"", said):
        if before:
            path.parent.mkdir()
            path.write_bytes(before)
        with monkeypatch.context() as patch:
            patch.setattr(os, "pwrite", full)
            with pytest.raises(InputError, match=r"can't be written to \(No space left"):
                Lock(path)
        assert before == (path.read_bytes() if path.parent.exists() else b"")
    lock = Lock(path)
    assert lock.before is not None and lock.before.startswith("process 7 on h")
    lock.release(unsaid=True)
    assert path.read_bytes() == said


def test_work_of_another_user_is_not_trusted(many: list, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1 + tmp_path.stat().st_uid)
    said = b'{"pid": 7, "host": "h", "since": 0}'
    (tmp_path / ".jaxdet").mkdir()
    (tmp_path / ".jaxdet" / "lock").write_bytes(said)
    with pytest.raises(JaxdetError, match="another user"):
        run(many[:1], tmp_path)
    assert (tmp_path / ".jaxdet" / "lock").read_bytes() == said


def test_a_full_disk_keeps_what_is_done(many: list, tmp_path: Path) -> None:
    def fill() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OutputError) as caught:
            run(many[:3], tmp_path / "a", progress=stop_at("01", fill))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert re.search(
        r"can't be written \(File too large\); make room or give another --output; "
        r"the same command goes on: 1 of 3 logs and 1 of 2 units of 01 are done",
        str(caught.value),
    )
    run(many[:3], tmp_path / "a")
    run(many[:3], tmp_path / "b")
    same_results(tmp_path / "a", tmp_path / "b")


def test_a_disk_of_kernels_that_is_full_ends_the_run(
    many: list, tmp_path: Path, monkeypatch
) -> None:
    """It is no fault of jaxdet in each of the logs."""

    def compiled(*_: Any, **more: Any) -> Any:
        raise OSError(errno.ENOSPC, "No space left on device", "/cache/cells.o")

    with monkeypatch.context() as patch, pytest.raises(OutputError) as caught:
        patch.setattr(device, "detect", compiled)
        run(many[:2], tmp_path / "a")
    assert str(caught.value) == (
        "/cache/cells.o: kernels can't be compiled there (No space left on device); "
        "make room or set JAXDET_CACHE to another folder"
    )
    assert not (tmp_path / "a").exists()


def test_the_manifest_knows_every_file(many: list, tmp_path: Path) -> None:
    run(many[:2], tmp_path, pictures=2)
    manifest = json.loads((tmp_path / "manifest.json").read_text(encoding="utf-8"))
    names = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert set(manifest["files"]) == names - {"manifest.json"}
    for name, about in manifest["files"].items():
        path = tmp_path / name
        assert about == {"size": path.stat().st_size, "sha256": sha256(path)}
    assert list(manifest["inputs"]) == ["00", "01"]
    assert manifest["versions"]["numpy"] == np.__version__


def test_what_a_fingerprint_sees(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    content = bytearray(random.Random(0).randbytes(300_000))

    def seen() -> dict[str, Any]:
        path.write_bytes(content)
        os.utime(path, ns=(0, 0))
        return fingerprint(path)

    first = seen()
    content[150_000] ^= 1
    assert seen() == first  # the time of the last change would differ
    for place in (0, 65_535, 300_000 - 65_536, 299_999):
        content[place] ^= 1
        assert seen()["fingerprint"] != first["fingerprint"]
        content[place] ^= 1
    content += b"x"
    assert seen()["fingerprint"] != first["fingerprint"]
    assert fingerprint(tmp_path / "missing") == {"path": str(tmp_path / "missing")}


@pytest.mark.parametrize("fits", [2, 1, 0])
def test_too_little_memory_halves_the_batch(monkeypatch: pytest.MonkeyPatch, fits: int) -> None:
    calibration = small(48, 36)
    depth = smooth_depth(5, calibration.depth)
    images = frames(calibration, blocks(5, 36, 48), depth, plane=level(5))
    want = detect(images, backend="reference", with_cells=True)
    sizes: list[int] = []

    def limited(given: Any, config: Config, *, backend: str, with_cells: bool) -> Any:
        sizes.append(len(given.valid))
        if sizes[-1] > fits:
            raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 5 bytes")
        return detect(given, config, backend="reference", with_cells=with_cells)

    monkeypatch.setattr(device, "detect", limited)
    batch: Any = type("Batch", (), {"frames": images})
    own = device.OwnDevice(Config(), "jax", ahead=0)
    plane = level(5)
    if not fits:
        with pytest.raises(MemoryError):
            own.finish(own.start(batch, plane, whole=True))
        return
    found = own.finish(own.start(batch, plane, whole=True))
    assert_equal(found.whole, want)
    assert max(sizes[-2:]) <= fits


def test_a_unit_without_memory_is_tried_again_in_smaller_batches(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    write_log(log, SimConfig(frames=6, width=64, height=48))
    how = engine.RunOptions(tmp_path / "a", "reference", batch_size=6, pictures=0, workers=2)
    given = find_logs([str(log)]), Config(), LogOptions(), how
    summary = engine.run(*given, observers={"hungry": Hungry()})
    assert not summary.failed and not summary.logs[0].lost
    assert summary.logs[0].observed["hungry"] == [3, 3]


class Hungry:
    """An observer for whose memory three frames are enough."""

    def __call__(self, batch: Any, found: Any) -> int:
        if len(batch.status) > 3:
            raise MemoryError
        return len(batch.status)

    def summary(self, seen: Any) -> Any:
        return seen


def killed_runs(tmp_path: Path, count: int) -> None:
    """The same command again and again, its main process, workers or both killed at random.

    What is there stays: twice is done at most what was worked on, a unit by each worker.
    """
    chosen = random.Random(7)
    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for seed, path in enumerate(logs):
        write_log(path, SimConfig(frames=8, width=48, height=36, seed=seed))
    output = tmp_path / "results"
    command = [sys.executable, "-m", "jaxdet", "run", *map(str, logs), "--output", str(output)]
    command += ["--backend", "reference", "--batch-size", "1", "--workers", "2", "--quiet"]
    left, there = count, {}

    def parts() -> list[Path]:
        return list(output.glob(".jaxdet/logs-*/*/*/*.part"))

    while left:
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT)
        wanted = len(there) + chosen.randrange(3)
        while process.poll() is None and len(parts()) < wanted:
            time.sleep(0.01)
        time.sleep(chosen.random() / 4)
        below = [int(pid) for pid in descendants(process.pid)][2:]
        whom = chosen.choice(["main", "worker", "both"])
        victims = {"main": [], "worker": below[:1], "both": below}[whom]
        for pid in [*victims, *[process.pid] * (whom != "worker")]:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        left -= 1
        errors = process.communicate()[1]
        assert not any(alive(pid) for pid in below)
        # By their inodes, as one that is made anew has another.
        before, there = there, {path: path.stat().st_ino for path in parts()}
        assert before.items() <= there.items() or (output / "manifest.json").exists()
        if process.returncode == 0 or whom == "worker":
            assert (process.returncode, errors) == (0, "")
            if left:
                shutil.rmtree(output)
    if not (output / "manifest.json").exists():
        subprocess.run(command, cwd=ROOT, check=True)
    config, options = Config(), engine.RunOptions(tmp_path / "b", "reference", 1, workers=1)
    engine.run(
        find_logs([str(log) for log in logs]), config, LogOptions(), options, preset="wheeled"
    )
    same_results(output, tmp_path / "b")


def test_random_kills_change_nothing(tmp_path: Path) -> None:
    killed_runs(tmp_path, 3)


@pytest.mark.slow
def test_many_random_kills_change_nothing(tmp_path: Path) -> None:
    killed_runs(tmp_path, 20)


def run_that_hangs(folder: Path) -> engine.Summary:
    """At frame 9, in batches of two."""
    options = engine.RunOptions(folder / "out", "reference", 2, pictures=0)
    logs = find_logs([str(folder / "a.mcap")])
    return engine.run(logs, Config(), LogOptions(), options, observers={"odd": Odd("hang")})


@pytest.mark.slow
def test_a_log_that_hangs_one_process_is_left_to_a_worker(tmp_path: Path, monkeypatch) -> None:
    """When that was killed: workers have a time limit."""
    write_log(tmp_path / "a.mcap", SimConfig(frames=12, width=48, height=36))
    code = "import sys; from tests.test_resume import Path, run_that_hangs\n"
    code += "run_that_hangs(Path(sys.argv[1]))"
    child = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], cwd=ROOT)
    while len(list(tmp_path.glob("out/.jaxdet/logs-*/*/*/*.part"))) < 4:
        assert child.poll() is None
        time.sleep(0.1)
    child.kill()
    child.wait()
    monkeypatch.setattr(pool, "NO_PROGRESS_S", 2.0)
    summary = run_that_hangs(tmp_path)
    (lost,) = summary.logs[0].lost
    assert lost.startswith("a, frames 8 to 9: timeout (a worker process made no progress for 2 s")
    assert summary.logs[0].status == {"ok": 10, "timeout": 2}


def test_a_process_that_makes_no_progress_says_so(many: list, tmp_path: Path, monkeypatch) -> None:
    """Once; and nothing where each batch takes less."""

    def slow(frames: Any, config: Config, **how: Any) -> Any:
        time.sleep(1.0 if frames.number[0] == 5 else 0.0)
        return COMPUTED(frames, config, **how)

    monkeypatch.setattr(device, "detect", slow)
    monkeypatch.setattr(pool, "NO_PROGRESS_S", 0.4)
    said: list[str] = []
    run(many[:1], tmp_path, say=said.append)
    (line,) = said
    assert line.startswith(
        "00: no frame was finished for 0.4 s; if that is not the disk, kill this"
    )
    assert f"kill -9 {os.getpid()}" in line


def test_the_workspace_ends_empty_when_nothing_is_done(tmp_path: Path) -> None:
    with Workspace(tmp_path / "a", {"a": 1}, overwrite=False, say=print) as work:
        work.write("plan", pickle.dumps(1))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", ["", "below"])
def test_an_output_that_is_a_file(many: list, tmp_path: Path, below: str) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    problem = "can't be written to" if below else "is a file; give --output a folder"
    with pytest.raises(JaxdetError, match=problem):
        run(many[:1], tmp_path / "file" / below, overwrite=True)
    assert [path.read_text(encoding="utf-8") for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems' names are UTF-8")
def test_an_output_whose_name_is_not_utf8(many: list, tmp_path: Path) -> None:
    output = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff"))
    run(many[:1], output, pictures=1)
    track_results(output)
    report = verify(output, sample=0)
    assert not report.findings and (report.files, report.frames) == (7, 10)


def test_a_log_that_was_scanned_goes_on_so(tmp_path):
    path = write_made(tmp_path / "x.mcap", make_scene(40), compression="none", chunk_size=1)
    chunk = chunks_of(path)[11]  # of a depth image
    flip(path, chunk.chunk_start_offset + chunk.chunk_length - 8)
    config = Config(GroundConfig(source="none", camera_height_m=0.5, camera_pitch_rad=0.0))

    def run(output, stop):
        def progress(now):
            if stop and now.done == 20:
                signal.raise_signal(signal.SIGINT)

        how = engine.RunOptions(output, backend="reference", batch_size=5, pictures=0, workers=1)
        return engine.run(find_logs([str(path)]), config, LogOptions(), how, progress=progress)

    whole = run(tmp_path / "whole", False)
    assert whole.frames == 39
    with pytest.raises(Interrupted):
        run(tmp_path / "parts", True)
    run(tmp_path / "parts", False)
    for name in ("frames.parquet", "obstacles.parquet"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
