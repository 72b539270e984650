"""The picture of one frame: the camera's view beside the top view."""

import numpy as np

import jaxdet.render.canvas as canvas
from jaxdet.config import Config
from jaxdet.floor.plane import unknown_plane
from jaxdet.render.camera import camera_view
from jaxdet.render.topview import top_view
from jaxdet.types import Detections, Frames

PANEL_HEIGHT = 540
TOP_WIDTH = 540
HEADER, FOOTER, GAP = 46, 34, 10
MAX_CAMERA_WIDTH = 960
_COLORS_SHOWN = 3
"""Of the obstacles' colours, in the legend."""


def draw_frame(
    frames: Frames,
    found: Detections,
    corners: np.ndarray,
    row: int,
    config: Config,
    title: str,
) -> np.ndarray:
    """A picture of what was found in one frame.

    Left the colour image with the features (grey where dropped), the kept points coloured by
    obstacle, the boxes and the distance of the nearest point; right the top view, with a scene also
    the contours, the free floor and where it drops.

    Args:
        frames: The batch, with its planes.
        found: Its detections, as NumPy arrays.
        corners: ``(B, M, 4, 2)`` float64, outlines in the ground frame [m].
        row: The frame's row in the batch.
        config: For the reach of the top view.
        title: Heads the picture.

    Returns:
        ``(h, w, 3)`` uint8, RGB, w about 1280 for a 4:3 camera.
    """
    plane = frames.plane or unknown_plane(frames.valid.size)
    frames = frames._replace(plane=plane)
    calibration = frames.calibration
    camera = calibration.color
    scale = min(PANEL_HEIGHT / camera.height, MAX_CAMERA_WIDTH / camera.width)
    left = camera_view(frames.color[row], found, row, calibration.depth_unit, scale)
    size = (PANEL_HEIGHT, TOP_WIDTH)
    reach = config.ground.max_depth_m
    right = top_view(size, found, corners, row, plane, calibration, reach)
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
        return "floor unknown"
    pitch, roll = np.degrees([plane.pitch[row], plane.roll[row]])
    return f"camera {plane.height[row]:.2f} m up, {pitch:.1f}° down, roll {roll:+.1f}°"


def _draw_legend(image: np.ndarray, found: Detections, row: int) -> None:
    valid, kept = found.features.valid[row], found.features.kept[row]
    labelled = valid & (found.labels.labels[row] >= 0)
    count = int(found.labels.num_obstacles[row])
    obstacles = f"{count} obstacle" + "s" * (count != 1)
    loose = int((valid & kept & ~labelled).sum())
    several = [canvas.color_of(n) for n in range(min(max(count, 1), _COLORS_SHOWN))]
    inside = several, f"{int(labelled.sum())} in {obstacles}"
    if found.scene is None:
        dropped = f"{int((valid & ~kept).sum())} features on the floor or out of range"
        entries = [
            ([canvas.DROPPED], dropped),
            ([canvas.LOOSE], f"{loose} kept, in no obstacle"),
            inside,
        ]
    else:  # its features all lie above the floor
        entries = [([canvas.LOOSE], f"{loose} features in no obstacle"), inside]
        entries += [([canvas.FREE], "free floor"), ([canvas.DROP], "drop")]
    x, y = float(GAP + 8), image.shape[0] - 11.0
    for colors, text in entries:
        for color in colors:
            canvas.dots(image, np.array([[x, y - 5]]), color, 4.0)
            x += 10
        canvas.write(image, text, (x + 2, y), canvas.FAINT)
        x += canvas.text_size(text, 15)[0] + 40
    label = "top view, metres right and forward of the camera"
    canvas.write(image, label, (image.shape[1] - GAP, y), canvas.FAINT, align="right")
