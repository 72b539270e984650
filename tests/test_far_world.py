"""Worlds with a distant origin, such as UTM coordinates."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet.export import export
from jaxdet.results.reading import Results
from jaxdet.tracks import track_results
from tests.export_results import run, sim_log
from tests.rewritten import move_world
from tests.test_export_foxglove import exported
from tests.test_export_rerun import motion, recording_of

OFFSET = np.array([500_000.0, 5_000_000.0])
"""Offset of the world, a multiple of the cells of the map [m]."""


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Results with tracks of a drive past a pedestrian, near the origin and moved by ``OFFSET``."""
    near, far = folders = [tmp_path_factory.mktemp(name) / "out" for name in ("near", "far")]
    about: dict[str, Any] = {"scene": "moving", "frames": 10, "seed": 3126, "rate_hz": 8.0}
    about["camera_height_m"] = 0.5
    sim_log(near.parent / "log.mcap", **about)
    T = np.eye(4)
    T[:2, 3] = OFFSET
    move_world(sim_log(far.parent / "log.mcap", **about), T)
    for folder in folders:
        run(folder.parent / "log.mcap", folder)
        track_results(folder)
    return near, far


def column(folder: Path, table: str, name: str) -> Any:
    return pq.read_table(folder / f"{table}.parquet")[name].to_pylist()


def test_results_equal_those_near_the_origin(drives: tuple[Path, Path]) -> None:
    near, far = drives
    one, other = (np.array(column(f, "obstacles", "corners_world")) for f in drives)
    assert len(one) > 10
    np.testing.assert_allclose(other - np.tile(OFFSET, 4), one, rtol=0, atol=1e-7)
    for table, name in (("track_links", "track"), ("tracks", "moving"), ("tracks", "num_frames")):
        assert column(near, table, name) == column(far, table, name)
    assert any(column(near, "tracks", "moving"))
    for name in ("length_m", "width_m", "top_m", "mean_speed_mps"):
        one, other = (column(f, "tracks", name) for f in drives)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-6)
    for one, other in zip(*(column(f, "tracks", "path") for f in drives), strict=True):
        moved = np.reshape(one, (-1, 2)) + OFFSET
        np.testing.assert_allclose(np.reshape(other, (-1, 2)), moved, rtol=0, atol=1e-6)
    with Results(near) as a, Results(far) as b:
        one, other = a.map(a.logs[0]), b.map(b.logs[0])
    assert one and other and (one.counts > 0).sum() > 100
    np.testing.assert_array_equal(other.counts, one.counts)
    np.testing.assert_array_equal(other.free, one.free)
    np.testing.assert_allclose(other.origin, one.origin + OFFSET, rtol=0, atol=1e-6)


def test_exports_draw_the_same_shapes(drives: tuple[Path, Path], tmp_path: Path) -> None:
    """Viewers draw in float32, so coordinates are relative to a nearby origin."""
    lines = []
    for folder in drives:
        topics, frames = exported(folder, tmp_path / f"foxglove_{folder.parent.name}")
        ways = []
        for (_, scene), frame in zip(topics["/jaxdet/obstacles"], frames, strict=True):
            moving = [track for track in frame.tracks if track.moving]
            found = [e.lines[0] for e in scene.entities if e.id.startswith("trajectory")]
            for line, track in zip(found, moving, strict=True):
                place = np.array([line.pose.position.x, line.pose.position.y])
                shape = np.array([[p.x, p.y] for p in line.points], np.float32)
                np.testing.assert_allclose(shape + place, track.path, rtol=0, atol=1e-6)
                ways.append(shape)
        lines.append(np.concatenate(ways))
    np.testing.assert_allclose(*lines, rtol=0, atol=1e-5)
    grids = []
    for folder in drives:
        with Results(folder) as results:
            export(results, "nav2", tmp_path / f"nav2_{folder.parent.name}", {})
        (text,) = (p.read_text() for p in (tmp_path / f"nav2_{folder.parent.name}").glob("*.yaml"))
        grids.append([float(v) for v in text.partition("origin: [")[2].split(",")[:2]])
    np.testing.assert_allclose(grids[1] - OFFSET, grids[0], rtol=0, atol=1e-7)


def test_rerun_positions_are_relative_to_a_local_origin(
    drives: tuple[Path, Path], tmp_path: Path
) -> None:
    near, far = (recording_of(f, tmp_path / f.parent.name) for f in drives)
    assert np.ravel(near["/world"]["translation"][-1]).tolist() == [0, 0, 0]
    assert np.ravel(far["/world"]["translation"][-1]).tolist() == [*OFFSET, 0]
    for number in range(10):
        one, other = (motion(found, "/world/floor", number) for found in (near, far))
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-6)
    ways = [name for name in near if name.startswith("/world/tracks")]
    for name, part in ((n, "strips") for n in [*ways, "/world/path"]):
        assert near[name][part].keys() == far[name][part].keys()
        for number, strips in near[name][part].items():
            np.testing.assert_allclose(far[name][part][number], strips, rtol=0, atol=1e-6)
    maps = [found["/world/map"]["translation"][-1] for found in (near, far)]
    np.testing.assert_allclose(*maps, rtol=0, atol=1e-6)
