"""Worker processes: results equal those of one process, and crashes and signals are handled."""

import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet import engine
from jaxdet.cli.truth import TruthScore
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import executors, gpu, pool, process_log, worker
from jaxdet.engine.plan import UNIT_FRAMES, divide
from jaxdet.engine.pool import TaskQueue
from jaxdet.engine.slots import SLOTS, attached
from jaxdet.engine.worker import WorkerProcess
from jaxdet.errors import (
    ConfigError,
    FrameError,
    FrameStatus,
    InputError,
    Interrupted,
    RescanError,
    WorkerError,
)
from jaxdet.io import Batch, LogOptions
from jaxdet.presets import PRESETS
from jaxdet.results.summary import Summary
from jaxdet.signals import stops_raised
from jaxdet.sim import SimConfig, write_log
from jaxdet.types import Calibration, Extrinsics, Intrinsics
from jaxdet.verify import verify
from tests.pools import on_this_machine, same_results
from tests.runs import run_logs

FRAMES = 23
START_METHODS = multiprocessing.get_all_start_methods()


class Odd:
    """Observer that fails at frame 9, in a given way."""

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
        if self.way == "hang":
            time.sleep(3600)

    def summary(self, seen: Any) -> Any:
        return [numbers[0] for numbers in seen]


class Threads(Odd):
    """Observer that records the numbers of threads of libraries in a worker."""

    def __call__(self, batch: Batch, found: Any) -> Any:
        import cv2

        from jaxdet.runtime.threads import threads

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


WINDOWS = Config(ground=GroundConfig(source="estimate", window_s=0.3, sample_frames=3))


def run(logs: list[Path], output: Path, **options: Any) -> Summary:
    config = options.pop("config", WINDOWS)
    return run_logs(logs, output, config, **{"pictures": 3, **options})


@pytest.fixture(scope="module")
def warm() -> Iterator[engine.Runner]:
    """Yield a runner whose two workers stay from test to test."""
    with engine.Runner(backend="reference", workers=2, pictures=0) as runner:
        yield runner


@pytest.fixture(scope="module")
def plain_run(sim_logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of the first log by one process, with one frame per batch."""
    folder = tmp_path_factory.mktemp("plain")
    run(sim_logs[:1], folder, workers=1, batch_size=1, backend="reference")
    return folder / "a"


def test_results_depend_on_neither_workers_nor_batch_size(sim_logs, tmp_path):
    ways: list[Any] = [(1, 512), (2, 1), (2, 5)]
    summaries = []
    observers = {"score": TruthScore(sim_logs[0], Config())}
    for number, (workers, size) in enumerate(ways):
        options = {"workers": workers, "batch_size": size, "observers": observers}
        summaries.append(run(sim_logs[:1], tmp_path / str(number), **options))
        assert not summaries[-1].failed and summaries[-1].workers == workers
        sources = [record.source for record in summaries[-1].logs[0].ground]
        assert len(sources) > 1 and set(sources) == {"estimate"}
    names = ["frames.parquet", "obstacles.parquet", "map.npz", "map.png"]
    names += [f"pictures/{frame:06d}.png" for frame in (0, 11, 22)]
    for name in names:
        assert (
            len({(tmp_path / str(n) / "a" / name).read_bytes() for n in range(len(ways))}) == 1
        ), name
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
    ],
)
def test_an_error_names_log_and_frame(sim_logs, tmp_path, warm, way, text):
    options = {"observers": {"odd": Odd(way)}, "batch_size": 4}
    summary = warm.run(sim_logs[:1], tmp_path, WINDOWS, **options)
    assert (summary.failed[0].error or "").startswith(text)
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["failed.json", *["report.txt"] * (way == "bug")]
    reports = list((tmp_path / "a").glob("*.txt"))
    for path in reports:
        assert 'raise ZeroDivisionError("by nothing")' in path.read_text(encoding="utf-8")


def test_frames_that_kill_workers_have_rows_with_their_status(sim_logs, plain_run, tmp_path):
    options = {"workers": 2, "batch_size": 4, "pictures": 0}
    summary = run(sim_logs[:1], tmp_path, observers={"odd": Odd("exit")}, **options)
    assert not summary.failed and summary.frames == FRAMES
    reason = "a worker process ended with code 3, twice"
    assert summary.logs[0].lost == [f"a, frames 8 to 11: worker_crashed ({reason})"]
    folders = tmp_path / "a", plain_run
    tables = [pq.read_table(folder / "frames.parquet").to_pylist() for folder in folders]
    for lost, row in zip(*tables, strict=True):
        if lost["frame"] in range(8, 12):
            assert (lost["status"], lost["num_obstacles"]) == ("worker_crashed", 0)
            assert lost["free_to_m"] is lost["drop_m"] is None
            same = ("log", "frame", "stamp_ns", "color_stamp_ns", "camera_frame", "world_frame")
            assert [lost[key] for key in same] == [row[key] for key in same]
        else:
            assert lost == row
    obstacles = pq.read_table(tmp_path / "a" / "obstacles.parquet")["frame"].to_pylist()
    assert not set(obstacles) & set(range(8, 12))
    report = verify(tmp_path, sample=2)
    assert not report.findings and report.notes == [f"lost in the run: {summary.logs[0].lost[0]}"]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_log_that_differs_from_its_index_is_scanned(
    sim_logs, plain_run, tmp_path, monkeypatch, workers
):
    opened = []
    odd = Odd("rescan")

    def open_log(files: Any, options: LogOptions, memory: Any) -> Any:
        opened.append(options.scan)
        odd.way = "" if options.scan else "rescan"
        return real(files, options, memory)

    real = process_log.open_log
    monkeypatch.setattr(process_log, "open_log", open_log)
    options = {"workers": workers, "batch_size": 4}
    summary = run(sim_logs[:1], tmp_path / "a", observers={"odd": odd}, **options)
    assert opened == [False, True]
    assert not summary.failed and summary.frames == summary.logs[0].frames == FRAMES
    assert summary.logs[0].observed == {"odd": [0, 4, 8, 12, 16, 20]}
    for name in ("frames.parquet", "obstacles.parquet", "map.npz", "pictures/000000.png"):
        assert (tmp_path / "a" / "a" / name).read_bytes() == (plain_run / name).read_bytes()


def test_observers_are_named_in_the_summary(sim_logs, tmp_path, warm):
    observers = {"odd": Odd(), "threads": Threads()}
    warm.run(sim_logs[:1], tmp_path, WINDOWS, observers=observers, batch_size=8)
    read = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))["logs"][0]
    assert read["odd"] == [0, 8, 16]
    assert read["threads"] == [[1, "1", 1]] * 3


@pytest.mark.parametrize("way", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_stopped_worker_loses_no_frames(
    sim_logs, plain_run, tmp_path, monkeypatch, way
):
    def once_more(*args: Any) -> Any:
        monkeypatch.setattr(pool, "NO_PROGRESS_S", 600.0)
        return real(*args)

    real = executors.InPool._retry
    monkeypatch.setattr(executors.InPool, "_retry", once_more)
    sent, others = [], multiprocessing.active_children()

    def send(now: engine.Progress) -> None:
        if now.done and not sent:
            mine = [p for p in multiprocessing.active_children() if p not in others]
            sent.append(mine[0].pid)
            os.kill(sent[0], way)
            monkeypatch.setattr(pool, "NO_PROGRESS_S", 2.0)

    options = {"workers": 2, "batch_size": 1, "backend": "reference"}
    summary = run(sim_logs[:1], tmp_path / "a", progress=send, **options)
    assert sent and not summary.failed and not summary.logs[0].lost
    same_results(tmp_path / "a" / "a", plain_run)
    assert not any(alive(int(pid)) for pid in sent)


class SlowLog:
    """Log with a frame per time window, without depth and slow to read."""

    name, T_base_camera, num_frames = "slow", None, 32
    frames, stamps_ns = range(num_frames), np.arange(num_frames) * 10**9

    def read(self, numbers: list[int]) -> Any:
        time.sleep(0.15)
        return SimpleNamespace(frames=SimpleNamespace(valid=np.zeros(len(numbers), bool)))


def test_a_worker_that_searches_many_floors_is_not_timed_out(monkeypatch):
    config = Config(ground=GroundConfig(source="estimate", window_s=1.0))
    job = executors.FloorJob(SlowLog(), config, "reference")
    with pool.Pool("reference") as workers:
        workers.call(Sleep(), 0.0, "")  # starts the worker
        monkeypatch.setattr(pool, "NO_PROGRESS_S", 4.0)
        planes = workers.call(job, 1, "")
    assert len(planes.windows) == 32


def test_time_while_the_machine_sleeps_does_not_count_for_timeouts(monkeypatch):
    times = iter((0.0, 5000.0))
    monkeypatch.setattr(pool, "time", SimpleNamespace(monotonic=lambda: next(times)))
    monkeypatch.setattr(pool, "wait", lambda pipes, seconds: [])
    one: Any = SimpleNamespace(pipe=None, pending=["a unit"], idle_s=0.0)
    found = pool.Pool("reference")
    found._workers = [one]
    assert not list(found._poll()) and 0 < one.idle_s <= 2


def test_a_worker_with_a_recent_heartbeat_is_not_timed_out():
    process: Any = SimpleNamespace(Process=lambda **given: None)
    found = worker.Worker(process, "reference", None)
    found.pending.append("a unit")
    found.idle_s = 599.0
    found._theirs.send("alive")
    assert found.receive() == [] and found.idle_s == 0 and found.ready
    assert list(found.pending) == ["a unit"]


def test_workers_killed_at_long_intervals_while_starting_are_replaced():
    with pool.Pool("reference") as workers:
        for _ in range(3):
            workers.start()
            workers._started.wait()
            workers._workers[0].process.kill()
            assert workers.call(Sleep(), 0.0, "", tries=2) == 0.0
            workers.close()


class Sleep:
    """A job whose tasks are times to sleep [s]."""

    @contextmanager
    def open(self, process: WorkerProcess) -> Iterator[Callable[[float], float]]:
        yield self._sleep

    def _sleep(self, seconds: float) -> float:
        time.sleep(seconds)
        return seconds


def test_tasks_go_to_idle_workers():
    with pool.Pool("reference", 2) as workers:
        answers = workers.each(Sleep(), TaskQueue([1.5, 0.01, 0.02]))
        assert list(answers) == [(0.01, 0.01), (0.02, 0.02), (1.5, 1.5)]


def test_units_keep_all_workers_busy():
    def sizes(frames: int, workers: int, most: int = UNIT_FRAMES) -> list[int]:
        return [unit.stop - unit.start for unit in divide(range(frames), 16, workers, most)]

    many = sizes(10**6, 8)
    assert many[0] == UNIT_FRAMES and many.count(UNIT_FRAMES // 4) >= 4 * 8
    assert set(many[many.index(UNIT_FRAMES // 4) : -1]) == {UNIT_FRAMES // 4}
    assert sizes(600, 8) == [*[16] * 37, 8]
    assert sizes(3, 1) == [3]
    assert set(sizes(10**6, 8, 16)) == {16}


@pytest.mark.parametrize("frames", [range(1), range(5, 900, 3), range(20_040)])
@pytest.mark.parametrize("workers", [1, 2, 15])
def test_units_contain_each_frame_once(frames, workers):
    units = divide(frames, 16, workers)
    held = [number for unit in units for number in frames if unit.start <= number < unit.stop]
    assert held == list(frames) and [unit.number for unit in units] == list(range(len(units)))
    if len(units) > 4 * workers > 4:
        counts = [len(range(unit.start, unit.stop, frames.step)) for unit in units]
        small = [unit for unit, count in zip(units, counts, strict=True) if count < counts[0]]
        assert len(small) >= workers and units[-len(small) :] == small


@pytest.mark.parametrize(("preset", "workers", "size"), [("wheeled", 3, 4), ("paper", 1, 5)])
def test_a_gpu_that_computes_for_workers_returns_equal_bytes(
    sim_logs, tmp_path, monkeypatch, preset, workers, size
):
    config, backend = PRESETS[preset], "reference" if preset == "paper" else "jax"
    observers = {"odd": Odd(), "score": TruthScore(sim_logs[0], config)}
    with jax.default_device(jax.devices("cpu")[0]):
        plain = {"config": config, "observers": observers, "backend": backend}
        run(sim_logs, tmp_path / "a", workers=1, **plain)
        copies = on_this_machine(monkeypatch)
        options = {"workers": workers, "batch_size": size, "config": config}
        summary = run(sim_logs, tmp_path / "b", observers=observers, **options)
        on_this_machine(monkeypatch, gpus=2)
        few = run(sim_logs, tmp_path / "c", **options)
    assert copies and not summary.failed and not few.failed
    assert summary.workers == workers and summary.batch_size == size
    files = [path for path in (tmp_path / "a").rglob("*") if path.suffix not in ("", ".json")]
    assert len(files) >= 2 * (2 + 3)
    for path in files:
        for other in "bc":
            name = path.relative_to(tmp_path / "a")
            assert (tmp_path / other / name).read_bytes() == path.read_bytes(), name
    assert summary.logs[0].observed["score"]["frames"] == FRAMES


@pytest.mark.parametrize(
    ("width", "height", "batch_size", "want"),
    [
        (640, 480, None, (16, 256)),
        (640, 480, 24, (16, 32)),
        (640, 480, 5, (5, 5)),
        (1920, 1080, None, (6, 96)),
        (4096, 3072, None, (1, 16)),
    ],
)
def test_memory_of_batches_is_bounded(width, height, batch_size, want):
    camera = Intrinsics(width, height, width, width, width / 2, height / 2)
    log: Any = SimpleNamespace(depth_shape=(height, width), calibration=Calibration(camera))
    served = gpu.served_for(log, Config(), batch_size, gpu.PIECE_FRAMES, 2)
    there = gpu.GpuThreads(served, [], ["gpu"])
    served = there.memory.served
    assert (served.frames, served.batch) == want
    depth_bytes, color_bytes, _ = served.sizes
    most = max(gpu.PIECE_BYTES + 8192, 2 * width * height)
    assert depth_bytes + color_bytes <= most
    first, last = served.slots(attached(served.path))[:: 2 * SLOTS - 1]
    assert [one.shape for one in first.images] == [(want[0], height, width)]
    assert last.images[0].ctypes.data % 4096 == 0
    last.images[0][...] = 7
    there.close()


def test_memory_of_batches_includes_colour_for_the_preset_paper():
    camera = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    wide = Intrinsics(80, 50, 60.0, 60.0, 40.0, 25.0)
    still = Extrinsics((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (0.0, 0.0, 0.0))
    for calibration, shape in (
        (Calibration(camera), (48, 64, 3)),
        (Calibration(camera, wide, still), (50, 80, 3)),
    ):
        log: Any = SimpleNamespace(depth_shape=(48, 64), calibration=calibration)
        served = gpu.served_for(log, PRESETS["paper"], 3, gpu.PIECE_FRAMES, 1)
        there = gpu.GpuThreads(served, [], ["gpu"])
        served = there.memory.served
        for number, one in enumerate(served.slots(attached(served.path))):
            depth, color = one.images
            assert color.shape == (3, *shape)
            depth[...], color[...], one.results[...] = number, number + 100, -number
        for number, one in enumerate(served.slots(attached(served.path))):
            depth, color = one.images
            assert (depth == number).all() and (color == number + 100).all()
            assert (one.results == -number).all()
        there.close()


def test_a_failure_of_the_gpu_is_the_error_of_each_log(sim_logs, tmp_path, monkeypatch):
    on_this_machine(monkeypatch)

    def fails(*_: Any) -> None:
        raise ArithmeticError("out of memory")

    monkeypatch.setattr(gpu.Gpu, "start", fails)
    summary = run(sim_logs, tmp_path / "b", workers=2)
    assert len(summary.failed) == 2
    for log in summary.failed:
        assert "frames" in str(log.error) and "ArithmeticError: out of memory" in str(log.error)


@pytest.mark.parametrize(
    ("step", "failing", "sizes"),
    [("start", (1, 2), [16, 8, 4]), ("finish", (2, 3), [16, 16, 8, 4])],
)
def test_a_device_without_enough_memory_uses_smaller_batches(
    sim_logs, plain_run, tmp_path, monkeypatch, step, failing, sizes
):
    """Memory is used up before the first batch, or after it."""
    on_this_machine(monkeypatch)
    tried = []

    def limited(one: gpu.Gpu, batch: gpu.Batch) -> Any:
        if batch.pieces or step == "start":
            tried.append(one.rows)
            if len(tried) in failing:
                raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory while trying to allocate")
        return real(one, batch)

    real = getattr(gpu.Gpu, step)
    monkeypatch.setattr(gpu.Gpu, step, limited)
    monkeypatch.setattr(gpu, "PIECE_FRAMES", 2)
    with jax.default_device(jax.devices("cpu")[0]):
        summary = run(sim_logs[:1], tmp_path / "a", workers=2, batch_size=16, pictures=0)
    assert not summary.failed and not summary.logs[0].lost and tried[: len(sizes)] == sizes
    for name in ("frames.parquet", "obstacles.parquet", "map.npz"):
        assert (tmp_path / "a" / "a" / name).read_bytes() == (plain_run / name).read_bytes()


def test_a_killed_worker_of_a_device_loses_no_frames(sim_logs, plain_run, tmp_path, monkeypatch):
    on_this_machine(monkeypatch)
    killed, others = [], multiprocessing.active_children()

    def kill(now: engine.Progress) -> None:
        if now.done and not killed:
            mine = [p for p in multiprocessing.active_children() if p not in others]
            killed.append(mine[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    with jax.default_device(jax.devices("cpu")[0]):
        options = {"workers": 2, "batch_size": 2, "pictures": 0}
        summary = run(sim_logs[:1], tmp_path / "a", progress=kill, **options)
    assert killed and not summary.failed and not summary.logs[0].lost
    for name in ("frames.parquet", "obstacles.parquet", "map.npz"):
        assert (tmp_path / "a" / "a" / name).read_bytes() == (plain_run / name).read_bytes()


@pytest.mark.parametrize(("flag", "value"), [("workers", 0), ("batch_size", 0)])
def test_workers_and_batch_size_must_be_at_least_1(flag, value):
    with pytest.raises(ConfigError, match=f"--{flag.replace('_', '-')}.* 1 "):
        engine.RunOptions(**{flag: value})


def alive(pid: int) -> bool:
    """Return whether a process still exists after 5 s."""
    for _ in range(50):
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return False
        except OSError:
            return False
        time.sleep(0.1)
    return True


def descendants(pid: int | str) -> list[str]:
    """Return the descendants of a process."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return children + [below for child in children for below in descendants(child)]


def left_over(before: set[str]) -> set[str]:
    """Return new shared memory and semaphores that no running process uses.

    Those of other programs are left out, since their processes run.
    """
    left = set(os.listdir("/dev/shm")) - before
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):  # the process ended, or belongs to another user
            text = maps.read_text()
            left = {name for name in left if f"/dev/shm/{name}" not in text}
    return left & set(os.listdir("/dev/shm"))


def command(logs: list[Path], output: Path, temporary: Path) -> subprocess.CompletedProcess[str]:
    """Run the command with workers, in a process with its own folder for temporary files."""
    words = ["run", *map(str, logs), "--output", str(output), "--workers", "2", "--pictures", "0"]
    words += ["--backend", "reference", "--quiet"]
    return subprocess.run(
        [sys.executable, "-m", "jaxdet", *words],
        env={**os.environ, "TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
    )


@pytest.mark.skipif("forkserver" not in START_METHODS, reason="no fork server on this system")
def test_a_temporary_folder_with_too_long_a_name_is_an_error(sim_logs, tmp_path):
    temporary = tmp_path / ("long" * 25)
    temporary.mkdir()
    found = command(sim_logs[:1], tmp_path / "out", temporary)
    assert found.returncode == 1 and not (tmp_path / "out").exists()
    assert found.stderr == (
        "jaxdet: error: workers can't be started (AF_UNIX path too long); "
        "set TMPDIR to a folder with a short name and room, for instance /tmp\n"
    )


def test_a_run_with_workers_leaves_no_temporary_files(sim_logs, tmp_path):
    with tempfile.TemporaryDirectory(prefix="t") as temporary:  # a folder with a short name
        found = command(sim_logs[:1], tmp_path / "out", Path(temporary))
        assert (found.returncode, found.stderr) == (0, "")
        assert not list(Path(temporary).iterdir())


def test_an_interrupt_during_the_search_for_the_floor_ends_the_run(sim_logs, tmp_path):
    """The signal arrives while XLA calls a kernel, through which no exception can propagate."""
    sent = []

    def send(frame: Any, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.endswith("_program.py"):
            sys.setprofile(None)
            sent.append(frame.f_code.co_filename)
            signal.raise_signal(signal.SIGINT)

    def progress(now: engine.Progress) -> None:
        if now.doing == "looking for the floor":
            sys.setprofile(send)

    try:
        with pytest.raises(Interrupted):
            run(sim_logs, tmp_path, progress=progress, workers=1, pictures=0)
    finally:
        sys.setprofile(None)
    assert [Path(name).name for name in sent] == ["_program.py"]


def test_a_signal_just_before_workers_start_does_not_hang(monkeypatch):
    class Late(threading.Thread):
        def start(self) -> None:
            signal.raise_signal(signal.SIGINT)
            super().start()

    monkeypatch.setattr(pool, "threading", SimpleNamespace(**{**vars(threading), "Thread": Late}))
    with pytest.raises(Interrupted), stops_raised(), pool.Pool("reference") as some:
        some.start()
    assert not some.started


@pytest.mark.parametrize("deaths", [2, 4])
def test_workers_start_again_once_if_the_fork_server_dies_while_they_start(monkeypatch, deaths):
    """If an exception leaves a thread, pytest fails the test."""
    begin, left = BaseProcess.start, iter(range(deaths))

    def start(self: Any) -> None:
        if next(left, None) is not None:
            raise EOFError("unexpected EOF")
        begin(self)

    monkeypatch.setattr(BaseProcess, "start", start)
    with pool.Pool("reference", 2) as workers:
        if deaths > workers.count:
            with pytest.raises(WorkerError, match="can't be started"):
                workers.call(Sleep(), 0.0, "", tries=2)
        else:
            assert workers.call(Sleep(), 0.0, "", tries=2) == 0.0


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
@pytest.mark.parametrize("later", [False, True])
def test_an_interrupt_ends_all_processes(sim_logs, tmp_path, later):
    """The signal is sent to the process group, as by a terminal, at the start or later.

    The same command resumes the run and writes the results of an uninterrupted one.
    """
    output, shared = tmp_path / "results", set(os.listdir("/dev/shm"))
    command = [sys.executable, "-m", "jaxdet", "run", *map(str, sim_logs), "--output", str(output)]
    command += ["--workers", "2", "--batch-size", "1", "--backend", "reference"]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path
    )
    children: list[str] = []
    wanted = 4 if later else 2  # resource tracker, fork server, workers
    while len(children) < wanted and process.poll() is None:
        children = descendants(process.pid)
    while later and not list(output.glob(".jaxdet/logs-*/*/*")) and process.poll() is None:
        time.sleep(0.01)  # until the first picture exists
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    (line,) = errors.strip().splitlines()
    assert not any(alive(int(pid)) for pid in children)
    assert not left_over(shared)
    if not later:
        return
    done = r"(no log is|1 of 2 logs are) done; the same command goes on"
    assert re.fullmatch(rf"jaxdet: error: interrupted; {done}", line)
    subprocess.run(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=True)
    assert [path.name for path in sorted(output.iterdir())] == ["a", "b", "run.json"]
