"""outlines: the results of the kernel equal the reference, field by field."""

from pathlib import Path

import numpy as np
import pytest

from jaxdet.camera import cell_side
from jaxdet.config import Config
from jaxdet.floor.plane import unknown_plane
from jaxdet.reference._detect import _outlines
from jaxdet.results.metric import extents
from jaxdet.stages._tables import outline_tables as tables
from jaxdet.types import MAX_OBSTACLES
from tests.scenes import assert_equal, small
from tests.steps import outlines
from tests.surface_frames import (
    SURFACES,
    Batch,
    batch_of,
    changed,
    drawn,
    recorded,
    recorded_config,
    simulated,
)

pytestmark = pytest.mark.twin


def assert_twins(batch: Batch, config: Config = SURFACES) -> int:
    """Assert that the results of the kernel equal the reference; return the number of obstacles."""
    label = batch.label
    count = (label.max(axis=(1, 2)) + 1).astype(np.int32)
    kept = np.minimum(count, MAX_OBSTACLES)
    measured, shapes = _outlines(batch.grid, batch.found, kept, batch.calibration, config)
    side = cell_side(batch.calibration.depth, config.surface.cell_rad)
    shared = tables(batch.calibration, config)
    twin = outlines(label, count, batch.grid, batch.floor, shared, side)
    assert_equal(twin.obstacles, measured)
    for got, want in zip(twin[1:], shapes, strict=True):
        np.testing.assert_array_equal(np.asarray(got), want, strict=True)
    return int((measured.num_points > 0).sum())


@pytest.mark.parametrize(
    ("shape", "obstacles"),
    [
        ((1, 13, 17), 3),
        ((3, 31, 45), 12),
        ((5, 7, 9), 5),
        ((1, 1, 1), 1),
        ((2, 40, 1), 4),
        ((2, 1, 70), 4),
        ((2, 24, 512), 9),
        ((1, 60, 33), 130),
    ],
)
@pytest.mark.parametrize("reach", [4, 3000, 300000])
def test_outlines_equal_the_reference_on_random_frames(
    shape: tuple[int, int, int], obstacles: int, reach: int
) -> None:
    assert assert_twins(drawn(shape, obstacles, seed=sum(shape), reach=reach)) > 0


@pytest.mark.parametrize("footprint", [
    {"trim": 0}, {"trim": 9, "long_m": 0.1}, {"trim": 8192, "side_band_per_m": 0.5},
    {"vertex_threshold_m": 0.5, "long_m": 0.0}, {"near_band_per_m2": 1.0, "long_m": 65.0},
])  # fmt: skip
def test_outlines_equal_the_reference_with_any_settings(footprint: dict[str, float]) -> None:
    batch = drawn((2, 30, 50), 6, seed=2, reach=2500, block=7)
    assert assert_twins(batch, changed(**footprint)) == 12


def test_outlines_equal_the_reference_with_more_obstacles_than_slots() -> None:
    batch = drawn((2, 80, 90), 200, seed=4, block=4)
    assert batch.label.max() > 150
    assert assert_twins(batch) == 2 * MAX_OBSTACLES


def test_outlines_equal_the_reference_on_a_batch_with_and_without_obstacles() -> None:
    some, none = drawn((1, 20, 30), 5, seed=1), drawn((1, 20, 30), 5, seed=2)
    empty = none.found[0]._replace(label=np.full((20, 30), -1))
    grid = type(some.grid)(
        *(np.concatenate(pair) for pair in zip(none.grid, some.grid, strict=True))
    )
    assert 0 < assert_twins(Batch(grid, [empty, some.found[0]], some.calibration)) <= 5


def test_outlines_equal_the_reference_on_an_obstacle_in_the_margins() -> None:
    """At first all cells of the obstacle are in the left and right eighths of the image; each
    further case has more cells between these margins.
    """
    batch = drawn((1, 12, 40), 1, seed=3, reach=3000)
    column = np.arange(40)
    for inner in range(0, 40, 5):
        own = (column < 5) | (column >= 35) | (np.abs(column - 19) < inner / 2)
        label = np.where(own, 0, -1) + np.zeros((12, 1), int)
        for long_m in (0.1, 60.0):
            found = [batch.found[0]._replace(label=label)]
            assert assert_twins(batch._replace(found=found), changed(long_m=long_m)) == 1


def test_outlines_equal_the_reference_with_sums_beyond_32_bits() -> None:
    """A wall at 6 m fills the image, in units of 0.1 mm."""
    batch = drawn((1, 200, 220), 1, seed=6, reach=60000)
    one, z = batch.found[0], np.full((1, 200, 220), 60000, np.int32)
    grid = batch.grid._replace(x=-z, z=z)
    view = one.view._replace(x=-z[0], z=z[0])
    found = [one._replace(label=np.zeros((200, 220), int), view=view)]
    wall = batch._replace(grid=grid, found=found)
    assert assert_twins(wall) == 1
    count = np.ones(1, np.int32)
    measured, _ = _outlines(wall.grid, wall.found, count, wall.calibration, SURFACES)
    centroid = extents(measured, 0.0001).centroid[0, 0]
    np.testing.assert_array_equal(centroid[[0, 2]], np.array([-6.0, 6.0], np.float32))


@pytest.mark.parametrize("family", ["mixed", "queue", "corridor", "room", "tables"])
def test_outlines_equal_the_reference_on_simulated_frames(family: str) -> None:
    assert assert_twins(simulated(family)) > 0


def test_outlines_equal_the_reference_on_a_large_frame() -> None:
    assert assert_twins(simulated("room", 640)) > 0


def test_outlines_equal_the_reference_without_depth() -> None:
    depth = np.zeros((2, 60, 80), np.uint16)
    assert assert_twins(batch_of(depth, small(), unknown_plane(2), SURFACES)) == 0


@pytest.mark.parametrize(("name", "frames"), [("mosd", 4), ("wheelchair", 2), ("aims_slam", 2)])
def test_outlines_equal_the_reference_on_recorded_frames(
    shared_data: Path, name: str, frames: int
) -> None:
    batches = recorded(shared_data, name, frames)
    if not batches:
        pytest.skip(f"no {name}")
    assert sum(assert_twins(batch, recorded_config(name)) for batch in batches) > 0
