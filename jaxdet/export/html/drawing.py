"""Pictures of chosen frames, drawn from their log as the run draws them."""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxdet.export.recordings import look_again
from jaxdet.io import LogFiles
from jaxdet.render import draw_frame
from jaxdet.results.metric import rectangles
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.rows import row_inputs, shown_planes


def draw_again(
    results: Results, log: ResultLog, files: LogFiles, wanted: Sequence[int]
) -> Iterator[tuple[int, np.ndarray]]:
    """Draws frames.

    Args:
        results: The results.
        log: One of its logs.
        files: Where that is.
        wanted: The frames' numbers.

    Returns:
        Of each its number and its picture, ``(h, w, 3)`` uint8, BGR.
    """
    config = results.method
    for seen in look_again(results, log, files, np.array(wanted), with_cells=True, color=True):
        frames, found = seen.batch.frames, seen.found
        unit = frames.calibration.depth_unit
        corners = rectangles(found.obstacles, unit, config.footprint)
        assert frames.plane is not None
        plane = shown_planes(row_inputs(found), frames.plane, frames.calibration)
        frames = frames._replace(plane=plane)
        for row, number in enumerate(seen.chunk.frames["frame"].to_pylist()):
            title = f"{log.label}   frame {number}"
            yield number, draw_frame(frames, found, corners, row, config, title)[..., ::-1]
