"""Worker processes: the same bytes as without, and clean ends whatever happens."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import pytest
import warp as wp

from jaxdet import engine
from jaxdet.cli.truth import TruthScore
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import local, station
from jaxdet.errors import ConfigError, FrameError, FrameStatus, InputError
from jaxdet.io import Batch, LogOptions, RescanError, find_logs
from jaxdet.presets import PRESETS
from jaxdet.sim import SimConfig, write_log
from jaxdet.stages import _upload

FRAMES = 23


class Odd:
    """An observer that fails at frame 9, in one way or another."""

    def __init__(self, way: str = "") -> None:
        self.way = way

    def __call__(self, batch: Batch, found: Any) -> Any:
        if 9 in batch.frames.number:
            self.fail()
        return batch.frames.number.tolist()

    def fail(self) -> None:
        if self.way == "bug":
            raise ZeroDivisionError("by nothing")
        if self.way == "error":
            raise InputError("no such file", path="a.mcap", remedy="look again")
        if self.way == "frame":
            raise FrameError("torn", status=FrameStatus.NO_DEPTH, path="a.mcap")
        if self.way == "rescan":
            raise RescanError("out of order", path="a.mcap")
        if self.way == "exit":
            os._exit(3)

    def summary(self, seen: Any) -> Any:
        return [numbers[0] for numbers in seen]


class Threads(Odd):
    """Says what the libraries of a worker may use."""

    def __call__(self, batch: Batch, found: Any) -> Any:
        import cv2

        from jaxdet.stages._threads import threads

        return cv2.getNumThreads(), os.environ["PJRT_NPROC"], threads()

    def summary(self, seen: Any) -> Any:
        return seen


@pytest.fixture(scope="module")
def sim_logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("workers")
    paths = [folder / "a.mcap", folder / "b.mcap"]
    for seed, path in enumerate(paths):
        write_log(path, SimConfig(frames=FRAMES, width=96, height=72, seed=seed))
    return paths


def run(logs: list[Path], output: Path, **options: Any) -> engine.Summary:
    given = find_logs([str(log) for log in logs])
    windows = Config(ground=GroundConfig(source="estimate", window_s=0.3))
    config = options.pop("config", windows)
    others = {name: options.pop(name, None) for name in ("progress", "observers")}
    how = engine.RunOptions(output, **{"pictures": 3, **options})
    return engine.run(given, config, LogOptions(), how, **others)


def test_bytes_depend_on_neither_workers_nor_batch(sim_logs, tmp_path):
    ways: list[Any] = [(1, 512), (2, 1), (2, 5)]
    summaries = []
    observers = {"score": TruthScore(sim_logs[0], Config())}
    for number, (workers, size) in enumerate(ways):
        options = {"workers": workers, "batch_size": size, "observers": observers}
        summaries.append(run(sim_logs[:1], tmp_path / str(number), **options))
        assert not summaries[-1].failed and summaries[-1].workers == workers
        sources = [record.source for record in summaries[-1].logs[0].ground]
        assert len(sources) > 1 and set(sources) == {"estimate"}
    names = ["frames.parquet", "obstacles.parquet", "map_a.npz", "map_a.png"]
    names += [f"pictures/a_{frame:06d}.png" for frame in (0, 11, 22)]
    for name in names:
        assert len({(tmp_path / str(n) / name).read_bytes() for n in range(len(ways))}) == 1, name
    first = summaries[0].logs[0]
    score = first.observed["score"]
    assert score["frames"] == FRAMES
    for summary in summaries[1:]:
        other = summary.logs[0]
        assert other.observed["score"] == pytest.approx(score, rel=1e-12, nan_ok=True)
        assert other.pictures == first.pictures
    assert not list((tmp_path / "0").glob(".jaxdet-*"))


@pytest.mark.parametrize(
    ("way", "text"),
    [
        ("bug", "a, frames 8 to 11: ZeroDivisionError: by nothing"),
        ("error", "a.mcap: no such file; look again"),
        ("frame", "a.mcap: torn"),
        ("exit", "a, frames 8 to 11: a worker process ended with code 3; its own message"),
    ],
)
def test_an_error_says_where(sim_logs, tmp_path, way, text):
    options = {"workers": 2, "batch_size": 4, "backend": "reference"}
    summary = run(sim_logs[:1], tmp_path, observers={"odd": Odd(way)}, **options)
    assert (summary.failed[0].error or "").startswith(text)
    assert not tmp_path.exists()  # as nothing is in it


@pytest.mark.parametrize("workers", [1, 2])
def test_a_log_that_is_not_as_its_index_says_is_scanned(sim_logs, tmp_path, monkeypatch, workers):
    opened = []
    odd = Odd("rescan")

    def open_log(files: Any, options: LogOptions) -> Any:
        opened.append(options.scan)
        odd.way = "" if options.scan else "rescan"
        return real(files, options)

    real = local.open_log
    monkeypatch.setattr(local, "open_log", open_log)
    options = {"workers": workers, "batch_size": 4, "backend": "reference"}
    summary = run(sim_logs[:1], tmp_path / "a", observers={"odd": odd}, **options)
    assert opened == [False, True]
    assert not summary.failed and summary.frames == summary.logs[0].frames == FRAMES
    assert summary.logs[0].observed == {"odd": [0, 4, 8, 12, 16, 20]}
    run(sim_logs[:1], tmp_path / "b", batch_size=23, backend="reference", workers=1)
    for name in ("frames.parquet", "obstacles.parquet", "map_a.npz", "pictures/a_000000.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_observers_have_names_in_the_summary(sim_logs, tmp_path):
    observers = {"odd": Odd(), "threads": Threads()}
    options = {"workers": 2, "batch_size": 8, "backend": "reference", "pictures": 0}
    run(sim_logs[:1], tmp_path, observers=observers, **options)
    read = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["logs"][0]
    assert read["odd"] == [0, 8, 16]
    assert read["threads"] == [[1, "1", 1]] * 3


def test_a_killed_worker_fails_its_log_and_no_other(sim_logs, tmp_path):
    killed, others = [], multiprocessing.active_children()

    def kill(now: engine.Progress) -> None:
        if now.done and not killed:
            mine = [p for p in multiprocessing.active_children() if p not in others]
            killed.append(mine[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    options = {"workers": 2, "batch_size": 1, "backend": "reference"}
    summary = run(sim_logs, tmp_path, progress=kill, **options)
    assert [log.log for log in summary.failed] == ["a"]
    message = summary.failed[0].error or ""
    assert message.startswith("a, frame ") and "SIGKILL" in message and "--workers" in message
    assert summary.logs[1].frames == summary.logs[1].status["ok"] == FRAMES
    assert summary.frames == FRAMES
    assert not any(alive(int(pid)) for pid in killed)


def test_short_logs_need_no_workers(tmp_path):
    def alone(count: int, devices: Any = (), **options: Any) -> list[bool]:
        how = engine.RunOptions(tmp_path, **options)
        pool: Any = SimpleNamespace(count=count, devices=devices, started=False)
        one: Any = local._LogRun(Config(), how, {}, None, pool, "a", "a")
        return [one._alone(frames) for frames in (1, 499, 500)]

    assert alone(4) == [True, True, False]
    assert alone(1) == alone(1, workers=1) == [True, True, True]
    assert alone(2, workers=2) == alone(1, devices=("gpu",)) == [False, False, False]


def test_units_keep_all_workers_busy():
    assert local._unit_frames(10**6, 16, 8, "jax") == local.UNIT_FRAMES
    assert local._unit_frames(600, 16, 8, "jax") == 16
    assert local._unit_frames(3, 16, 8, "jax") == 16
    assert local._unit_frames(10**6, 16, 8, "reference") == 16


def on_this_machine(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The way of a GPU, with the CPU in its place; the sizes of what is copied."""
    copies = []

    def copy(
        to: wp.array, source: wp.array, dest_offset: int = 0, src_offset: int = 0, **more: Any
    ) -> None:
        copies.append(more["count"])
        part = source.numpy().reshape(-1)[src_offset : src_offset + more["count"]]
        to.numpy().reshape(-1)[dest_offset : dest_offset + more["count"]] = part

    def device_from_jax(device: Any) -> wp.Device:
        return wp.get_device("cpu")

    same = {name: getattr(wp, name) for name in ("array", "zeros", "to_jax", "from_jax")}
    names = ("Stream", "synchronize_device", "synchronize_stream")
    nothing = dict.fromkeys(names, lambda device: None)
    stand_in = SimpleNamespace(copy=copy, device_from_jax=device_from_jax, **same, **nothing)
    monkeypatch.setattr(_upload, "wp", stand_in)
    lock = SimpleNamespace(unlock=lambda: None)
    monkeypatch.setattr(_upload, "PageLock", lambda memory, device: lock)
    monkeypatch.setattr(local, "gpus", lambda: (jax.devices("cpu")[0],))
    return copies


@pytest.mark.parametrize(("preset", "workers", "size"), [("wheeled", 3, 4), ("paper", 1, 5)])
def test_one_process_that_computes_for_all_gives_the_same_bytes(
    sim_logs, tmp_path, monkeypatch, preset, workers, size
):
    config = PRESETS[preset]
    observers = {"odd": Odd(), "score": TruthScore(sim_logs[0], config)}
    with jax.default_device(jax.devices("cpu")[0]):
        run(sim_logs, tmp_path / "a", workers=1, config=config, observers=observers)
        copies = on_this_machine(monkeypatch)
        options = {"workers": workers, "batch_size": size, "config": config}
        summary = run(sim_logs, tmp_path / "b", observers=observers, **options)
        few = run(sim_logs, tmp_path / "c", **options)
    assert copies and not summary.failed and not few.failed
    assert summary.workers == workers and summary.batch_size == size
    files = [path for path in (tmp_path / "a").rglob("*") if path.suffix not in ("", ".json")]
    assert len(files) >= 2 + 6
    for path in files:
        for other in "bc":
            name = path.relative_to(tmp_path / "a")
            assert (tmp_path / other / name).read_bytes() == path.read_bytes(), name
    assert summary.logs[0].observed["score"]["frames"] == FRAMES


@pytest.mark.parametrize(
    ("width", "height", "asked", "want"),
    [
        (640, 480, None, (16, 256)),
        (640, 480, 24, (16, 32)),
        (640, 480, 5, (5, 5)),
        (1920, 1080, None, (2, 32)),
        (4096, 3072, None, (1, 16)),
    ],
)
def test_the_memory_is_bounded(width, height, asked, want):
    log: Any = SimpleNamespace(image_shapes=((height, width, 3), (height, width)), calibration=None)
    there = station.Station(2, ["gpu"])
    slots, batch = there.enter(log, Config(), asked)
    again, _ = there.enter(log, Config(), asked)
    assert (slots.frames, batch) == want and again is slots
    assert slots.nbytes <= 2 * station.SLOTS * max(station.PIECE_BYTES + 8192, 5 * width * height)
    first, last = slots.views(station._attached(slots.path))[:: 2 * station.SLOTS - 1]
    assert first[0].shape == (want[0], height, width, 3) and last[1].ctypes.data % 4096 == 0
    last[1][...] = 7
    there.close()


def test_an_error_of_the_process_that_computes_reaches_the_log(sim_logs, tmp_path, monkeypatch):
    on_this_machine(monkeypatch)

    def fails(*_: Any) -> None:
        raise ArithmeticError("out of memory")

    monkeypatch.setattr(station._Lane, "start", fails)
    summary = run(sim_logs, tmp_path / "b", workers=2)
    assert len(summary.failed) == 2
    for log in summary.failed:
        assert "frames" in str(log.error) and "ArithmeticError: out of memory" in str(log.error)


@pytest.mark.parametrize(("flag", "value"), [("workers", 0), ("batch_size", 0)])
def test_workers_and_batches_are_counted_from_one(tmp_path, flag, value):
    with pytest.raises(ConfigError, match=f"--{flag.replace('_', '-')} 1 or more"):
        engine.RunOptions(tmp_path, **{flag: value})


def alive(pid: int) -> bool:
    """Whether a process is there, for 5 seconds from now."""
    for _ in range(50):
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return False
        except OSError:
            return False
        time.sleep(0.1)
    return True


def descendants(pid: int | str) -> list[str]:
    """The processes below one."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return children + [below for child in children for below in descendants(child)]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
@pytest.mark.parametrize("later", [False, True])
def test_control_c_ends_everything(sim_logs, tmp_path, later):
    """The signal goes to the whole group, as a terminal sends it, at the start or later."""
    output, shared = tmp_path / "results", set(os.listdir("/dev/shm"))
    command = [sys.executable, "-m", "jaxdet", "run", *map(str, sim_logs), "--output", str(output)]
    command += ["--workers", "2", "--batch-size", "1", "--backend", "reference"]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path
    )
    children: list[str] = []
    wanted = 4 if later else 2  # the resource tracker, the fork server, the workers
    while len(children) < wanted and process.poll() is None:
        children = descendants(process.pid)
    while later and not list(output.glob(".jaxdet-*/log-*/*.part")) and process.poll() is None:
        time.sleep(0.01)  # until the first result is there
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.strip().splitlines() == ["jaxdet: error: interrupted; nothing was written"]
    assert not output.exists() and set(os.listdir("/dev/shm")) == shared
    assert not any(alive(int(pid)) for pid in children)
