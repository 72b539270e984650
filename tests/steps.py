"""Run single steps of the program on given arrays, for tests against the reference."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from jaxdet.config import Config
from jaxdet.runtime.calls import device_of_jax
from jaxdet.stages._program import (
    STEPS,
    Static,
    launch,
    packed,
    record_layout,
    work_layout,
)
from jaxdet.stages._tables import Sizes, Tables, host_tables
from jaxdet.types import MAX_OBSTACLES, Calibration, Cells, Intrinsics, Obstacles
from jaxdet_kernels import program

POISON = 0x55555555
Arrays = Mapping[str, np.ndarray]


@lru_cache(maxsize=1)
def _other_tables() -> Tables:
    """Return tables of the steps that a test does not run."""
    return host_tables(Calibration(Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)), Config())[1]


def step(
    name: str, tables: Tables, given: Arrays, sizes: Sizes, depth: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Run a step on given arrays and return all arrays of the program by name.

    Args:
        name: Name of the step, see :data:`STEPS`.
        tables: Tables that the step reads.
        given: Intermediate arrays of earlier steps, and ``prior`` and ``floor_frame``; all others
            are poisoned.
        sizes: Sizes of the arrays.
        depth: Depth images, for the first step.
    """
    device = device_of_jax(program)
    buffer = packed(sizes, {**_other_tables(), **tables}, device)
    static = Static.of(buffer)
    work, record = work_layout(static.rows, static.columns), record_layout()
    batch = len(next(iter(given.values())) if depth is None else depth)
    if depth is None:
        depth = np.zeros((batch, sizes.height, sizes.width), np.uint16)
    prior = given.get("prior", np.zeros((batch, 4), np.int32))
    floors = np.hstack([prior, given.get("floor_frame", np.zeros((batch, 13), np.int32))])
    rows = [
        layout.pack(batch, {k: v for k, v in given.items() if k in layout.shapes}, POISON)
        for layout in (record, work)
    ]
    contour = np.full((batch, static.words()[1]), POISON, np.int32)
    arrays = [
        wp.array(np.ascontiguousarray(a), dtype=wp.dtype_from_numpy(a.dtype), device=device)
        for a in (depth, floors, buffer, rows[0], contour, rows[1])
    ]
    scratch = wp.full((min(batch, 2), static.own_words), POISON, dtype=wp.int32, device=device)
    number = STEPS.index(name)
    launch(arrays, scratch, number, number + 1, static)
    found, line, kept = (arrays[i].numpy() for i in (3, 4, 5))
    made = {k: record.take(found, k) for k in record.shapes}
    made |= {k: work.take(kept, k) for k in work.shapes}
    return made | {"contour": line.reshape(batch, MAX_OBSTACLES, static.columns, 2)}


def _grid(z: np.ndarray, side: int = 1) -> Sizes:
    rows, columns = z.shape[1:]
    return Sizes(rows * side, columns * side, side, rows, columns)


def cells(depth: np.ndarray, tables: Tables, side: int) -> tuple[Cells, np.ndarray]:
    """Run ``find_cells``; return the cells and the smallest depth of each."""
    rows, columns = tables["rays"].shape[1:]
    sizes = Sizes(*depth.shape[1:], side, rows, columns)
    found = step("find_cells", tables, {}, sizes, depth)
    return Cells(found["x"], found["y"], found["z"]), found["nearest_pixel"]


def find_floor(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, prior: np.ndarray, tables: Tables
) -> np.ndarray:
    """Run ``find_floor``; return its result ``(B, 8)``."""
    given = {"x": x, "y": y, "z": z, "prior": prior}
    return step("find_floor", tables, given, _grid(z))["floor"]


class Surfaces(NamedTuple):
    """Results of ``find_surfaces``."""

    right: np.ndarray
    forward: np.ndarray
    height: np.ndarray
    label: np.ndarray
    keep: np.ndarray
    free: np.ndarray
    low: np.ndarray
    half: np.ndarray
    num_surfaces: np.ndarray
    has_depth: np.ndarray


def surfaces(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, frame: np.ndarray, tables: Tables
) -> Surfaces:
    """Run ``find_surfaces``."""
    found = step("find_surfaces", tables, {"x": x, "y": y, "z": z, "frame": frame}, _grid(z))
    found |= {"label": found["surface"], "free": found["free_cell"]}
    found["has_depth"] = found["has_depth"] != 0
    return Surfaces(*(found[name] for name in Surfaces._fields))


def obstacles(
    label: np.ndarray,
    free: np.ndarray,
    half: np.ndarray,
    view: Sequence[np.ndarray],
    frame: np.ndarray,
    tables: Tables,
) -> tuple[np.ndarray, np.ndarray]:
    """Run ``find_obstacles``; return the obstacle of each cell, and the number of obstacles."""
    names = "x", "y", "z", "right", "forward", "height"
    given = {"surface": label, "free_cell": free, "half": half, "frame": frame}
    given |= dict(zip(names, view, strict=True))
    found = step("find_obstacles", tables, given, _grid(label))
    return found["label"], found["num_obstacles"]


class Outlined(NamedTuple):
    """Results of ``find_outlines``."""

    obstacles: Obstacles
    contour: np.ndarray
    contour_points: np.ndarray
    bottom_top: np.ndarray


def outlines(
    label: np.ndarray,
    count: np.ndarray,
    grid: Cells,
    floor: Sequence[np.ndarray],
    tables: Tables,
    side: int,
) -> Outlined:
    """Run ``find_outlines``; ``floor`` contains right, forward and height of the cells."""
    names = "right", "forward", "height"
    given = {**grid._asdict(), **dict(zip(names, floor, strict=True))}
    given |= {"label": label, "num_obstacles": count}
    found = step("find_outlines", tables, given, _grid(label, side))
    found["has_vertex"] = found["has_vertex"] != 0
    measured: Any = Obstacles(**{k: found[k] for k in Obstacles._fields if k in found})
    return Outlined(measured, found["contour"], found["contour_points"], found["bottom_top"])


class FreeFloor(NamedTuple):
    """Results of ``find_free_floor``."""

    label: np.ndarray
    num_obstacles: np.ndarray
    first_notch: np.ndarray
    free: np.ndarray
    free_end: np.ndarray


def free_floor(
    label: np.ndarray,
    low: np.ndarray,
    half: np.ndarray,
    z: np.ndarray,
    nearest: np.ndarray,
    floor: Sequence[np.ndarray],
    frame: np.ndarray,
    tables: Tables,
) -> FreeFloor:
    """Run ``find_free_floor``; return free floor, and obstacles with those in its notches."""
    given = {"label": label, "low": low, "half": half, "z": z, "nearest_pixel": nearest}
    given["frame"] = frame
    given |= dict(zip(("right", "forward", "height"), floor, strict=True))
    given["num_obstacles"] = label.max(axis=(1, 2), initial=-1).astype(np.int32) + 1
    found = step("find_free_floor", tables, given, _grid(label))
    return FreeFloor(*(found[name] for name in FreeFloor._fields))
