"""Obstacles from surfaces, against the reference."""

import jax
import numpy as np

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs, on_cells, repeated
from benchmarks.sweep import SIZES, Point
from jaxdet.affinity import affinity
from jaxdet.floor.plane import depth_range
from jaxdet.reference._obstacles import obstacles as grouped
from jaxdet.stages._obstacles import obstacles, tables

program = jax.jit(obstacles)


def cases() -> list[Case]:
    """Surfaces on the device; no other library has this step."""
    seen, unit = on_cells(SIZES[0]), inputs(SIZES[0]).calibration.depth_unit
    far = _farthest(unit)

    def peer() -> tuple[np.ndarray, np.ndarray]:
        found = np.stack(
            [
                grouped(one.label, one.free, one.view, far, unit, CONFIG.obstacle)
                for one in seen.surfaces
            ]
        )
        return found, found.max(axis=(1, 2)) + 1

    ours = at(Point(SIZES[0], 0, BATCH))
    return [ours._replace(name="vs_reference", peer=peer, equal=True, bytes_read=0)]


def at(point: Point) -> Case:
    """Surfaces on the device."""
    seen, unit = on_cells(point.size), inputs(point.size).calibration.depth_unit
    table = affinity(CONFIG.obstacle.affinity, unit)
    shared = jax.device_put(tables(_farthest(unit), unit, CONFIG.obstacle, table))
    label, free = (seen.of(name, seen.surfaces) for name in ("label", "free"))
    columns = (label, free, *seen.cells, *seen.places)
    label, free, *view = jax.device_put(repeated(columns, point.batch))
    given = label, free, tuple(view)
    return Case(
        name=point.name,
        run=lambda: program(*given, shared),
        frames=point.batch,
        bytes_read=sum(a.nbytes for a in jax.tree.leaves(given)),
    )


def _farthest(unit: float) -> int:
    ground = CONFIG.ground
    return depth_range(ground.min_depth_m, ground.max_depth_m, unit)[1]
