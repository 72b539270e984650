"""surfaces: the results of the kernel equal the reference."""

from dataclasses import replace

import numpy as np
import pytest

from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import flat_plane, step_height, unknown_plane
from jaxdet.io import open_log
from jaxdet.pipeline import find_floors
from jaxdet.presets import preset
from jaxdet.reference import cells
from jaxdet.reference._detect import _surfaces
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages._tables import surface_tables as tables
from jaxdet.types import MAX_SURFACES, Calibration, Cells, GroundPlane, Intrinsics
from tests.steps import Surfaces, surfaces

pytestmark = pytest.mark.twin

SURFACES, TABLETOP = Config(), preset("tabletop")
UNIT = 0.001


def with_surface(**changes: float) -> Config:
    return replace(SURFACES, surface=replace(SURFACES.surface, **changes))


def camera(unit: float) -> Calibration:
    """Return a camera with cells of 3 x 3 pixels."""
    return Calibration(Intrinsics(640, 480, 384.5, 384.5, 319.5, 239.5), depth_unit=unit)


def assert_twin(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    plane: GroundPlane,
    config: Config = SURFACES,
    unit: float = UNIT,
) -> Surfaces:
    """Assert that the results of the kernel equal the reference; return the results."""
    floors, step = floor_frames(plane, unit), step_height(camera(unit), config)
    got = surfaces(x, y, z, floors, tables(camera(unit), config))
    grid = Cells(x, y, z)
    for b in range(len(z)):
        want = _surfaces(grid, b, floors[b], step, unit, config)
        for name in ("right", "forward", "height"):
            np.testing.assert_array_equal(getattr(got, name)[b], getattr(want.view, name))
        for name in ("label", "keep", "free", "low", "half"):
            np.testing.assert_array_equal(getattr(got, name)[b], getattr(want, name))
        assert min(got.num_surfaces[b], MAX_SURFACES) == want.label.max() + 1
    assert {a.dtype.name for a in got} == {"int32", "bool"}
    return got


def sideways(z: np.ndarray) -> list[np.ndarray]:
    """Return cells of a camera with 190 columns per radian, from depths ``(B, R, C)``."""
    v, u = np.mgrid[: z.shape[1], : z.shape[2]]
    x, y = ((a - (a.max() + 1) / 2) / 190 for a in (u, v))
    return [np.rint(a).astype(np.int32) for a in (x * z, y * z, z)]


def slanted(rng: np.random.Generator, shape: tuple[int, int, int], noise: int = 0) -> np.ndarray:
    """Return folded walls with slanted objects in front of them, and a tenth of holes."""
    _, rows, columns = shape
    z, (v, u) = np.zeros(shape), np.mgrid[:rows, :columns]
    for one in z:
        folds = np.abs(u - rng.integers(columns)), np.abs(v - rng.integers(rows))
        one += rng.integers(1000, 3000) + sum(rng.integers(-25, 25) * fold for fold in folds)
        for _ in range(6):
            top, left = rng.integers(rows), rng.integers(columns)
            part = slice(top, top + rows // 2), slice(left, left + columns // 3)
            one[part] = rng.integers(300, 5000) + rng.integers(-25, 25) * u[part]
    z += rng.integers(-noise, noise + 1, shape)
    return np.where(rng.random(shape) < 0.1, 0, z.clip(1, 65535))


def planes(rng: np.random.Generator, batch: int) -> GroundPlane:
    """Return floors of all tilts, every second one with a ramp, every fourth one unknown."""
    tilts = rng.uniform(-0.5, 1.2, batch), rng.uniform(-0.4, 0.4, batch)
    b = np.arange(batch)
    plane = flat_plane(rng.uniform(0.2, 1.2, batch), *tilts, b % 4 != 2)
    ramp = b % 2 == 1
    start, slope = rng.uniform(0, 3, batch), rng.uniform(-0.3, 0.3, batch)
    return plane._replace(
        ramp_start=np.where(ramp, start, np.inf), ramp_slope=np.where(ramp, slope, 0)
    )


# made


SHAPES = [
    (1, 1, 1),
    (1, 7, 2),
    (4, 53, 71),
    (3, 5, 512),
    (2, 512, 9),
    (5, 33, 47),
    (2, 40, 96),
    (2, 32, 64),
]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("noise", [0, 15])
def test_surfaces_equal_the_reference_on_slanted_objects(shape, noise):
    rng = np.random.default_rng(noise)
    assert_twin(*sideways(slanted(rng, shape, noise)), planes(rng, shape[0]))


@pytest.mark.parametrize(
    "config",
    [
        TABLETOP,
        with_surface(crease_cells=16, crease_margin=16),
        with_surface(crease_cells=1, crease_margin=0, crease_m=0.0, crease_per_m=0.0),
        with_surface(step_m=1.0, step_per_m=1.0, crease_m=1.0, bent_m=1.0, beyond=4.0),
        with_surface(step_m=0.0, step_per_m=0.0, min_cells=1, bent_m=0.0),
        with_surface(min_cells=60),
        replace(SURFACES, ground=replace(SURFACES.ground, max_height_m=0.3)),
        replace(SURFACES, ground=replace(SURFACES.ground, max_height_m=0.0)),
    ],
    ids=["tabletop", "wide", "sharp", "endless", "none", "large", "low", "high"],
)
def test_surfaces_equal_the_reference_with_any_settings(config):
    rng = np.random.default_rng(1)
    assert_twin(*sideways(slanted(rng, (4, 41, 67), 3)), planes(rng, 4), config)


@pytest.mark.parametrize("unit", [0.001, 0.0001])
def test_surfaces_equal_the_reference_on_random_depths_and_positions(unit):
    """Depths are arbitrary, and positions are up to 2^18 - 1 units sideways."""
    rng = np.random.default_rng(2)
    z = rng.integers(0, 65536, (4, 37, 59)).astype(np.int32)
    x, y = (rng.integers(1 - (1 << 18), 1 << 18, z.shape).astype(np.int32) for _ in "xy")
    config = with_surface(step_m=0.5, step_per_m=0.1, min_cells=2, beyond=4.0)
    assert_twin(x, y, z, planes(rng, 4), config, unit)


@pytest.mark.parametrize("depth", [0, 1500])
def test_surfaces_equal_the_reference_on_constant_depth(depth):
    """Nothing is measured, or a wall fills the image."""
    got = assert_twin(*sideways(np.full((2, 31, 45), depth)), unknown_plane(2))
    assert got.num_surfaces.tolist() == [depth > 0] * 2
    assert (got.label == (0 if depth else -1)).all() and (got.keep == (depth > 0)).all()


def test_surfaces_equal_the_reference_with_more_surfaces_than_max_surfaces():
    """Every cell is a surface; from the 513th on they have no label but are kept."""
    v, u = np.mgrid[:40, :50]
    z = 1000 + 200 * ((u + 2 * v) % 5)
    config = with_surface(step_m=0.01, step_per_m=0.0, min_cells=1, crease_m=1.0)
    got = assert_twin(*sideways(z[None]), unknown_plane(1), config)
    assert got.num_surfaces.tolist() == [2000]
    np.testing.assert_array_equal(
        got.label.ravel(), np.where(np.arange(2000) < MAX_SURFACES, np.arange(2000), -1)
    )
    assert got.keep.all()


def test_surfaces_equal_the_reference_on_bent_floor():
    """A strip at a margin rises gently from the floor; another strip is measured too near."""
    height, z = np.zeros((20, 80), int), np.tile(2000 - 40 * np.arange(20)[:, None], (1, 80))
    height[:15, :9] = 60 + 5 * np.arange(15, 0, -1)[:, None]
    height[15, :9] = 45
    height[5:, 40:50] = 400
    height[12:14, 71:], z[12:14, 71:] = 70, z[14, 0] - 71
    level = flat_plane(*np.array([[0.5], [0.0], [0.0]]))
    z = z.astype(np.int32)[None]
    got = assert_twin(0 * z, (500 - height).astype(np.int32)[None], z, level)
    assert got.num_surfaces.tolist() == [1]
    np.testing.assert_array_equal(got.keep[0], height == 400)


# simulated and recorded


@pytest.mark.parametrize(
    "family",
    ["corridor", "room", "tables", "ramps", "drops", "low_clutter", "mixed", "people_and_vehicle"],
)
def test_surfaces_equal_the_reference_on_simulated_frames(family):
    rng = np.random.default_rng(4)
    shots = list(sample_frames(family, 300, 2, width=424, height=240, depth_error=1.0))
    depth = np.stack([shot.depth for shot in shots])
    grid = cells(depth, calibration_of(shots[0].config), SURFACES.surface)
    parts = zip(*(shot.plane for shot in shots), strict=True)
    plane = GroundPlane(*(np.concatenate(part) for part in parts))
    assert_twin(grid.x, grid.y, grid.z, plane)
    tilted = plane._replace(pitch=plane.pitch + rng.normal(0, 0.02, len(depth)))
    assert_twin(grid.x, grid.y, grid.z, tilted)


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("labelled/mosd.mcap", TABLETOP),
        ("labelled/wheelchair.mcap", SURFACES),
        ("aims_slam/aims_slam_18frames.mcap", SURFACES),
    ],
)
def test_surfaces_equal_the_reference_on_recorded_frames(shared_data, name, config):
    with open_log(str(shared_data / name)) as log:
        frames = next(iter(log.batches(4))).frames
    grid, unit = cells(frames.depth, frames.calibration, config.surface), UNIT
    assert frames.calibration.depth_unit == unit
    fit = find_floors(frames._replace(plane=None), config)
    got = assert_twin(grid.x, grid.y, grid.z, fit.plane, config)
    assert got.num_surfaces.max() > 1
