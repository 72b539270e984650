"""Runs with obstacles made of surfaces: everything found is in the folder, whatever the split."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet import detect, engine
from jaxdet.config import Config
from jaxdet.engine import RunOptions
from jaxdet.io import LogOptions, find_logs, open_log
from jaxdet.presets import preset
from jaxdet.results.summary import LogSummary
from jaxdet.sim import SimConfig, write_log

FRAMES = 6
TABLES = ("frames.parquet", "obstacles.parquet")


def simulated(folder: Path, **settings: Any) -> Path:
    path = folder / "sim.mcap"
    write_log(path, SimConfig(frames=FRAMES, width=320, height=240, rate_hz=5, **settings))
    return path


@pytest.fixture(scope="module", params=["tf", "no tf"])
def sim_log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("surfaces"), mount_tf=request.param == "tf")


def run(log: Path, output: Path, config: Config | None = None, **options: Any) -> LogSummary:
    config = config or Config()
    given = RunOptions(output, "reference", **{"pictures": 0, **options})
    return engine.run(find_logs([str(log)]), config, LogOptions(), given).logs[0]


def tables(folder: Path) -> tuple[list[dict], list[dict]]:
    frames, obstacles = (pq.read_table(folder / f).to_pylist() for f in TABLES)
    return frames, obstacles


def test_bytes_depend_on_neither_batch_nor_workers(sim_log: Path, tmp_path: Path) -> None:
    ways = [(1, 1), (4, 1), (4, 2)]
    for batch, workers in ways:
        run(sim_log, tmp_path / f"{batch}{workers}", batch_size=batch, workers=workers)
    names = sorted(path.name for path in (tmp_path / "11").iterdir() if path.suffix != ".json")
    assert set(TABLES) <= set(names)
    for name in names:
        found = {(tmp_path / f"{b}{w}" / name).read_bytes() for b, w in ways}
        assert len(found) == 1, name


def test_rows_and_summary(sim_log: Path, tmp_path: Path) -> None:
    about = run(sim_log, tmp_path, pictures=1)
    frames, obstacles = tables(tmp_path)
    assert [row["floor_source"] for row in frames] == ["frame"] * FRAMES
    assert all(row["floor_refused"] is None for row in frames)
    for row in frames:
        assert row["camera_height_m"] == pytest.approx(0.30, abs=0.01)
        start, stop = np.array(row["free_from_m"]), np.array(row["free_to_m"])
        assert len(start) > 80 and (start <= stop + 1e-3).all() and stop.max() < 6
        assert set(row["free_end"]) <= {0, 1, 2, 3}
    assert {len(row["contour"]) % 2 for row in obstacles} == {0}
    assert all(0 < row["distance_m"] < 6 for row in obstacles)
    assert all(row["bottom_m"] < row["top_m"] for row in obstacles)
    assert dict(about.floor_sources) == {"frame": FRAMES} and about.floor_warning is None
    read = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["logs"][0]
    assert read["floor_sources"] == {"frame": FRAMES} and read["floor_refused"] == {}
    assert read["ground"][0]["source"] == "estimate"
    assert (tmp_path / "pictures" / "sim_000000.png").is_file()


def test_the_map_knows_what_is_free(tmp_path: Path) -> None:
    run(simulated(tmp_path), tmp_path / "out")
    grid = np.load(tmp_path / "out" / "map_sim.npz")
    assert grid["free"].shape == grid["counts"].shape and 0 < grid["free"].max() <= FRAMES
    assert (grid["free"] > 0).sum() > 500


def test_each_frame_is_as_alone(sim_log: Path, tmp_path: Path) -> None:
    """What is found with the prior of the log is what ``detect`` finds with it."""
    config = Config()
    with open_log(find_logs([str(sim_log)])[0]) as log:
        planes = engine.decide_planes(log, config, "reference")
        frames = log.read(range(FRAMES)).frames
    frames = frames._replace(plane=planes.of(frames.stamp_ns), T_world_camera=None)
    want = detect(frames, config, backend="reference")
    run(sim_log, tmp_path, config)
    rows, _ = tables(tmp_path)
    assert [row["num_obstacles"] for row in rows] == want.labels.num_obstacles.tolist()
    assert [row["num_features"] for row in rows] == want.features.valid.sum(axis=1).tolist()


def test_a_wrong_mount_is_corrected(tmp_path: Path) -> None:
    log = simulated(tmp_path, mount_pitch_error_rad=0.03, scene="row")
    about = run(log, tmp_path / "out")
    assert about.ground[0].pitch_rad == pytest.approx(0.1745 + 0.03, abs=0.01)
    assert "tf: 0.300 m up, 10.0° down" in about.ground[0].message


def test_far_from_the_mount_every_frame_is_refused_with_a_warning(tmp_path: Path) -> None:
    log, config = simulated(tmp_path), Config()
    flags = replace(config.ground, camera_height_m=0.7, camera_pitch_rad=0.5)
    about = run(log, tmp_path / "out", replace(config, ground=flags))
    frames, _ = tables(tmp_path / "out")
    assert {row["floor_source"] for row in frames} == {"flags"}
    assert {row["camera_height_m"] for row in frames} == {np.float32(0.7)}
    assert about.floor_sources == {"flags": FRAMES}
    assert about.floor_refused.total() == FRAMES
    assert about.floor_refused == {row["floor_refused"]: FRAMES for row in frames}
    (warning,) = [text for text in about.warnings if "don't show their floor" in text]
    assert f"{FRAMES} have that of flags: give" in warning and "--ground.camera-height-m" in warning


def test_source_none_drops_nothing_as_floor(tmp_path: Path) -> None:
    log, config = simulated(tmp_path), Config()
    nothing = replace(config, ground=replace(config.ground, source="none"))
    about = run(log, tmp_path / "out", nothing)
    frames, obstacles = tables(tmp_path / "out")
    assert {row["floor_source"] for row in frames} == {"none"}
    for name in ("camera_height_m", "floor_refused"):
        assert [row[name] for row in frames] == [None] * FRAMES
    assert obstacles and all(row["bottom_m"] is None for row in obstacles)
    assert about.floor_warning is None


def test_on_a_table(tmp_path: Path) -> None:
    run(simulated(tmp_path), tmp_path / "out", preset("tabletop"), batch_size=2)
    frames, obstacles = tables(tmp_path / "out")
    assert len(frames) == FRAMES and obstacles
    assert {row["status"] for row in frames} == {"ok"}
