"""Worker processes: the same arrays and bytes as without, and clean ends whatever happens."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxdet import detect, engine
from jaxdet.config import Config, GroundConfig
from jaxdet.cores import cores
from jaxdet.engine import pool as pool_module
from jaxdet.engine import processes
from jaxdet.engine.pool import Pool, usual_count
from jaxdet.engine.shared import make_memory
from jaxdet.errors import ConfigError, FrameError, FrameStatus, InputError, WorkerError
from jaxdet.io import LogOptions, find_logs
from jaxdet.sim import SimConfig, write_log
from jaxdet.types import Frames
from tests.scenes import assert_equal, blocks, frames, level, small, smooth_depth

FRAMES = 512


class Square:
    """A job that fails for some numbers."""

    def __call__(self, item: Any) -> Any:
        number, array = item
        if number == 5:
            raise ZeroDivisionError("by nothing")
        if number == 6:
            raise InputError("no such file", path="a.mcap", remedy="look again")
        if number == 7:
            raise FrameError("can't be unpickled", status=FrameStatus.NO_DEPTH)
        if number == 8:
            os._exit(3)
        if number == 9:
            time.sleep(1.0)  # the others overtake it
        return number, array * array, "text", array[:0]

    def where(self, item: Any) -> str:
        return f"item {item[0]}"

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with Pool(2) as workers:
        yield workers


def items(numbers: list[int]) -> list:
    return [(n, np.full((n * 1000, 3), n, np.int64)) for n in numbers]


def test_results_come_in_order_and_keep_their_arrays(pool):
    given = items([9, 1, 2, 90, 3, 0, 4] * 3)
    found = list(pool.map(Square(), given))
    assert [number for number, *_ in found] == [number for number, _ in given]
    for (_, array), (_, square, text, empty) in zip(given, found, strict=True):
        assert np.array_equal(square, array * array) and text == "text" and empty.size == 0
        assert square.flags.writeable
    assert list(pool.map(Square(), [])) == []


def test_items_are_taken_a_few_ahead_only(pool):
    taken = []

    def count() -> Iterator[Any]:
        for item in items([1] * 50):
            taken.append(item)
            yield item

    for number, _ in enumerate(pool.map(Square(), count())):
        assert len(taken) <= number + 1 + 8


@pytest.mark.parametrize(
    ("number", "error", "text"),
    [
        (5, WorkerError, "^item 5: ZeroDivisionError: by nothing\n"),
        (6, InputError, "^a.mcap: no such file; look again\n"),
        (7, WorkerError, "^item 7: FrameError: can't be unpickled\n"),
        (8, WorkerError, "^item 8: a worker process ended with code 3; "),
    ],
)
def test_an_error_says_where(pool, number, error, text):
    before = []
    with pytest.raises(error, match=text) as raised:
        for result in pool.map(Square(), items([1, 2, 3, number, 4])):
            before.append(result[0])
    if number != 8:
        assert before == [1, 2, 3]
        assert f"item {number}, in a worker" in "".join(raised.value.__notes__)
    assert len(list(pool.map(Square(), items([1, 2])))) == 2  # it goes on with new processes


def test_a_worker_killed_between_jobs_is_replaced(pool):
    list(pool.map(Square(), items([1])))
    victim = multiprocessing.active_children()[0]
    victim.kill()
    victim.join()
    assert len(list(pool.map(Square(), items([1, 2, 3])))) == 3


def test_one_job_at_a_time(pool):
    first = pool.map(Square(), items([1, 2, 3]))
    next(first)
    with pytest.raises(RuntimeError, match="another job"):
        next(pool.map(Square(), items([1])))
    first.close()
    assert len(list(pool.map(Square(), items([1])))) == 1


def test_shared_memory_has_an_end():
    with pytest.raises(WorkerError, match="fewer workers or smaller batches"):
        make_memory(1 << 60)


def test_nothing_stays_behind():
    before = shared_memory()
    with Pool(1) as pool:
        list(pool.map(Square(), items([3, 4])))
        assert len(shared_memory()) > len(before)
        children = [worker.process.pid for worker in pool._workers]
    assert shared_memory() == before
    assert not any(alive(int(pid)) for pid in children)


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


def shared_memory() -> set[str]:
    return {path.name for path in Path("/dev/shm").glob("psm_*")}


class Threads(Square):
    """Says what the libraries of a worker may use."""

    def __call__(self, item: Any) -> Any:
        import cv2

        from jaxdet.stages._threads import threads

        return cv2.getNumThreads(), os.environ["PJRT_NPROC"], threads()


def test_a_worker_has_one_thread_for_each_library(pool):
    assert cores() >= 1
    assert list(pool.map(Threads(), items([1, 2]))) == [(1, "1", 1)] * 2


@pytest.fixture(scope="module")
def scene() -> Frames:
    calibration = small()
    turns = np.random.default_rng(3).integers(0, 24, FRAMES)
    color, depth = blocks(24, 60, 80), smooth_depth(24, calibration.depth)
    depth[5], color[7] = 0, 0
    return frames(calibration, color[turns], depth[turns], plane=level(FRAMES))


@pytest.fixture(scope="module")
def wanted(scene: Frames) -> Any:
    return detect(scene, backend="reference")


@pytest.mark.parametrize(("count", "sizes"), [(1, (511,)), (2, (1, 7, 64, 512))])
def test_frames_in_memory_for_any_batch_and_workers(scene, wanted, count, sizes):
    with engine.Workers(count) as workers:
        for size in sizes:
            assert_equal(workers.detect(scene, size), wanted)


ARRAYS = ("color", "depth", "number", "stamp_ns", "depth_stamp_ns", "valid")


def test_the_floor_is_estimated_from_all_frames_together(scene):
    part = scene._replace(**{name: getattr(scene, name)[:6] for name in ARRAYS}, plane=None)
    with engine.Workers(2) as workers:
        assert_equal(workers.detect(part, 2), detect(part, backend="reference"))


@pytest.fixture(scope="module")
def sim_logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("workers")
    paths = [folder / "a.mcap", folder / "b.mcap"]
    for seed, path in enumerate(paths):
        write_log(path, SimConfig(frames=23, width=160, height=120, seed=seed))
    return paths


def run(logs: list[Path], output: Path, **options: Any) -> engine.Summary:
    given = find_logs([str(log) for log in logs])
    progress = options.pop("progress", None)
    options = {"pictures": 3, "truth": logs[0], **options}
    config = Config(ground=GroundConfig(source="estimate", window_s=0.3))
    return engine.run(given, config, LogOptions(), engine.RunOptions(output, **options), progress)


def test_bytes_depend_on_neither_workers_nor_batch(sim_logs, tmp_path):
    ways: list[Any] = [(1, 512), (2, 1), (2, 5), (2, 5)]
    summaries = []
    for number, (workers, size) in enumerate(ways):
        output = tmp_path / str(number)
        summaries.append(run(sim_logs[:1], output, workers=workers, batch_size=size))
        assert not summaries[-1].failed and summaries[-1].workers == workers
        sources = [record.source for record in summaries[-1].logs[0].ground]
        assert len(sources) > 1 and set(sources) == {"estimate"}
    names = ["frames.parquet", "obstacles.parquet", "map_a.npz", "map_a.png"]
    names += [f"pictures/a_{frame:06d}.png" for frame in (0, 11, 22)]
    for name in names:
        assert len({(tmp_path / str(n) / name).read_bytes() for n in range(len(ways))}) == 1, name
    first = summaries[0].logs[0]
    assert first.score is not None and first.score["frames"] == 23
    for summary in summaries[1:]:
        assert summary.logs[0].score == pytest.approx(first.score, rel=1e-12, nan_ok=True)
        assert summary.logs[0].pictures == first.pictures


def test_a_killed_worker_fails_its_log_and_no_other(sim_logs, tmp_path):
    killed, others = [], multiprocessing.active_children()

    def kill(now: engine.Progress) -> None:
        if not killed:
            mine = [p for p in multiprocessing.active_children() if p not in others]
            killed.append(mine[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    summary = run(sim_logs, tmp_path, workers=2, batch_size=1, progress=kill)
    assert [log.log for log in summary.failed] == ["a"]
    message = summary.failed[0].error or ""
    assert message.startswith("a, frame ") and "SIGKILL" in message and "--workers" in message
    assert summary.logs[1].frames == summary.logs[1].status["ok"] == 23


def test_short_logs_and_gpus_need_no_workers(monkeypatch):
    for module in (pool_module, processes):
        monkeypatch.setattr(module, "cores", lambda: 4)
    for on_gpu in (False, True):
        monkeypatch.setattr(pool_module, "_has_gpu", lambda on_gpu=on_gpu: on_gpu)
        assert usual_count("jax") == (1 if on_gpu else 4)
        assert usual_count("reference") == 4
        automatic = processes.Processes(None, "jax")
        found = [automatic._shared(frames) for frames in (1, 499, 500)]
        assert found == [False, False, not on_gpu]
    assert [processes.Processes(2, "jax")._shared(n) for n in (1, 500)] == [True, True]
    assert [processes.Processes(1, "jax")._shared(n) for n in (1, 500)] == [False, False]


def test_workers_are_counted_from_one(sim_logs, tmp_path):
    with pytest.raises(ConfigError, match="--workers 1 or more"):
        run(sim_logs, tmp_path, workers=0)
    assert not tmp_path.exists()  # as nothing is in it


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
@pytest.mark.parametrize("later", [False, True])
def test_control_c_ends_everything(sim_logs, tmp_path, later):
    """The signal goes to the whole group, as a terminal sends it, at the start or later."""
    output, before = tmp_path / "results", shared_memory()
    command = [sys.executable, "-m", "jaxdet", "run", *map(str, sim_logs), "--output", str(output)]
    command += ["--workers", "2", "--batch-size", "1", "--backend", "reference"]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=tmp_path
    )
    children: list[str] = []
    while len(children) < 3 and process.poll() is None:  # the workers and the resource tracker
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    while later and shared_memory() == before and process.poll() is None:
        time.sleep(0.01)  # until the first result is there
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.strip().splitlines() == ["jaxdet: error: interrupted; nothing was written"]
    assert not output.exists() and shared_memory() == before
    assert not any(alive(int(pid)) for pid in children)
