"""obstacles: the results of the kernel under jit equal the reference."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from jaxdet import types
from jaxdet.affinity import affinity
from jaxdet.config import Config, ObstacleConfig
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import depth_range, flat_plane, step_height, unknown_plane
from jaxdet.io import open_log
from jaxdet.presets import preset
from jaxdet.reference._cells import cells
from jaxdet.reference._detect import _surfaces
from jaxdet.reference._floor import find_floor
from jaxdet.reference._lower_parts import with_lower_parts
from jaxdet.reference._obstacles import obstacles as reference
from jaxdet.reference._surfaces import renumbered
from jaxdet.reference._view import View
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages._tables import obstacle_tables
from jaxdet.types import Frames, GroundPlane
from tests.scenes import frames
from tests.steps import obstacles

pytestmark = pytest.mark.twin

UNIT = 0.001
CONFIG = Config().obstacle


class FrameSurfaces(NamedTuple):
    """Surfaces of one frame."""

    label: np.ndarray
    free: np.ndarray
    view: View


def assert_twin(
    given: list[FrameSurfaces],
    config: ObstacleConfig = CONFIG,
    farthest: int = 6000,
    unit: float = UNIT,
) -> list[int]:
    """Assert that the results of the kernel equal the reference, with any floor.

    Returns:
        Number of obstacles of each frame.
    """
    rng, rolls = np.random.default_rng(0), np.radians([0.0, 180.0, 100.0, 30.0])
    planes = flat_plane(*np.array([[0.3] * 4, [0.2] * 4, rolls]), np.array([1, 1, 1, 0], bool))
    floors = np.resize(floor_frames(planes, unit), (len(given), 13))
    table = affinity(config.affinity, unit)
    shared = obstacle_tables(farthest, unit, config, table)
    parts = zip(*(one.view for one in given), strict=True)
    arrays = [np.stack(part) for part in parts]
    view = tuple(a if a.dtype == bool else a.astype(np.int32) for a in arrays)
    label = np.stack([one.label for one in given]).astype(np.int32)
    free = np.stack([one.free for one in given])
    half = rng.random(label.shape) < 0.7
    found, count = obstacles(label, free, half, view, floors, shared)
    true = [
        with_lower_parts(reference(*one, farthest, unit, config), half[b], one.view, floors[b])
        for b, one in enumerate(given)
    ]
    np.testing.assert_array_equal(np.asarray(found), np.stack(true))
    counts = [int(one.max(initial=-1)) + 1 for one in true]
    np.testing.assert_array_equal(np.asarray(count), counts)
    return counts


def painted(seed: int, rows: int, columns: int, things: int, spread: int = 900) -> FrameSurfaces:
    """Return overlapping rectangles of slanted depth, with specks of noise in label and depth."""
    rng = np.random.default_rng(seed)
    label, z = np.full((rows, columns), -1), np.full((rows, columns), 4000)
    row, column = np.indices(label.shape)
    for number in range(things):
        top, left = rng.integers(0, rows), rng.integers(0, columns)
        high, wide = rng.integers(1, 2 + rows // 3), rng.integers(1, 2 + columns // 4)
        part = (slice(top, top + high), slice(left, left + wide))
        label[part] = number
        slope = rng.integers(-40, 41)
        z[part] = rng.integers(600, 700 + spread) + slope * np.abs(column - left - wide // 2)[part]
    z = np.maximum(z + rng.integers(-4, 5, z.shape), 1)
    specks = rng.random(z.shape) < 0.02
    label[specks] = rng.integers(-1, things, specks.sum())
    none = rng.random(z.shape) < 0.03
    label[none], z[none] = -1, 0
    free = (label < 0) & (z > 0) & (rng.random(z.shape) < 0.7)
    x, y = (column - columns // 2) * z // 100, (row - rows // 3) * z // 100
    view = View(x, y, z, x, z + rng.integers(-9, 10, z.shape), 500 - y)
    return FrameSurfaces(renumbered(label), free, view)


def scattered(seed: int, rows: int, columns: int, surfaces: int) -> FrameSurfaces:
    """Return random labels and positions over their full ranges."""
    rng = np.random.default_rng(seed)
    shape = (rows, columns)
    z = rng.integers(0, 65536, shape)
    x, y, right, forward = (rng.integers(-(1 << 18) + 1, 1 << 18, shape) for _ in range(4))
    height = rng.integers(-(1 << 20), 1 << 20, shape)
    free = rng.random(shape) < 0.3
    view = View(x, y, z, right, forward, height)
    label = rng.integers(-1, surfaces, shape)
    label.ravel()[rng.permutation(label.size)[:surfaces]] = np.arange(surfaces)
    return FrameSurfaces(renumbered(label), free, view)


# by hand


@pytest.mark.parametrize("columns", [1, 40])
def test_obstacles_equal_the_reference_without_depth(columns: int) -> None:
    none = np.zeros((30, columns), np.int64)
    given = FrameSurfaces(none - 1, none > 0, View(*(6 * [none])))
    assert assert_twin([given, given]) == [0, 0]


def test_obstacles_equal_the_reference_on_one_surface() -> None:
    given = painted(0, 24, 40, 1)
    whole = given._replace(label=np.zeros_like(given.label))
    assert assert_twin([whole], replace(CONFIG, bend_m=0.0)) == [1]


def test_obstacles_equal_the_reference_on_one_cell() -> None:
    one = np.full((1, 1), 700)
    given = FrameSurfaces(one * 0, one < 0, View(one, one, one, one, one, one))
    assert assert_twin([given], replace(CONFIG, min_size_m=0.0, min_cells=1)) == [1]
    assert assert_twin([given]) == [0]


def test_obstacles_equal_the_reference_on_a_room_split_at_its_corners() -> None:
    """Two side walls are connected by a wall across."""
    room = painted(0, 20, 120, 1)
    depth = np.tile(
        np.minimum(np.minimum(np.arange(120), np.arange(120)[::-1]) * 80 + 900, 3000), 20
    )
    z = depth.reshape(20, 120)
    side = np.tile((np.arange(120) - 60) * 20, (20, 1))
    height = 40 * np.indices(z.shape)[0]
    view = View(side, -height, z, side, z, height)
    given = room._replace(label=z * 0, free=z < 0, view=view)
    assert assert_twin([given]) == [3]
    assert assert_twin([given], replace(CONFIG, bend_m=0.0)) == [1]


def test_labels_are_limited_to_max_labels() -> None:
    """There are 512 surfaces of 16 columns and 4 rows, each of which bends twice."""
    column, row = np.arange(512), np.arange(64)
    label = np.tile(column // 16, (64, 1)) + 32 * (row // 4)[:, None]
    bends = np.array([0, 300, 600, 900, 900, 600, 300, 0] * 2)[column % 16]
    z = 1000 + np.tile(bends, (64, 1)) + 2000 * (label // 32)
    side = np.tile(column * 300, (64, 1))
    height = np.tile(100 * row[:, None], (1, 512))
    view = View(side, -height, z, side, z, height)
    near = replace(CONFIG, lateral_gap_m=0.0, forward_gap_m=0.0, min_cells=1)
    config = replace(near, bend_m=0.02, side_m=0.4)
    given = FrameSurfaces(renumbered(label), z < 0, view)
    assert given.label.max() == 511
    counts = assert_twin([given], config, farthest=65535)
    assert counts == [types.MAX_LABELS]


def test_an_affinity_table_that_could_overflow_is_an_error() -> None:
    table = affinity("surfaces", UNIT)
    large = table._replace(value=table.value * 1000)
    with pytest.raises(ValueError, match="32767"):
        obstacle_tables(4000, UNIT, CONFIG, large)


def test_a_grid_that_is_too_large_is_an_error() -> None:
    none = np.zeros((1, 2, 513), np.int32)
    view = 6 * [none]
    shared = obstacle_tables(4000, UNIT, CONFIG, affinity("surfaces", UNIT))
    with pytest.raises(ValueError, match="got 513 x 2"):
        obstacles(none, none > 0, none > 0, view, np.zeros((1, 13), np.int32), shared)


# twin


@pytest.mark.parametrize(
    ("rows", "columns", "things"), [(37, 61, 25), (60, 83, 60), (7, 9, 6), (64, 96, 30)]
)
def test_obstacles_equal_the_reference_on_overlapping_objects(
    rows: int, columns: int, things: int
) -> None:
    several = [painted(seed, rows, columns, things) for seed in range(20)]
    assert len(set(assert_twin(several))) > 1
    assert_twin(several[:1])
    loose = replace(CONFIG, lateral_gap_m=0.2, forward_gap_m=0.1, bend_m=0.05, side_m=0.1)
    assert_twin(several, loose)
    assert_twin(several, replace(preset("tabletop").obstacle, min_size_m=0.2), farthest=1200)


@pytest.mark.parametrize("surfaces", [2, 30, 512])
def test_obstacles_equal_the_reference_on_random_labels_and_positions(surfaces: int) -> None:
    given = [scattered(seed, 41, 67, surfaces) for seed in range(1 if surfaces > 100 else 3)]
    assert {one.label.max() + 1 for one in given} == {surfaces}
    if surfaces < 100:
        assert_twin(given, farthest=65535)
    wide = replace(CONFIG, lateral_gap_m=10, forward_gap_m=10, depth_gap_m=5, contact_m=0.5)
    assert_twin(given, replace(wide, min_cells=1), farthest=65535)


@pytest.mark.parametrize("unit", [0.0001, 0.004])
def test_obstacles_equal_the_reference_in_other_depth_units(unit: float) -> None:
    """Depth units are 0.1 mm and 4 mm."""
    given = [painted(seed, 37, 61, 20) for seed in range(6)]
    if unit < UNIT:
        views = [View(*(10 * a for a in one.view)) for one in given]
    else:
        views = [View(*(a // 4 for a in one.view)) for one in given]
    given = [one._replace(view=view) for one, view in zip(given, views, strict=True)]
    assert_twin(given, unit=unit, farthest=round(6 / unit))


def surfaces_of(
    given: Frames, prior: GroundPlane, config: Config
) -> tuple[list[FrameSurfaces], int]:
    """Return the surfaces of frames, and the end of the depth range."""
    unit = given.calibration.depth_unit
    grid = cells(given.depth, given.calibration, config.surface)
    fit = find_floor(grid.x, grid.y, grid.z, prior, config.floor, unit)
    floors, step = floor_frames(fit.plane, unit), step_height(given.calibration, config)
    found = [_surfaces(grid, b, floor, step, unit, config) for b, floor in enumerate(floors)]
    _, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    return [FrameSurfaces(one.label, one.free, one.view) for one in found], farthest


def test_obstacles_equal_the_reference_on_simulated_frames() -> None:
    given, farthest, config = [], 0, Config()
    for family in ("corridor", "room", "tables", "low_clutter", "mixed"):
        for frame in sample_frames(family, 300, 1, width=424, height=240, depth_error=1.0):
            assert frame.depth is not None
            one = frames(calibration_of(frame.config), frame.color[None], frame.depth[None])
            found, farthest = surfaces_of(one, frame.plane, config)
            given += found
    assert sum(assert_twin(given, config.obstacle, farthest)) > 10


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("labelled/mosd.mcap", "tabletop"),
        ("labelled/wheelchair.mcap", "wheeled"),
        ("aims_slam/aims_slam_18frames.mcap", "wheeled"),
    ],
)
def test_obstacles_equal_the_reference_on_recorded_frames(
    shared_data: Path, place: str, name: str
) -> None:
    if not (shared_data / place).is_file():
        pytest.skip(f"no {place}")
    config = preset(name)
    with open_log(str(shared_data / place)) as log:
        batch = next(iter(log.batches(8))).frames
    count = int(batch.valid.sum())
    batch = batch._replace(depth=batch.depth[batch.valid])
    given, farthest = surfaces_of(batch, unknown_plane(count), config)
    unit = batch.calibration.depth_unit
    assert sum(assert_twin(given, config.obstacle, farthest, unit)) >= count
