"""Complete method as one compiled program, for the CPU and CUDA."""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxdet.config import Config
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.runtime.calls import uninterrupted
from jaxdet.stages import _batches, _program
from jaxdet.stages._check import check_kernels
from jaxdet.stages._points import clusters
from jaxdet.types import (
    MAX_OBSTACLES,
    MAX_SURFACES,
    Calibration,
    CellLabels,
    Cells,
    Detections,
    Frames,
    GroundPlane,
    Obstacles,
    Scene,
)


def detect(
    frames: Frames, plane: GroundPlane, config: Config, with_cells: bool = False
) -> Detections:
    """Detect obstacles; twin of :func:`jaxdet.reference.detect`.

    Args:
        frames: ``B`` frames; images on the host or already on a device. On the CPU, images whose
            memory is aligned to 64 bytes are read in place; do not modify them until the results
            are ready.
        plane: Prior of the floor in each frame.
        config: Configuration of the method.
        with_cells: Whether to return the labels of cells as well.

    Returns:
        The obstacles, which may still be being computed, see :func:`_batches.in_parts`.

    Raises:
        ConfigError: The kernels do not support images or grids of this size.
    """
    if config.cluster.points:
        return clusters(frames, plane, config)
    tables, static = _tables(frames.calibration, config)

    def run(images: tuple[Any, ...], planes: GroundPlane) -> Detections:
        inputs = tables, _program.floors(planes, config, frames.calibration.depth_unit)
        return uninterrupted(_detect, *images, inputs, static, with_cells)

    found = _batches.in_parts(run, (frames.depth,), plane)
    return found._replace(scene=found.scene._replace(prior=plane))


def find_floors(frames: Frames, prior: GroundPlane, config: Config) -> FloorFit:
    """Estimate the floors; twin of :func:`jaxdet.reference.find_floors`."""
    unit = frames.calibration.depth_unit
    tables, static = _tables(frames.calibration, config)

    def run(images: tuple[Any, ...], planes: GroundPlane) -> jax.Array:
        floors = jnp.asarray(_program.floors(planes, config, unit))
        inputs = jax.device_put(*images), (tables, floors)
        return uninterrupted(_find_floors, *inputs, static)

    found = _batches.in_parts(run, (frames.depth,), prior)
    return floor_fit(np.asarray(found), prior, unit)


@lru_cache(maxsize=8)
def _tables(calibration: Calibration, config: Config) -> tuple[jax.Array, _program.Static]:
    """Return the tables on the device, and the sizes that a program is compiled for."""
    check_kernels()
    packed = _program.packed(*_program.host_tables(calibration, config))
    return jnp.asarray(packed), _program.Static.of(packed)


@partial(jax.jit, static_argnames="static")
def _find_floors(
    depth: jax.Array, inputs: tuple[jax.Array, jax.Array], static: _program.Static
) -> jax.Array:
    tables, floors = inputs
    return _program.find_floors(depth, floors, tables, static)


@partial(jax.jit, static_argnames=("static", "with_cells"))
def _detect(
    depth: jax.Array,
    inputs: tuple[jax.Array, jax.Array],
    static: _program.Static,
    with_cells: bool,
) -> Detections:
    tables, floors = inputs
    found = _program.detect(depth, floors, tables, static, with_cells)
    record = _program.record_layout()
    fields = {name: record.take(found.record, name) for name in record.shapes}
    count, surfaces = fields["num_obstacles"], fields["num_surfaces"]
    fields["has_vertex"] = fields["has_vertex"] != 0
    obstacles = Obstacles(**{k: fields[k] for k in Obstacles._fields if k in fields})
    shape = len(depth), MAX_OBSTACLES, static.columns, 2
    fields |= {"prior": None, "contour": found.contour.reshape(shape)}  # the prior is on the host
    cells = None
    if with_cells:
        work = _program.work_layout(static.rows, static.columns)
        label, keep, *grid = (work.take(found.work, n) for n in ("label", "keep", "x", "y", "z"))
        cells = CellLabels(jnp.where(label < MAX_OBSTACLES, label, -1), keep, Cells(*grid))
    return Detections(
        jnp.minimum(count, MAX_OBSTACLES),
        (count > MAX_OBSTACLES) | (surfaces > MAX_SURFACES),
        fields["has_depth"] != 0,
        obstacles,
        Scene(*(fields[name] for name in Scene._fields)),
        cells,
    )
