"""Maps for nav2's map_server: a PGM picture and a YAML file."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from jaxdet.errors import InputError
from jaxdet.export.grid import last_grid
from jaxdet.io import LogFiles
from jaxdet.results.map_file import FREE, OCCUPIED, UNKNOWN, Grid, KnownPlaces, write_map
from jaxdet.results.occupancy import MAX_CELLS
from jaxdet.results.reading import Results

KEPT_M = 0.15
"""Distance around observed obstacles within which a map is not cleared [m]."""


class KnownMap(NamedTuple):
    """Map to which obstacles are added."""

    grid: Grid
    clear: bool
    """Whether to clear cells that were seen as free floor."""


def export(
    results: Results,
    output: Path,
    recordings: Mapping[str, LogFiles],
    known: KnownMap | None = None,
) -> list[str]:
    """Write ``LOG.pgm`` and ``LOG.yaml`` of each log with a map into a folder.

    A cell is occupied if outlines of obstacles outweigh later free floor, see
    :mod:`jaxdet.export.grid`; free if floor was seen; otherwise unknown.

    Args:
        results: Results of a run.
        output: Folder.
        recordings: Unused.
        known: Map to which missing obstacles are added.

    Returns:
        A line for each log without a map.

    Raises:
        InputError: No log has a map, or a map would be too large.
    """
    output.mkdir()
    left_out = []
    places = None if known is None else KnownPlaces(known.grid)
    for log in results.logs:
        grid = last_grid(results, log, places)
        if grid is None:
            left_out.append(f"{log.label} is left out: it has no map")
            continue
        if known is not None:
            seen = last_grid(results, log) if known.clear else None
            grid = merged(known.grid, grid, seen)
        path = output / f"{log.file_name}.pgm"
        write_map(path, grid, log.label, results.world_frame(log))
    if len(left_out) == len(results.logs):
        remedy = "maps need logs with camera poses"
        raise InputError("no log has a map", path=str(results.folder), remedy=remedy)
    return left_out


def merged(known: Grid, new: Grid, seen: Grid | None = None) -> Grid:
    """Return a map with new obstacles, extended if they lie outside of it.

    Args:
        known: Map.
        new: Grid whose occupied cells are added.
        seen: Grid whose free cells are cleared, except near its occupied cells; None: nothing is
            cleared.

    Raises:
        InputError: The map would be too large.
    """
    rows, columns = np.nonzero(new.states == OCCUPIED)
    added = known.places(new.world(np.stack([columns, rows], axis=1) + 0.5))
    grid, shift = _extended(known, added)
    states = grid.states
    if seen is not None:
        reach = round(KEPT_M / seen.cell_m)
        near = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        kept = cv2.dilate((seen.states == OCCUPIED).astype(np.uint8), near) > 0
        free = np.where((seen.states == FREE) & ~kept, FREE, UNKNOWN)
        here, found = _sampled(grid, seen._replace(states=free))
        states[here] = np.where(found == FREE, FREE, states[here])
    here, found = _sampled(grid, new)
    states[here] = np.where(found == OCCUPIED, OCCUPIED, states[here])
    # Sampling misses obstacles if the map's cells are larger than the grid's.
    x, y = np.floor(added + shift).astype(np.int64).T
    states[y, x] = OCCUPIED
    return grid


def _extended(known: Grid, places: np.ndarray) -> tuple[Grid, np.ndarray]:
    """Return a copy of a map that contains the given cells, and the offset of its cell indices."""
    size = np.array(known.states.shape[::-1])
    low = np.minimum(np.floor(places).min(axis=0, initial=0), 0).astype(np.int64)
    high = np.maximum(np.floor(places).max(axis=0, initial=0) + 1, size).astype(np.int64)
    if int(np.prod(high - low)) > MAX_CELLS:
        problem = "obstacles are too far from the map"
        raise InputError(problem, topic="--map", remedy="pass a map in the frame of the poses")
    pad = [(-low[1], high[1] - size[1]), (-low[0], high[0] - size[0])]
    states = np.pad(known.states, pad, constant_values=UNKNOWN)
    x, y = known.world(low.astype(np.float64)).tolist()
    return known._replace(states=states, origin=(x, y)), -low


def _sampled(grid: Grid, other: Grid) -> tuple[tuple[slice, slice], np.ndarray]:
    """Return the part of a grid that another grid covers, and the other's states in that part."""
    rows, columns = other.states.shape
    ring = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float64)
    places = grid.places(other.world(ring))
    size = np.array(grid.states.shape[::-1])
    low = np.clip(np.floor(places.min(axis=0)), 0, size).astype(np.int64)
    high = np.clip(np.ceil(places.max(axis=0)), low, size).astype(np.int64)
    x, y = (np.arange(a, b) + 0.5 for a, b in zip(low, high, strict=True))
    cells = np.stack(np.meshgrid(x, y), axis=-1)
    column, row = np.moveaxis(np.floor(other.places(grid.world(cells))).astype(np.int64), -1, 0)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    found = other.states[np.where(inside, row, 0), np.where(inside, column, 0)]
    part = slice(low[1], high[1]), slice(low[0], high[0])
    return part, np.where(inside, found, UNKNOWN)
