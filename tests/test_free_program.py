"""free_floor: the results of the kernel equal the reference in every column."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxdet.camera import cell_rays, cell_side
from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames, on_floor
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.reference._detect import _free
from jaxdet.reference._rounding import lateral
from jaxdet.reference._view import View
from jaxdet.stages._tables import cell_tables, free_tables, surface_tables
from jaxdet.types import FreeEnd
from tests.scenes import small
from tests.steps import free_floor
from tests.surface_frames import (
    SURFACES,
    Batch,
    batch_of,
    drawn,
    recorded,
    recorded_config,
    simulated,
    with_floor,
)

pytestmark = pytest.mark.twin


def pixels_of(batch: Batch, share: float) -> np.ndarray:
    """Return depths of nearest pixels for a fraction of the cells, some nearer than their cell."""
    z = batch.grid.z
    rng = np.random.default_rng(z.size)
    part = rng.choice([0.3, 0.9, 1.0], z.shape, p=[0.1, 0.1, 0.8])
    return np.rint(np.where(rng.random(z.shape) < share, z * part, 0)).astype(np.int32)


def on_rays(batch: Batch, frame: np.ndarray) -> Batch:
    """Return the batch with cells at the positions given by their rays and depths over a floor."""
    camera = batch.calibration.depth
    found, rays = [], cell_rays(camera, cell_side(camera, SURFACES.surface.cell_rad))
    for one in batch.found:
        x, y = (lateral(ray, one.view.z) for ray in rays)
        xyz = np.stack([x, y, one.view.z]).astype(np.int64)
        found.append(one._replace(view=View(*xyz, *on_floor(frame, xyz))))
    return batch._replace(found=found)


def assert_twins(
    batch: Batch, config: Config = SURFACES, pixel_share: float = 0.95, placed: bool = False
) -> set[int]:
    """Assert that the results of the kernel equal the reference, at any roll.

    Returns:
        Reasons for which the free floor of a column ends, as :class:`FreeEnd`.
    """
    pixels, ends = pixels_of(batch, pixel_share), set[int]()
    cells = cell_tables(batch.calibration, config.surface)
    shared = surface_tables(batch.calibration, config) | free_tables(batch.calibration, config)
    shared["rays"] = cells["rays"]
    for roll_deg in (0.0, 100.0, 180.0, -44.0, -46.0, 136.0):
        plane = flat_plane(np.array([0.5]), np.array([0.2]), np.radians([roll_deg]))
        frame = np.repeat(floor_frames(plane, batch.unit), len(batch.found), axis=0)
        batch = on_rays(batch, frame[0]) if placed else batch
        found, first, free, end = _free(batch.found, frame, pixels, batch.calibration, config)
        given = batch.label, batch.low, batch.half, batch.grid.z, pixels, batch.floor, frame
        twin = free_floor(*given, shared)
        label = batch._replace(found=found).label
        count = label.max(axis=(1, 2), initial=-1).astype(np.int32) + 1
        for got, expected in zip(twin, (label, count, first, free, end), strict=True):
            np.testing.assert_array_equal(np.asarray(got), expected, strict=True)
        ends |= set(end.ravel().tolist())
    return ends


@pytest.mark.parametrize("reach", [40, 3000, 300000])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 40, 1), (3, 31, 45), (2, 7, 19), (5, 64, 22)])
def test_free_floor_equals_the_reference_on_random_frames(
    shape: tuple[int, int, int], reach: int
) -> None:
    ends = assert_twins(drawn(shape, 9, seed=sum(shape), reach=reach), placed=True)
    assert FreeEnd.OBSTACLE in ends or shape == (1, 1, 1)  # its cell is out of range


@pytest.mark.parametrize("step", [0, 60, 300])
@pytest.mark.parametrize("shape", [(3, 40, 61), (1, 160, 213), (2, 57, 512)])
def test_free_floor_equals_the_reference_on_floors_with_drops(
    shape: tuple[int, int, int], step: int
) -> None:
    batch = drawn(shape, 2, seed=5, block=3)
    batch = batch._replace(found=[one._replace(label=one.label * 0 - 1) for one in batch.found])
    for far in (1500, 5000):
        ends = assert_twins(with_floor(batch, step, far, step), pixel_share=0.0)
        assert FreeEnd.DROP in ends or step < 300
        assert FreeEnd.UNKNOWN in ends or step < 300


@pytest.mark.parametrize("times", [1.1, 4.0])
def test_free_floor_equals_the_reference_on_reflections(times: float) -> None:
    """Some cells are deep below the floor and farther away; the floor continues beyond them."""
    batch = drawn((3, 60, 90), 2, seed=7, block=3)
    batch = batch._replace(found=[one._replace(label=one.label * 0 - 1) for one in batch.found])
    batch = with_floor(batch, seed=7, far=6000, step=0)
    rng, found = np.random.default_rng(7), []
    for one in batch.found:
        deep = np.zeros(one.low.shape, bool)
        for column in range(0, 90, 30):
            top = int(rng.integers(10, 40))
            deep[top : top + rng.integers(3, 12), column : column + 29] = True
        ahead = np.where(deep, one.view.forward * times, one.view.forward).astype(np.int64)
        height = np.where(deep, -1500, one.view.height)
        z = np.where(one.low, np.abs(ahead), 0)
        view = one.view._replace(forward=ahead, height=height, z=z)
        found.append(one._replace(view=view))
    z = np.stack([one.view.z for one in found]).astype(np.int32)
    mirrored = batch._replace(grid=batch.grid._replace(z=z), found=found)
    ends = assert_twins(mirrored, pixel_share=0.0)
    assert (FreeEnd.DROP in ends) == (times < 1.2)


@pytest.mark.parametrize("seed", range(4))
def test_free_floor_equals_the_reference_on_floors_with_obstacles(seed: int) -> None:
    batch = with_floor(drawn((2, 50, 60), 4, seed, block=12), seed, far=4500, step=80)
    assert FreeEnd.OBSTACLE in assert_twins(batch, pixel_share=0.0)


def test_free_floor_equals_the_reference_with_any_settings() -> None:
    batch = with_floor(drawn((2, 50, 60), 3, 9, block=12), 9, far=4500, step=60)
    floors = ({"gap_m": 0.0}, {"gap_m": 10.0}, {"drop_m": 0.0}, {"drop_m": 5.0},
              {"noise_per_m": 1.0, "bow_per_m": 1.0}, {"bow_per_m": 0.0})  # fmt: skip
    for floor in floors:
        changed = replace(SURFACES, floor=replace(SURFACES.floor, **floor))
        assert_twins(batch, changed, pixel_share=0.0)
    near = replace(SURFACES, ground=replace(SURFACES.ground, max_depth_m=2.0))
    assert_twins(batch, near, pixel_share=0.0)
    assert_twins(simulated("room"), near, placed=True)


def test_free_floor_equals_the_reference_without_depth() -> None:
    depth = np.zeros((2, 60, 80), np.uint16)
    ends = assert_twins(batch_of(depth, small(), unknown_plane(2), SURFACES))
    assert ends == {FreeEnd.UNKNOWN}


@pytest.mark.parametrize("family", ["mixed", "drops", "ramps", "corridor", "room", "tables"])
def test_free_floor_equals_the_reference_on_simulated_frames(family: str) -> None:
    ends = assert_twins(simulated(family), placed=True)
    assert FreeEnd.OBSTACLE in ends or family in ("drops", "ramps")


@pytest.mark.parametrize(("name", "frames"), [("mosd", 4), ("wheelchair", 2), ("aims_slam", 2)])
def test_free_floor_equals_the_reference_on_recorded_frames(
    shared_data: Path, name: str, frames: int
) -> None:
    batches = recorded(shared_data, name, frames)
    if not batches:
        pytest.skip(f"no {name}")
    for batch in batches:
        assert len(assert_twins(batch, recorded_config(name), placed=True)) > 1
