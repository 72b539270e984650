"""Pictures of frames for the report, drawn by :mod:`jaxdet.render`."""

from collections.abc import Sequence

import cv2
import numpy as np

from benchmarks.paper.shots import Shot, frames_of
from benchmarks.paper.systems import Prepared, System, found_by
from jaxdet.config import Config
from jaxdet.floor.plane import plane_in_color
from jaxdet.render import canvas, draw_frame
from jaxdet.render.camera import camera_view, shown_image
from jaxdet.results.metric import rectangles
from jaxdet.types import Detections, Frames

CAPTION = 30


def encode(image: np.ndarray) -> bytes:
    """Return an RGB picture as a PNG file."""
    return cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def scaled(image: np.ndarray, width: int) -> np.ndarray:
    """Return a picture scaled to a width."""
    height = round(image.shape[0] * width / image.shape[1])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def titled(image: np.ndarray, text: str, width: int) -> np.ndarray:
    """Return a picture scaled to a width, below a line of text."""
    small = scaled(image, width)
    out = canvas.canvas(len(small) + CAPTION, width)
    out[CAPTION:] = small
    size = 15
    while size > 9 and canvas.text_size(text, size)[0] > width - 12:
        size -= 1
    canvas.write(out, text, (6, 20), size=size)
    return out


def grid(images: Sequence[np.ndarray], columns: int, gap: int = 6) -> np.ndarray:
    """Return pictures of equal width, arranged in rows."""
    width = images[0].shape[1]
    rows = [images[i : i + columns] for i in range(0, len(images), columns)]
    heights = [max(image.shape[0] for image in row) for row in rows]
    full = canvas.canvas(sum(heights) + gap * (len(rows) - 1), columns * (width + gap) - gap)
    top = 0
    for row, height in zip(rows, heights, strict=True):
        for k, image in enumerate(row):
            left = k * (width + gap)
            full[top : top + image.shape[0], left : left + width] = image
        top += height + gap
    return full


def frame_picture(frames: Frames, found: Detections, config: Config, title: str) -> np.ndarray:
    """Return the picture of a batch of one frame, drawn by :func:`jaxdet.render.draw_frame`."""
    calibration, plane = frames.calibration, frames.plane
    if config.cluster.points and plane is not None:  # lengths refer to the colour camera
        frames = frames._replace(plane=plane_in_color(plane, calibration))
    unit = calibration.depth_unit
    corners = rectangles(found.obstacles, unit, config.footprint)
    return draw_frame(frames, found, corners, 0, config, title)


def shot_picture(shot: Shot, system: System) -> np.ndarray:
    """Return the picture of the detections of a system in a frame."""
    found = found_by(system, Prepared([shot]))[0]
    return frame_picture(frames_of([shot]), found, system.config, shot.title)


def side_by_side(shot: Shot, systems: Sequence[System], titles: Sequence[str]) -> bytes:
    """Return the detections of several systems in a frame, as a PNG file."""
    views, prepared = [], Prepared([shot])
    for system, title in zip(systems, titles, strict=True):
        found = found_by(system, prepared)[0]
        shown = shown_image(frames_of([shot]), 0, system.config)
        view = camera_view(shown, found, 0, system.config, 1.0)
        views.append(titled(view, title, 420))
    return encode(grid(views, len(views)))
