"""Pictures of chosen frames, drawn from their log as in a run."""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxdet.export.recordings import look_again
from jaxdet.io import LogFiles
from jaxdet.render import draw_frame
from jaxdet.results.metric import rectangles
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.rows import shown_planes


def draw_again(
    results: Results, log: ResultLog, files: LogFiles, wanted: Sequence[int]
) -> Iterator[tuple[int, np.ndarray]]:
    """Draw frames of a log.

    Args:
        results: Results.
        log: A log of the results.
        files: Files of the log.
        wanted: Frame numbers.

    Yields:
        Number and picture ``(h, w, 3)`` uint8, BGR, of each frame.
    """
    config = results.method
    for seen in look_again(results, log, files, np.array(wanted), with_cells=True, color=True):
        frames, detections = seen.batch.frames, seen.found
        unit = frames.calibration.depth_unit
        corners = rectangles(detections.obstacles, unit, config.footprint)
        assert frames.plane is not None
        plane = shown_planes(detections, frames.plane, frames.calibration)
        frames = frames._replace(plane=plane)
        for row, number in enumerate(seen.chunk.frames["frame"].to_pylist()):
            title = f"{log.label}   frame {number}"
            yield number, draw_frame(frames, detections, corners, row, config, title)[..., ::-1]
