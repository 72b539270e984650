"""Complete logs processed by workers: equal bytes, whatever happens to the workers."""

import math
import os
import shutil
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import pytest

from jaxdet.config import Config, GroundConfig
from jaxdet.engine import placement, scheduler
from jaxdet.engine.placement import OPENING_BYTES, smallest_logs
from jaxdet.errors import ConfigError, Interrupted
from jaxdet.io import Batch, LogFiles
from jaxdet.results.summary import Summary
from jaxdet.sim import SimConfig, write_log
from tests.camera_logs import join_cameras
from tests.pools import on_this_machine, same_results
from tests.runs import run_logs

FRAMES = 11


class Killer:
    """Observer that kills its process once, in the second batch of a log."""

    def __init__(self, once: Path) -> None:
        self._once = once

    def __call__(self, batch: Batch, found: Any) -> Any:
        if batch.frames.number[0] and not self._once.exists():
            self._once.touch()
            os.kill(os.getpid(), signal.SIGKILL)

    def summary(self, seen: Any) -> Any:
        return len(seen)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of five logs of two cameras."""
    folder = tmp_path_factory.mktemp("whole")
    for seed, width in enumerate((96, 96, 128, 96, 128)):
        config = SimConfig(frames=FRAMES + seed, width=width, height=width * 3 // 4, seed=seed)
        write_log(folder / f"log_{'abcde'[seed]}.mcap", config)
    return folder


def run(folder: Path, output: Path, **options: Any) -> Summary:
    return run_logs(folder, output, **{"pictures": 2, "batch_size": 4, **options})


@pytest.fixture
def shared(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list to which the names of logs split among workers are appended."""
    names = []

    def choose(one: Any, log: Any, memory: Any) -> Any:
        names.append(log.name)
        return real(one, log, memory)

    real = placement.Machine.share_of_all
    monkeypatch.setattr(placement.Machine, "share_of_all", choose)
    return names


@pytest.fixture
def complete(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let workers process all logs completely."""
    monkeypatch.setattr(placement, "smallest_logs", lambda sizes, _: set(sizes))


@pytest.fixture(scope="module")
def alone(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("alone")
    assert not run(folder, output, workers=1).failed
    return output


def same_tables(one: Path, other: Path) -> None:
    for name in ("frames.parquet", "obstacles.parquet", "map.npz", "pictures/000000.png"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_workers_process_complete_logs(folder, alone, shared, tmp_path):
    summary = run(folder, tmp_path / "a", workers=2)
    assert not summary.failed and summary.workers == 2
    assert len(shared) <= 1  # at most one of the five logs is split
    same_results(alone, tmp_path / "a")


@pytest.mark.usefixtures("complete")
def test_a_gpu_computes_for_workers_with_complete_logs(
    folder, alone, shared, tmp_path, monkeypatch
):
    with jax.default_device(jax.devices("cpu")[0]):
        on_this_machine(monkeypatch)
        summary = run(folder, tmp_path / "a", workers=2)
    assert not summary.failed and summary.workers == 2
    assert len(shared) == 2  # the first log of each camera
    same_results(alone, tmp_path / "a")


@pytest.mark.usefixtures("complete")
def test_a_killed_worker_loses_no_log(folder, alone, shared, tmp_path):
    observers = {"odd": Killer(tmp_path / "once")}
    summary = run(folder, tmp_path / "a", workers=2, observers=observers)
    assert (tmp_path / "once").exists()
    assert not summary.failed and not any(log.lost for log in summary.logs)
    assert len(shared) == 1  # the log of the killed worker
    for log in "abcde":
        same_tables(alone / f"log_{log}", tmp_path / "a" / f"log_{log}")


@pytest.mark.usefixtures("complete")
def test_failures_in_workers_are_reported_by_the_main_process(folder, shared, tmp_path):
    broken = shutil.copytree(folder, tmp_path / "logs")
    (broken / "log_b.mcap").write_bytes(b"not a log")
    summary = run(broken, tmp_path / "a", workers=2)
    assert [log.log for log in summary.failed] == ["log_b"] and shared == []
    plain = run(broken, tmp_path / "b", workers=1)
    assert plain.failed[0].error == summary.failed[0].error
    same_results(tmp_path / "a", tmp_path / "b")


def test_a_stopped_run_is_resumed_with_the_logs_of_workers(folder, alone, shared, tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(placement, "smallest_logs", lambda sizes, _: set(sizes))
        done = []

        def take(one: Any, log: LogFiles, found: Any) -> None:
            real(one, log, found)
            done.append(log.name)
            if len(done) == 2:
                os.kill(os.getpid(), signal.SIGINT)

        real = scheduler.Scheduler._take
        patch.setattr(scheduler.Scheduler, "_take", take)
        with pytest.raises(Interrupted):
            run(folder, tmp_path / "a", workers=2)
    assert not shared
    summary = run(folder, tmp_path / "a", workers=1)
    assert not summary.failed and not {*done} & {*shared} and len(shared) <= 3
    same_results(alone, tmp_path / "a")


@pytest.mark.parametrize(
    ("sizes", "workers", "count"),
    [
        ([], 4, 0),
        ([10**9], 4, 0),
        ([10**9] * 4, 4, 4),
        ([10**9] * 20, 16, 16),
        ([10**9] * 64, 16, 64),
        ([1] * 3, 16, 3),
    ],
)
def test_logs_are_processed_completely_as_long_as_all_workers_are_busy(sizes, workers, count):
    chosen = smallest_logs({str(i): size for i, size in enumerate(sizes)}, workers)
    assert len(chosen) == count


def test_large_logs_are_split_among_workers():
    sizes = {"large": 100 * OPENING_BYTES, **{str(i): OPENING_BYTES for i in range(50)}}
    chosen = smallest_logs(sizes, 16)
    assert "large" not in chosen and 48 <= len(chosen) <= 50


@pytest.mark.usefixtures("complete")
def test_a_gpu_keeps_the_images_of_cameras_apart(tmp_path, monkeypatch):
    """All images have one size, so memory of one camera is reused for another camera."""
    (folder := tmp_path / "logs").mkdir()
    cameras = {"depth_form": "aligned"}, {"extrinsics": "topic"}, {"extrinsics": "tf"}
    for seed in range(6):
        config = SimConfig(frames=FRAMES, width=96, height=72, seed=seed, **cameras[seed // 2])
        write_log(folder / f"log_{'abcdef'[seed]}.mcap", config)
    run(folder, tmp_path / "a", workers=1)
    with jax.default_device(jax.devices("cpu")[0]):
        on_this_machine(monkeypatch)
        assert not run(folder, tmp_path / "b", workers=2).failed
    same_results(tmp_path / "a", tmp_path / "b")


def test_a_gpu_finds_that_a_camera_is_upside_down(tmp_path, shared, monkeypatch):
    """Sampled images are rotated by quarter turns, and processed as images of other cameras."""
    (folder := tmp_path / "logs").mkdir()
    for seed in range(3):
        config = SimConfig(frames=FRAMES, width=96, height=72, seed=seed, camera_roll_rad=math.pi)
        write_log(folder / f"log_{'abc'[seed]}.mcap", config)
    config = Config(ground=GroundConfig(source="estimate"))
    summary = run(folder, tmp_path / "a", workers=1, config=config)
    assert all("upside down" in " ".join(log.warnings) for log in summary.logs)
    shared.clear()
    with jax.default_device(jax.devices("cpu")[0]):
        on_this_machine(monkeypatch)
        monkeypatch.setattr(placement, "smallest_logs", lambda sizes, _: set(sizes))
        assert not run(folder, tmp_path / "b", workers=2, config=config).failed
    assert len(shared) == 1  # the first log of the camera
    same_results(tmp_path / "a", tmp_path / "b")


@pytest.mark.usefixtures("complete")
def test_a_gpu_is_used_for_the_logs_after_one_that_was_split_among_fewer_workers(
    folder, alone, shared, tmp_path, monkeypatch
):
    def plan(settings: Any, log: Any, *given: Any) -> Any:
        found = real(settings, log, *given)
        return found._replace(workers=1) if log.name == "log_e" else found

    real = placement.memory_plan
    monkeypatch.setattr(placement, "memory_plan", plan)
    with jax.default_device(jax.devices("cpu")[0]):
        on_this_machine(monkeypatch)
        summary = run(folder, tmp_path / "a", workers=2)
    assert not summary.failed
    assert shared[0] == "log_e" and len(shared) == 3  # the workers of the first log have ended
    same_results(alone, tmp_path / "a")


@pytest.mark.usefixtures("complete")
def test_logs_with_several_cameras_can_be_mixed_with_logs_of_one(folder, shared, tmp_path):
    logs = shutil.copytree(folder, tmp_path / "logs")
    cameras = {"rear": folder / "log_a.mcap", "front": folder / "log_c.mcap"}
    join_cameras(cameras, logs / "log_bb.mcap")
    run(logs, tmp_path / "alone", workers=1)
    shared.clear()
    summary = run(logs, tmp_path / "a", workers=2)
    assert not summary.failed and len(summary.logs) == 7
    assert not shared
    same_results(tmp_path / "alone", tmp_path / "a")


@pytest.mark.usefixtures("complete")
def test_complete_logs_are_updated(folder, alone, shared, tmp_path):
    logs = shutil.copytree(folder, tmp_path / "logs")
    (logs / "log_b.mcap").write_bytes(b"not a log")
    (logs / "log_d.mcap").unlink()
    assert len(run(logs, tmp_path / "a", workers=2).failed) == 1
    for name in "bd":
        shutil.copy2(folder / f"log_{name}.mcap", logs)
    summary = run(logs, tmp_path / "a", workers=2, update=True)
    assert not summary.failed and summary.kept == {"log_a", "log_c", "log_e"} and not shared
    same_results(alone, tmp_path / "a")


@pytest.mark.parametrize("workers", [1, 2])
def test_observers_that_cannot_be_pickled_are_refused(folder, tmp_path, workers):
    odd = SimpleNamespace(summary=lambda seen: seen)
    with pytest.raises(ConfigError, match="observers can't be sent to other processes"):
        run(folder, tmp_path / "a", workers=workers, observers={"odd": odd})
    assert not (tmp_path / "a").exists()
