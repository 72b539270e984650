"""Program of all steps on depth images: its arrays and the launches of its kernels, without JAX.

All tables for a camera and a configuration are packed into one buffer, which begins with a header:
sizes, then the offsets of the tables that are not in ``_FIXED``. ``program.h`` reads the buffer in
the same order. All results of a frame except the contours are one row of words.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.units import Scale, prior_units
from jaxdet.runtime.launch import INT32, MULTIPROCESSORS, on_cores, reported_words
from jaxdet.runtime.layout import Layout
from jaxdet.stages._tables import Sizes, host_tables
from jaxdet.types import (
    MAX_CONTOUR,
    MAX_OBSTACLES,
    MAX_SURFACES,
    RAYS,
    Array,
    Calibration,
    CellLabels,
    Cells,
    Detections,
    Frames,
    GroundPlane,
    Obstacles,
    Scene,
)
from jaxdet_kernels import program as kernels

STEPS = tuple(kernels.STEPS)
FLOOR_STEPS = STEPS.index("find_floor") + 1
"""Number of steps up to and including floor estimation."""
_FIXED = (
    "near", "steps", "limits", "rises", "bows", "drops", "bands",
    "surface_settings", "outline_settings", "free_settings", "last", "directions", "bearings",
    "ray_directions", "block_settings", "parameters",
)  # fmt: skip
"""Tables whose length is the same for all cameras, so their offsets are not in the header."""
_TABLES = (
    *_FIXED, "corner_x", "corner_y", "rays", "tile_corners", "floor_settings",
    "sines", "feature", "threshold", "value", "obstacle_settings",
)  # fmt: skip
_HEADER = 32
"""Number of words of the header, a multiple of those of a cache line."""


@lru_cache(maxsize=64)
def work_layout(rows: int, columns: int) -> Layout:
    """Return the layout of a frame's intermediate arrays: floor frame, and arrays of cells."""
    by_cell = "x", "y", "z", "nearest_pixel", "right", "forward", "height", "surface", "label"
    bools = "keep", "free_cell", "low", "half"
    shapes = {"frame": (13,), **dict.fromkeys((*by_cell, *bools), (rows, columns))}
    return Layout(shapes, frozenset(bools))


@lru_cache(maxsize=1)
def record_layout() -> Layout:
    """Return the layout of a frame's results: the fields of ``Obstacles`` and ``Scene``."""
    one, two, three = (MAX_OBSTACLES,), (MAX_OBSTACLES, 2), (MAX_OBSTACLES, 3)
    return Layout(
        {
            "floor": (8,),
            **dict.fromkeys(("num_surfaces", "has_depth", "num_obstacles"), ()),
            **dict.fromkeys(("num_points", "has_vertex", "contour_points"), one),
            **dict.fromkeys(("uv_min", "uv_max", "a", "b", "c", "direction", "bottom_top"), two),
            **dict.fromkeys(("xyz_min", "xyz_max"), three),
            "xyz_sum": (*three, 2),
            "span": (MAX_OBSTACLES, 4),
            "free": (RAYS, 2),
            "free_end": (RAYS,),
            "first_notch": (),
        }
    )


def floors(planes: GroundPlane, config: Config, unit: float) -> np.ndarray:
    """Return the prior of each frame's floor, as the program reads it, ``(B, 17)`` int32.

    A row has the values of :func:`prior_units`, then those of :func:`floor_frames`.
    """
    prior = prior_units(planes, Scale(unit, config.floor.noise_per_m))
    return np.hstack([prior, floor_frames(planes, unit)])


def packed(sizes: Sizes, tables: Mapping[str, Array], device: Any) -> np.ndarray:
    """Pack the header and all tables of a program into int32 words; floats keep their bits.

    Args:
        sizes: Sizes of the images and the grid.
        tables: Tables by name; tables that none of the steps to run reads may be missing.
        device: Warp device that the program runs on.

    Raises:
        ValueError: The grid has more than ``MAX_CONTOUR`` rows or columns.
    """
    rows, columns = sizes.rows, sizes.columns
    if max(rows, columns) > MAX_CONTOUR:
        raise ValueError(f"expected at most {MAX_CONTOUR} cells per side, got {columns} x {rows}")
    made = {name: np.asarray(tables.get(name, np.zeros(0, np.int32))) for name in _TABLES}
    layout = Layout({name: table.shape for name, table in made.items()})
    trees, leaves = made["value"].shape if made["value"].ndim == 2 else (0, 0)
    more = sizes.width, sizes.side, trees, leaves, int(not made["corner_x"].size)
    places = [_HEADER + place for place in [*layout.begin.values()][len(_FIXED) :]]
    found = np.concatenate([np.zeros(_HEADER, np.int32), layout.pack(1, made)[0]])
    header = Static(rows, columns, 0)
    found[: len(header) + len(more) + len(places)] = *header, *more, *places
    found[: len(header)] = header._replace(
        own_words=reported_words(kernels.scratch_words, [found, rows, columns], device)
    )
    return found


class Static(NamedTuple):
    """Sizes that a program is compiled for; the header begins with them."""

    rows: int
    columns: int
    own_words: int  # words of scratch memory per thread or team

    @classmethod
    def of(cls, tables: np.ndarray) -> "Static":
        """Read the header."""
        return cls(*map(int, tables[:3]))

    def words(self, keep_work: bool = True) -> tuple[int, int, int]:
        """Return the number of words of a frame's record, contours and intermediate arrays."""
        work = work_layout(self.rows, self.columns).words if keep_work else 1
        return record_layout().words, MAX_OBSTACLES * self.columns * 2, work


class Rows(NamedTuple):
    """Results of the steps, one row of words per frame, as NumPy or JAX arrays."""

    record: Any
    """Results ``(B, words)``, in the order of :func:`record_layout`."""
    contour: Any
    """Contours of the obstacles, ``(B, M C 2)``."""
    work: Any
    """Intermediate arrays ``(B, words)``, ``(1, 1)`` if they are not requested."""


def detections(
    rows: Rows, static: Static, with_cells: bool, xp: Any, prior: GroundPlane | None = None
) -> Detections:
    """Return the results of all steps as detections.

    Args:
        rows: Results of all steps.
        static: Sizes of the program.
        with_cells: Whether to return the labels of cells as well.
        xp: Module of the arrays, NumPy or ``jax.numpy``.
        prior: Field ``prior`` of the scene; None: the caller sets it.
    """
    record = record_layout()
    fields = {name: record.take(rows.record, name) for name in record.shapes}
    count, surfaces = fields["num_obstacles"], fields["num_surfaces"]
    fields["has_vertex"] = fields["has_vertex"] != 0
    obstacles = Obstacles(**{k: fields[k] for k in Obstacles._fields if k in fields})
    shape = len(rows.record), MAX_OBSTACLES, static.columns, 2
    fields |= {"prior": prior, "contour": rows.contour.reshape(shape)}
    cells = None
    if with_cells:
        work = work_layout(static.rows, static.columns)
        label, keep, *grid = (work.take(rows.work, n) for n in ("label", "keep", "x", "y", "z"))
        cells = CellLabels(xp.where(label < MAX_OBSTACLES, label, -1), keep, Cells(*grid))
    return Detections(
        xp.minimum(count, MAX_OBSTACLES),
        (count > MAX_OBSTACLES) | (surfaces > MAX_SURFACES),
        fields["has_depth"] != 0,
        obstacles,
        Scene(*(fields[name] for name in Scene._fields)),
        cells,
    )


@lru_cache(maxsize=8)
def packed_tables(calibration: Calibration, config: Config, device: str) -> np.ndarray:
    """Return the header and all tables for a Warp device by its name, see :func:`packed`."""
    return packed(*host_tables(calibration, config), device)


def run(
    device: Any, frames: Frames, prior: GroundPlane, config: Config, steps: int, *, keep_work: bool
) -> tuple[Rows, Static]:
    """Run the first steps on a Warp device, without JAX; images on the CPU are not copied.

    Args:
        device: Device for which the kernels are loaded.
        frames: Frames with their images on the host.
        prior: Prior of the floor in each frame.
        config: Configuration of the method.
        steps: Number of steps to run, from the first.
        keep_work: Whether to return the intermediate arrays.

    Returns:
        The results as NumPy arrays, and the sizes of the program.
    """
    tables = packed_tables(frames.calibration, config, str(device))
    given = frames.depth, floors(prior, config, frames.calibration.depth_unit), tables
    static, batch = Static.of(tables), len(frames.depth)
    record, contour, work = static.words(keep_work)
    shapes = (batch, record), (batch, contour), (batch, work) if keep_work else (1, 1)
    arrays = [
        wp.array(array, dtype=wp.dtype_from_numpy(array.dtype), device=device, copy=False)
        for array in map(np.ascontiguousarray, given)
    ]
    arrays += [wp.zeros(shape, dtype=INT32, device=device) for shape in shapes]
    size = batch, static.own_words
    scratch = None if wp.get_device(device).is_cpu else wp.empty(size, dtype=INT32, device=device)
    launch(arrays, scratch, 0, steps, static)
    return Rows(*(array.numpy() for array in arrays[3:])), static


def launch(arrays: list[Any], scratch: Any, first: int, end: int, static: Static) -> None:
    """Launch the steps ``STEPS[first:end]`` on Warp arrays, on their device.

    Args:
        arrays: Depth, floors, tables, record, contour and work, see :mod:`jaxdet_kernels.program`.
        scratch: Memory ``(teams, words)`` int32 on CUDA; not used on the CPU.
        first: Index of the first step.
        end: Index after the last step.
        static: Sizes of the program.
    """
    frames, rows, columns = len(arrays[0]), static.rows, static.columns
    names = "depth", "floors", "tables", "record", "contour", "work"
    batch = kernels.Batch()
    batch.rows, batch.columns = rows, columns
    for name, array in zip(names, arrays, strict=True):
        setattr(batch, name, array)
    if arrays[0].device.is_cpu:
        words = work_layout(rows, columns).words + static.own_words
        on_cores(kernels.frames, [batch, first, end - 1], frames, words)
        return
    teams = min(frames, len(scratch), kernels.BLOCKS * MULTIPROCESSORS)
    size, device = teams * kernels.WIDTH, scratch.device
    for step in STEPS[first:end]:
        inputs = [batch, scratch, teams]
        wp.launch(kernels.STEPS[step], size, inputs, device=device, block_dim=kernels.WIDTH)
