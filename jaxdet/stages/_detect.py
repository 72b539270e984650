"""The whole method as one compiled program, for the CPU and CUDA."""

from functools import lru_cache, partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.affinity import affinity
from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import depth_range
from jaxdet.floor.units import FloorFit, Scale, floor_fit, prior_units
from jaxdet.stages import (
    _cells,
    _floor,
    _free,
    _obstacles,
    _outlines,
    _spread,
    _surfaces,
)
from jaxdet.stages._chain import by_device, frame_by_frame
from jaxdet.stages._compile import compile_method
from jaxdet.stages._points import clusters
from jaxdet.stages._teams import Tables
from jaxdet.types import (
    MAX_OBSTACLES,
    MAX_SURFACES,
    Array,
    Calibration,
    CellLabels,
    Cells,
    Detections,
    Frames,
    GroundPlane,
    Scene,
)


class _Tables(NamedTuple):
    """What all frames share: arrays, so that no camera and no setting compiles anew."""

    cells: Tables
    floor: Array
    surfaces: Tables
    obstacles: Tables
    outlines: Tables
    free: Tables


class _Given(NamedTuple):
    """Prior of each frame's floor."""

    prior: Array  # (B, 4) int32, see jaxdet.floor.units.prior_units
    frame: Array  # (B, 13) int32, see jaxdet.floor.frame.floor_frames


SPECS = (_spread.WHOLE, _spread.ROWS)
"""Of :class:`_Tables` and :class:`_Given`: which have a row for each frame."""


class _Static(NamedTuple):
    """What a compiled program is for."""

    cells: _cells.Static
    boxes: _outlines.Static
    floor_words: int  # scratch memory, from jaxdet.stages._floor.scratch_words
    with_cells: bool  # whether the cells are returned with their obstacles


def detect(
    frames: Frames, plane: GroundPlane, config: Config, with_cells: bool = False
) -> Detections:
    """Return what :func:`jaxdet.reference.detect` does.

    Args:
        frames: ``B`` frames; images on the host, which all devices share, or already on devices.
            On the CPU, images whose memory starts at a multiple of 64 bytes are read in place, so
            leave them alone until the results are ready.
        plane: Prior of the floor in each frame.
        config: Configuration of the method.
        with_cells: Whether to return the cells with their obstacles as well.

    Returns:
        The obstacles, perhaps still being computed, see :func:`_spread.in_parts`.

    Raises:
        ConfigError: The kernels don't take images or grids of this size.
    """
    if config.cluster.points:
        return clusters(frames, plane, config)
    tables, static = _tables(frames.calibration, config)
    unit = frames.calibration.depth_unit
    scale = Scale(unit, config.floor.noise_per_m)
    static = static._replace(with_cells=with_cells)

    def run(images: tuple[Any, ...], known: GroundPlane) -> Detections:
        given = _Given(prior_units(known, scale), floor_frames(known, unit))
        return _spread.run(_detect, images, (tables, given), SPECS, static)

    found = _spread.in_parts(run, (frames.depth,), plane)
    return found._replace(scene=found.scene._replace(prior=plane))


def find_floors(frames: Frames, prior: GroundPlane, config: Config) -> FloorFit:
    """Equals :func:`jaxdet.reference.find_floors`."""
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    tables, static = _tables(calibration, config)
    scale = Scale(unit, config.floor.noise_per_m)

    def run(images: tuple[Any, ...], known: GroundPlane) -> jax.Array:
        units = jnp.asarray(prior_units(known, scale))
        return _find_floors(jax.device_put(*images), tables, units, static)

    found = _spread.in_parts(run, (frames.depth,), prior)
    return floor_fit(np.asarray(found), prior, unit)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> tuple[_Tables, _Static]:
    """The arrays on the device, and what is compiled for."""
    if jax.default_backend() == "cpu":
        compile_method()
    unit = calibration.depth_unit
    cells, static = _cells.tables(calibration, config.surface)
    rows, columns = cells["rays"].shape[1:]
    bounds = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    outline_tables, boxes = _outlines.tables(calibration, config)
    table = affinity(config.obstacle.affinity, unit)
    made = _Tables(
        cells,
        _floor.floor_settings(rows * columns, config.floor, unit),
        _surfaces.tables(calibration, config),
        _obstacles.tables(bounds[1], unit, config.obstacle, table),
        outline_tables,
        _free.tables(config, unit),
    )
    made = jax.tree.map(jnp.asarray, made)
    words = _floor.scratch_words(rows, columns, config.floor, unit)
    return made, _Static(static, boxes, words, False)


@partial(jax.jit, static_argnames="static")
def _find_floors(depth: jax.Array, tables: _Tables, prior: jax.Array, static: _Static) -> jax.Array:
    grid = _cells.cells(depth, tables.cells, static.cells)
    return _floor.find_floor(grid.x, grid.y, grid.z, prior, tables.floor, static.floor_words)


class _Steps(NamedTuple):
    """Results of the kernels."""

    floor: jax.Array
    num_surfaces: jax.Array
    has_depth: jax.Array  # (B,) bool
    num_obstacles: jax.Array  # (B,) int32
    outlined: _outlines.Outlined
    free: tuple[jax.Array, jax.Array]
    cells: tuple[jax.Array, jax.Array, Cells] | None
    """The obstacle of each cell ``(B, R, C)`` int32, -1 = none, whether it is kept, and the cells;
    None unless requested."""


@partial(jax.jit, static_argnames="static")
def _detect(depth: jax.Array, tables: tuple[_Tables, _Given], static: _Static) -> Detections:
    steps = partial(_steps, depth, *tables, static)
    found = by_device(partial(frame_by_frame, steps), steps)
    overflow = (found.num_obstacles > MAX_OBSTACLES) | (found.num_surfaces > MAX_SURFACES)
    count = jnp.minimum(found.num_obstacles, MAX_OBSTACLES)
    lost = cast(GroundPlane, None)  # it stays on the host
    scene = Scene(found.floor, lost, *found.outlined[1:], *found.free)
    cells = None
    if found.cells is not None:
        label, keep, grid = found.cells
        cells = CellLabels(jnp.where(label < MAX_OBSTACLES, label, -1), keep, grid)
    return Detections(count, overflow, found.has_depth, found.outlined.obstacles, scene, cells)


def _steps(depth: jax.Array, shared: _Tables, given: _Given, static: _Static) -> _Steps:
    """The method: kernels and nothing else."""
    grid = _cells.cells(depth, shared.cells, static.cells)
    place = grid.x, grid.y, grid.z
    floor = _floor.find_floor(*place, given.prior, shared.floor, static.floor_words)
    frame = _floor.found_frames(floor, given.frame)
    surfaces = _surfaces.surfaces(*place, frame, shared.surfaces)
    on_floor = surfaces.right, surfaces.forward, surfaces.height
    view = *place, *on_floor
    label, count = _obstacles.obstacles(surfaces.label, surfaces.free, view, shared.obstacles)
    outlined = _outlines.outlines(label, count, grid, on_floor, shared.outlines, static.boxes)
    free = _free.free_floor(label, surfaces.low, grid.z, on_floor, frame, shared.free)
    cells = (label, surfaces.keep, grid) if static.with_cells else None
    counts = surfaces.num_surfaces, surfaces.has_depth, count
    return _Steps(floor, *counts, outlined, free, cells)
