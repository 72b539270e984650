"""Maps for nav2's map_server: a PGM picture and a YAML file."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxdet.errors import InputError
from jaxdet.export.grid import FREE, OCCUPIED, Grid, last_grid
from jaxdet.io import LogFiles
from jaxdet.results.reading import Results

OCCUPIED_GREY, FREE_GREY, UNKNOWN_GREY = 0, 254, 205
"""Grey levels, as written by nav2's map_saver."""

_YAML = """\
# Map of {log}, in the frame {frame}.
image: {image}
mode: trinary
resolution: {cell_m:.9g}
origin: [{x:.12g}, {y:.12g}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
# The grey level of unknown cells is an occupancy of 0.19608.


def export(results: Results, output: Path, recordings: Mapping[str, LogFiles]) -> list[str]:
    """Write ``LOG.pgm`` and ``LOG.yaml`` of each log with a map into a folder.

    A cell is occupied if outlines of obstacles outweigh later free floor, see
    :mod:`jaxdet.export.grid`, free if floor was seen, and else unknown.

    Args:
        results: Results of a run.
        output: Folder.
        recordings: Not used.

    Returns:
        A line for each log without a map.

    Raises:
        InputError: No log has a map.
    """
    output.mkdir()
    left_out = []
    for log in results.logs:
        grid = last_grid(results, log)
        if grid is None:
            left_out.append(f"{log.label} is left out: it has no map")
        else:
            _write(output / log.file_name, grid, log.label, results.world_frame(log))
    if len(left_out) == len(results.logs):
        remedy = "maps need logs with camera poses"
        raise InputError("no log has a map", path=str(results.folder), remedy=remedy)
    return left_out


def _write(path: Path, grid: Grid, log: str, frame: str) -> None:
    """Write the two files of a map; row 0 of the picture is the highest Y."""
    greys = np.full(grid.states.shape, UNKNOWN_GREY, np.uint8)
    greys[grid.states == FREE] = FREE_GREY
    greys[grid.states == OCCUPIED] = OCCUPIED_GREY
    rows, columns = grid.states.shape
    picture = path.with_name(f"{path.name}.pgm")
    picture.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + greys[::-1].tobytes())
    x, y = grid.origin
    log, frame = (" ".join(text.split()) for text in (log, frame))
    names = {"log": log, "frame": frame, "image": picture.name}
    text = _YAML.format(**names, cell_m=grid.cell_m, x=x, y=y)
    path.with_name(f"{path.name}.yaml").write_text(text, encoding="utf-8")
