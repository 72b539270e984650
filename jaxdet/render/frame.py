"""Picture of a frame: camera view and top view."""

import numpy as np

import jaxdet.render.canvas as canvas
from jaxdet.config import Config
from jaxdet.floor.plane import unknown_plane
from jaxdet.render.camera import camera_view, shown_image
from jaxdet.render.topview import top_view
from jaxdet.types import Detections, Frames

PANEL_HEIGHT = 540
TOP_WIDTH = 540
HEADER, FOOTER, GAP = 46, 34, 10
MAX_CAMERA_WIDTH = 960
_COLORS_SHOWN = 3
"""Number of obstacle colours in the legend."""


def draw_frame(
    frames: Frames,
    found: Detections,
    corners: np.ndarray,
    row: int,
    config: Config,
    title: str,
) -> np.ndarray:
    """Draw the detections of a frame.

    On the left is the colour image, or the depth image in false colours, with coloured cells, boxes
    and distances of the obstacles. On the right is the top view with outlines, contours, free floor
    and drops. The preset ``paper`` has corners instead of cells.

    Args:
        frames: Batch; its planes are relative to the depth camera (preset ``paper``: to the colour
            camera).
        found: Detections, as NumPy arrays, with cells.
        corners: Outlines in the ground frame, ``(B, M, 4, 2)`` float64 [m].
        row: Row of the frame in the batch.
        config: Configuration with the reach of the top view.
        title: Title of the picture.

    Returns:
        Picture ``(h, w, 3)`` uint8, RGB, w about 1280 for a 4:3 camera.
    """
    plane = frames.plane or unknown_plane(frames.valid.size)
    frames = frames._replace(plane=plane)
    shown = shown_image(frames, row, config)
    height, width = shown.image.shape[:2]
    scale = min(PANEL_HEIGHT / height, MAX_CAMERA_WIDTH / width)
    left = camera_view(shown, found, row, config, scale)
    size = (PANEL_HEIGHT, TOP_WIDTH)
    reach = config.ground.max_depth_m
    right = top_view(size, found, corners, row, plane, frames.calibration, reach)
    width = left.shape[1] + right.shape[1] + 3 * GAP
    image = canvas.canvas(HEADER + PANEL_HEIGHT + FOOTER, width)
    top = HEADER + (PANEL_HEIGHT - left.shape[0]) // 2
    image[top : top + left.shape[0], GAP : GAP + left.shape[1]] = left
    image[HEADER : HEADER + PANEL_HEIGHT, width - GAP - TOP_WIDTH : width - GAP] = right
    canvas.write(image, title, (GAP + 2, 30), size=19, bold=True)
    canvas.write(image, _camera_text(frames, row), (width - GAP, 30), canvas.FAINT, align="right")
    _draw_legend(image, found, row)
    return image


def _camera_text(frames: Frames, row: int) -> str:
    plane = frames.plane
    if plane is None or not plane.valid[row]:
        return "floor unknown; ~ is depth"
    pitch, roll = np.degrees([plane.pitch[row], plane.roll[row]])
    return f"camera {plane.height[row]:.2f} m up, {pitch:.1f}° down, roll {roll:+.1f}°"


def _legend(found: Detections, row: int) -> list[tuple[list[canvas.Color], str]]:
    """Return the legend: colours and text of each entry."""
    count = int(found.num_obstacles[row])
    obstacles = f"{count} obstacle" + "s" * (count != 1)
    several = [canvas.color_of(n) for n in range(min(max(count, 1), _COLORS_SHOWN))]
    if found.points is not None:
        features, labels = found.points
        valid, kept = features.valid[row], features.kept[row]
        inside = valid & (labels.labels[row] >= 0)
        dropped = f"{int((valid & ~kept).sum())} corners on the floor or out of range"
        loose = f"{int((valid & kept & ~inside).sum())} above it, without an obstacle"
        return [
            ([canvas.DROPPED], dropped),
            ([canvas.LOOSE], loose),
            (several, f"{int(inside.sum())} in {obstacles}"),
        ]
    return [
        (several, obstacles),
        ([canvas.LOOSE], "above the floor, without an obstacle"),
        ([canvas.FREE], "free floor"),
        ([canvas.DROP], "drop"),
    ]


def _draw_legend(image: np.ndarray, found: Detections, row: int) -> None:
    entries = _legend(found, row)
    x, y = float(GAP + 8), image.shape[0] - 11.0
    for colors, text in entries:
        for color in colors:
            canvas.dots(image, np.array([[x, y - 5]]), color, 4.0)
            x += 10
        canvas.write(image, text, (x + 2, y), canvas.FAINT)
        x += canvas.text_size(text, 15)[0] + 40
    label = "top view, metres right and forward of the camera"
    canvas.write(image, label, (image.shape[1] - GAP, y), canvas.FAINT, align="right")
