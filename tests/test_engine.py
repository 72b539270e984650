"""Runs on one machine: a row per frame, reproducible bytes, failed logs and interrupts."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet import engine
from jaxdet.cli.truth import TruthScore
from jaxdet.config import ClusterConfig, Config, GroundConfig
from jaxdet.engine import decide_planes, process_log
from jaxdet.engine.floors import evenly
from jaxdet.errors import FrameStatus, InputError, Interrupted
from jaxdet.floor.plane import flat_plane
from jaxdet.floor.units import FloorFit
from jaxdet.io import Batch, LogFiles, LogOptions, Notes, find_logs, open_log
from jaxdet.io.limits import ReadMemory
from jaxdet.results.summary import Summary
from jaxdet.sim import SimConfig, write_log
from jaxdet.types import Calibration, Frames, Intrinsics
from tests.runs import run_log, run_logs

TABLES = ("frames.parquet", "obstacles.parquet")


@pytest.fixture(scope="module")
def sim_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sim") / "sim.mcap"
    write_log(path, SimConfig(frames=7, width=320, height=240, rate_hz=5))
    return path


def run(log: Path | str, output: Path, **options: Any) -> Summary:
    config, truth = options.pop("config", Config()), options.pop("truth", None)
    observers = {"score": TruthScore(truth, config)} if truth else {}
    return run_log(log, output / "log", config, observers=observers, **options)


def test_results_depend_on_neither_backend_nor_batch_size(sim_log: Path, tmp_path: Path) -> None:
    ways = [("reference", 1), ("reference", 5), ("jax", 3), ("jax", 16)]
    for backend, batch in ways:
        run(sim_log, tmp_path / f"{backend}{batch}", backend=backend, batch_size=batch, pictures=0)
    for name in (*TABLES, "map.npz", "map.png"):
        found = {
            (tmp_path / f"{backend}{batch}" / "log" / name).read_bytes() for backend, batch in ways
        }
        assert len(found) == 1, name


def test_results_hold_rows_pictures_map_and_score(sim_log: Path, tmp_path: Path) -> None:
    summary = run(sim_log, tmp_path, pictures=3, truth=sim_log)
    tmp_path = tmp_path / "log"
    frames = pq.read_table(tmp_path / "frames.parquet").to_pylist()
    obstacles = pq.read_table(tmp_path / "obstacles.parquet").to_pylist()
    assert [row["frame"] for row in frames] == list(range(7))
    assert {row["status"] for row in frames} == {"ok"}
    counts = np.bincount([row["frame"] for row in obstacles], minlength=7)
    assert counts.tolist() == [row["num_obstacles"] for row in frames]
    keys = [(row["log"], row["frame"], row["obstacle"]) for row in obstacles]
    assert keys == sorted(keys)
    assert all(row["corners_world"] is not None for row in obstacles)
    assert frames[0]["camera_height_m"] == pytest.approx(0.30, abs=0.01)
    pictures = sorted(p.name for p in (tmp_path / "pictures").iterdir())
    assert pictures == [f"{i:06d}.png" for i in (0, 3, 6)]
    read = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert read["status"]["ok"] == 7
    assert read["logs"][0]["ground"][0]["source"] == "estimate"
    assert summary.obstacles == len(obstacles) > 0
    scores = summary.logs[0].observed["score"]
    assert scores is not None
    assert scores["frames"] == 7
    assert scores["recall"] > 0.5
    config = json.loads((tmp_path / "config.json").read_text(encoding="utf-8"))
    assert config["cluster"]["min_points"] == 10
    assert config["log"]["pair_tolerance_s"] == LogOptions().pair_tolerance_s


def test_corners_in_the_world_agree_with_the_ground_truth(sim_log: Path, tmp_path: Path) -> None:
    summary = run(sim_log, tmp_path, pictures=0)
    grid = np.load(tmp_path / "log" / "map.npz")
    with open_log(find_logs([str(sim_log)])[0]) as log:
        poses = log.read(range(7)).frames.T_world_camera
    assert poses is not None
    np.testing.assert_array_equal(grid["path"], poses[:, :2, 3])
    assert 0 < grid["counts"].max() <= summary.obstacles
    assert grid["counts"].dtype == np.int32


class FakeLog:
    """Ten frames without a floor, 100 ms apart, some of them unreadable."""

    name, base_frame, T_base_camera = "fake", "base_link", None
    description = SimpleNamespace(warnings=("odd",), notes=(), cameras_left_out=())
    num_frames, frames, camera, label = 10, range(10), "cam", "fake"
    depth_shape, color_shape, index_bytes = (48, 64), None, 2000
    has_color, color_problem = False, ""
    status = (FrameStatus.OK,) * 6 + (FrameStatus.BAD_CALIBRATION, FrameStatus.DECODE_ERROR) * 2

    def __init__(self) -> None:
        camera = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
        self.calibration = Calibration(camera)
        self.stamps_ns = np.arange(10) * 100_000_000 + 950_000_000
        self.color_stamps_ns = np.where(np.arange(10) == 6, -1, self.stamps_ns + 1)

    def __enter__(self) -> "FakeLog":
        return self

    def close(self) -> None:
        """Do nothing, as no file is open."""

    def __exit__(self, *_: object) -> None:
        assert not any(t.name.startswith("jaxdet-reader") for t in threading.enumerate())

    def described(self, notes: Notes) -> SimpleNamespace:
        return SimpleNamespace(warnings=("odd", "late"), notes=(), cameras_left_out=())

    def read(self, indices: Any, **color: Any) -> Batch:
        return self._batch(np.array(indices), len(indices))

    def batches(
        self, size: int, start: int = 0, stop: int | None = None, **how: Any
    ) -> Iterator[Batch]:
        assert how["need_color"] is False and isinstance(how["color"], frozenset)
        for first in range(start, stop or 10, size):
            yield self._batch(np.arange(first, min(first + size, 10)), size)

    def _batch(self, numbers: np.ndarray, size: int) -> Batch:
        pad = size - numbers.size
        status = tuple(self.status[i] for i in numbers)
        valid = np.array([s is FrameStatus.OK for s in status] + [False] * pad)
        depth = np.where(valid[:, None, None], np.uint16(1500), np.uint16(0))
        depth = np.broadcast_to(depth, (size, 48, 64)).copy()
        depth[: numbers.size][numbers == 2] = 0

        def padded(values: np.ndarray) -> np.ndarray:
            return np.pad(values[numbers], (0, pad))

        stamps = padded(self.stamps_ns)
        frames = Frames(depth, self.calibration, padded(np.arange(10)), stamps, valid)
        errors = tuple("" if s is FrameStatus.OK else "bad" for s in status)
        return Batch(frames, status, errors, nearest_color_ns=self.color_stamps_ns[numbers])


@pytest.fixture
def fake_logs(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> list[LogFiles]:
    def fake_open(files: LogFiles, options: LogOptions, memory: ReadMemory) -> FakeLog:
        if files.name == "broken":
            raise InputError("not an MCAP file", path="broken.mcap")
        log = FakeLog()
        log.name = log.label = files.name
        return log

    monkeypatch.setattr(process_log, "open_log", fake_open)
    folder, names = tmp_path_factory.mktemp("fake"), ("fake", "broken", "a/b")
    paths = [folder / f"{name.replace('/', '_')}.mcap" for name in names]
    for path in paths:
        path.touch()
    return [LogFiles(name, (path,)) for name, path in zip(names, paths, strict=True)]


def run_fake(logs: list[LogFiles], output: Path, size: int = 4, **kwargs: Any) -> Summary:
    return run_logs(logs, output, batch_size=size, **kwargs)


def test_every_frame_has_a_row_with_its_status(fake_logs: list, tmp_path: Path) -> None:
    summary = run_fake(fake_logs[:1], tmp_path)
    rows = pq.read_table(tmp_path / "fake" / "frames.parquet").to_pylist()
    expected = [str(s) for s in FakeLog.status]
    expected[2] = "no_depth"
    assert [row["status"] for row in rows] == expected
    assert rows[6]["color_stamp_ns"] is None
    assert rows[7]["color_stamp_ns"] == rows[7]["stamp_ns"] + 1
    assert rows[0]["camera_height_m"] is None
    assert summary.logs[0].num_bad == 5
    assert summary.logs[0].frame_errors[0] == "frame 6: bad"
    warnings = summary.logs[0].warnings
    assert any("5 of 5 frames don't show their floor" in text for text in warnings)
    assert warnings.count("odd") == warnings.count("late") == 1
    assert summary.logs[0].notes[-1] == "no map: no frame has a pose"


def test_a_failed_log_does_not_stop_the_others(fake_logs: list, tmp_path: Path) -> None:
    summary = run_fake(fake_logs, tmp_path)
    assert [log.log for log in summary.failed] == ["broken"]
    for folder, name in (("a--b", "a/b"), ("fake", "fake")):
        assert pq.read_table(tmp_path / folder / "frames.parquet")["log"].to_pylist() == [name] * 10
    assert (tmp_path / "a--b" / "pictures" / "000000.png").is_file()
    assert summary.to_dict()["failed_logs"] == 1


def test_the_summary_has_the_error_of_a_failed_log(fake_logs: list, tmp_path: Path) -> None:
    summary = run_fake(fake_logs[1:2], tmp_path / "new")
    assert len(summary.failed) == 1
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["broken", "run.json"]
    assert [path.name for path in (tmp_path / "new" / "broken").iterdir()] == ["failed.json"]


def test_an_interrupt_leaves_no_results_of_the_current_log(fake_logs: list, tmp_path: Path) -> None:
    def interrupt(now: engine.Progress) -> None:
        seen.append(now.doing)
        if not now.doing:
            assert (now.done, now.total, now.bad) == (4, 10, 1)
            assert now.bottleneck in ("read", "decode", "compute", "write")
            assert set(now.rates) <= {"read", "decode", "compute", "write"}
            raise KeyboardInterrupt

    seen: list[str] = []

    with pytest.raises(Interrupted, match="interrupted; no log is done; the same command goes on"):
        run_fake(fake_logs[:1], tmp_path / "new", progress=interrupt)
    assert not [*tmp_path.iterdir()]
    assert seen == ["opening", "looking for the floor", "starting", ""]


def test_summary_names_the_source_of_the_floor() -> None:
    log: Any = FakeLog()
    log.T_base_camera = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.4], [0, 0, 0, 1.0]])

    def source(**ground: Any) -> engine.GroundRecord:
        return decide_planes(log, Config(ground=GroundConfig(**ground)), "jax").records[0]

    assert source().source == "tf"
    assert source().height_m == pytest.approx(0.4)
    assert source(camera_height_m=0.7, camera_pitch_rad=0.0, camera_roll_rad=0.1).height_m == 0.7
    assert source(camera_height_m=0.7, camera_pitch_rad=0.0, source="tf").source == "tf"
    assert source(source="none").source == "none"
    assert source(source="estimate").source == "none"  # the scene has no floor
    log.T_base_camera[2, 3] = 0.0
    assert source().source == "none"
    with pytest.raises(InputError, match="camera-height-m"):
        source(source="tf")


def test_time_windows_of_the_floor_are_aligned_to_absolute_time(monkeypatch) -> None:
    def by_first_frame(frames: Frames, config: Config, *, backend: str) -> FloorFit:
        own = frames.valid
        height = np.full(len(own), 0.5 + int(frames.number[0]) / 100)
        plane = flat_plane(height, 0 * height, 0 * height, own)
        return FloorFit(plane, own, 0.5 * own, 0 * own, np.zeros((len(own), 8)))

    log: Any = FakeLog()
    config = Config(GroundConfig(window_s=0.5), cluster=ClusterConfig(points=True))
    monkeypatch.setattr("jaxdet.engine.floors.find_floors", by_first_frame)
    planes = decide_planes(log, config, "reference")
    starts = [record.window_start_ns for record in planes.records]
    assert starts == [500_000_000, 1_000_000_000, 1_500_000_000]
    found = planes.of(log.stamps_ns)
    np.testing.assert_allclose(found.height[:6], [0.5] + [0.51] * 5)
    assert found.valid.tolist() == [True] * 6 + [False] * 4  # the last window has no valid frame
    assert "1 of 3 time windows" in planes.warnings[0]
    assert not planes.of(np.array([0])).valid.any()
    plain = Config(config.ground)
    assert not decide_planes(log, plain, "reference").warnings


def test_evenly_spaced_samples_include_both_ends() -> None:
    assert evenly(np.arange(10), 4).tolist() == [0, 3, 6, 9]
    assert evenly(np.arange(3), 4).tolist() == [0, 1, 2]
