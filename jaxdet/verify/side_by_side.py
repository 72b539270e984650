"""Pictures of frames with differences between two runs, side by side."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxdet.errors import ConfigError, InputError, JaxdetError
from jaxdet.export.html.drawing import draw_again
from jaxdet.export.html.images import read_picture
from jaxdet.export.recordings import find, recorded
from jaxdet.io import LogFiles
from jaxdet.render import canvas, write_png
from jaxdet.results.reading import ResultLog, Results
from jaxdet.verify.difference import LogDifference

HEADER = 34


def draw_differences(
    runs: tuple[Results, Results],
    chosen: Iterable[tuple[LogDifference, Collection[int]]],
    folder: Path,
    given: Sequence[str],
) -> list[str]:
    """Draw frames of two runs side by side, as ``LOG_000012.png``, the first run on the left.

    Args:
        runs: Both runs. If a run has a picture of a frame, it is used.
        chosen: Logs, each with the frame numbers to draw.
        folder: Folder to create.
        given: Files, folders or globs with logs that were moved.

    Returns:
        A line for each log that can't be drawn.

    Raises:
        ConfigError: The folder exists.
        InputError: The folder can't be written, or a moved log is not in the results.
    """
    if folder.exists():
        problem = "the folder exists already"
        raise ConfigError(problem, path=str(folder), remedy="choose a new folder")
    recordings = [find(results, given) for results in runs]
    problems = []
    try:
        folder.mkdir(parents=True)
        for log, numbers in chosen:
            sides = zip(runs, (log.a, log.b), recordings, strict=True)
            try:
                drawn = [_pictures(*side, numbers) for side in sides]
            except JaxdetError as error:
                problems.append(f"no pictures of {log.a.label}: {error}")
                continue
            for number in numbers:
                both = [
                    _titled(pictures[number], str(results.folder))
                    for pictures, results in zip(drawn, runs, strict=True)
                ]
                name = f"{log.a.file_name}_{number:06}.png"
                write_png(folder / name, np.hstack(_same_height(both)))
    except OSError as error:
        raise InputError(f"can't be written ({error.strerror})", path=str(folder)) from error
    return problems


def _pictures(
    results: Results,
    log: ResultLog,
    files: Mapping[str, LogFiles],
    numbers: Collection[int],
) -> dict[int, np.ndarray]:
    """Return pictures of frames by number, ``(h, w, 3)`` uint8 RGB each."""
    there = results.pictures(log)
    found = {n: read_picture(there[n])[..., ::-1] for n in numbers if n in there}
    missing = [n for n in numbers if n not in there]
    if missing:
        recording = files.get(log.name) or recorded(log)
        drawn = draw_again(results, log, recording, missing)
        found |= {number: picture[..., ::-1] for number, picture in drawn}
    return found


def _titled(picture: np.ndarray, title: str) -> np.ndarray:
    """Add the folder of the results above a picture."""
    image = canvas.canvas(HEADER + picture.shape[0], picture.shape[1])
    image[HEADER:] = picture
    canvas.write(image, title, (12, 25), size=16, bold=True)
    return image


def _same_height(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """Pad pictures at the bottom to the same height."""
    height = max(len(picture) for picture in pictures)
    rows = [(0, height - len(picture)) for picture in pictures]
    return [np.pad(p, (below, (0, 0), (0, 0))) for p, below in zip(pictures, rows, strict=True)]
