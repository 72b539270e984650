"""Top view of a frame: points, outlines and free floor in the ground frame, in metres."""

from typing import NamedTuple

import cv2
import numpy as np

import jaxdet.render.canvas as canvas
from jaxdet.floor.plane import GROUND_BITS, ground_axes
from jaxdet.results.free_floor import free_floor, ray_bearings
from jaxdet.types import Calibration, Detections, FreeEnd, GroundPlane, Scene

_MARGIN = 34
_AHEAD = np.array([[[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]])
"""Pose of a camera at the origin of a world, with its forward direction along y."""


class View(NamedTuple):
    """Transform from the ground frame to pixels."""

    center: float
    """Column of the camera [pixel]."""
    bottom: float
    """Row of the camera [pixel]."""
    scale: float
    """Pixels per metre."""

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Convert points ``(..., 2)``, right and forward [m], to pixels."""
        x, y = points[..., 0], points[..., 1]
        return np.stack([self.center + x * self.scale, self.bottom - y * self.scale], axis=-1)


def top_view(
    size: tuple[int, int],
    found: Detections,
    corners: np.ndarray,
    row: int,
    plane: GroundPlane,
    calibration: Calibration,
    max_depth_m: float,
) -> np.ndarray:
    """Draw the ground in front of the camera, with the camera at the bottom.

    Args:
        size: Height and width of the picture [pixel].
        found: Detections of the batch, as NumPy arrays.
        corners: Outlines in the ground frame, ``(B, M, 4, 2)`` float64 [m].
        row: Row of the frame.
        plane: Planes ``(B,)``.
        calibration: Calibration with the field of view and the depth unit.
        max_depth_m: Maximum depth, and reach of the view [m].

    Returns:
        Picture ``size + (3,)`` uint8, RGB.
    """
    height, width = size
    image = canvas.canvas(height, width, canvas.PANEL)
    camera = calibration.image if found.points is not None else calibration.depth
    left, right = camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    wide = 2 * max(left, right) * max_depth_m
    scale = min((height - 2 * _MARGIN) / max_depth_m, (width - _MARGIN) / wide)
    view = View(width / 2, height - _MARGIN, scale)
    wedge = np.array(
        [[0, 0], [-left * max_depth_m, max_depth_m], [right * max_depth_m, max_depth_m]]
    )
    canvas.polygon(image, view.pixels(wedge), (44, 54, 68), fill=0.75, width=0)
    unit = calibration.depth_unit
    if found.scene is not None:
        _draw_free(image, view, found.scene, row, unit)
    _draw_grid(image, view)
    canvas.line(image, view.pixels(wedge[[1, 0, 2]]), (84, 100, 122))
    _draw_points(image, view, found, row, plane, unit)
    _draw_outlines(image, view, found, corners, row)
    if found.scene is None:
        _draw_marks(image, view, found, row, unit)
    else:
        _draw_contours(image, view, found.scene, int(found.num_obstacles[row]), row, unit)
    body = view.pixels(np.zeros(2)) + np.array([[-9.0, 14], [9, 14], [5, 0], [-5, 0]])
    canvas.polygon(image, body, canvas.TEXT, fill=1.0, width=1)
    return image


def ground_points(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, row: int, plane: GroundPlane, unit: float
) -> np.ndarray:
    """Project points of a frame onto the ground.

    Args:
        x: x of points in the camera optical frame, ``(N,)`` integer [depth units].
        y: y of the points.
        z: z of the points.
        row: Row of the frame.
        plane: Planes ``(B,)``.
        unit: Metres per depth unit.

    Returns:
        Right and forward coordinates, ``(N, 2)`` float64 [m].
    """
    xyz = np.stack([x, y, z], axis=1).astype(np.float64)
    return xyz @ ground_axes(plane)[row].T.astype(np.float64) / (1 << GROUND_BITS) * unit


def _draw_grid(image: np.ndarray, view: View) -> None:
    height, width = image.shape[:2]
    reach_x, reach_y = view.center / view.scale, view.bottom / view.scale
    step = next(s for s in (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0) if s * view.scale > 60 or s == 20)
    for i in range(int(reach_y / step) + 1):
        y = float(view.pixels(np.array([0, i * step]))[1])
        canvas.line(image, np.array([[0, y], [width, y]]), canvas.GRID)
        if i:
            canvas.write(image, f"{i * step:g} m", (8, y - 5), canvas.FAINT, 13)
    for i in range(-int(reach_x / step), int(reach_x / step) + 1):
        x = float(view.pixels(np.array([i * step, 0]))[0])
        canvas.line(image, np.array([[x, 0], [x, height]]), canvas.GRID)
        label = f"{i * step:+g}" if i else "0"
        canvas.write(image, label, (x, height - 7), canvas.FAINT, 13, align="center")


def _draw_points(
    image: np.ndarray, view: View, found: Detections, row: int, plane: GroundPlane, unit: float
) -> None:
    if found.points is not None:
        place, labels = found.points.features, found.points.labels.labels[row]
        shown, radius = place.valid[row] & place.kept[row], 2.5
    elif found.cells is not None:
        place, labels = found.cells.cells, found.cells.label[row]
        shown, radius = found.cells.keep[row], 1.5
    else:
        return
    shown = shown | (labels >= 0)
    x, y, z = (axis[row][shown] for axis in (place.x, place.y, place.z))
    points, labels = view.pixels(ground_points(x, y, z, row, plane, unit)), labels[shown]
    canvas.dots(image, points[labels < 0], canvas.DROPPED, 0.8 * radius)
    for label in reversed(range(int(found.num_obstacles[row]))):
        canvas.dots(image, points[labels == label], canvas.color_of(label), radius, 0.4 * radius)


def _draw_outlines(
    image: np.ndarray, view: View, found: Detections, corners: np.ndarray, row: int
) -> None:
    for label in reversed(range(int(found.num_obstacles[row]))):
        outline = view.pixels(corners[row, label])
        canvas.polygon(image, outline, canvas.color_of(label), fill=0.30)


def _draw_marks(image: np.ndarray, view: View, found: Detections, row: int, unit: float) -> None:
    """Draw the points A, B and C."""
    obstacles = found.obstacles
    for label in reversed(range(int(found.num_obstacles[row]))):
        marks = np.stack(
            [obstacles.a[row, label], obstacles.b[row, label], obstacles.c[row, label]]
        )
        spots = view.pixels(marks * unit)
        canvas.dots(image, spots, canvas.color_of(label), 3.5)
        # The letters don't overlap: A is left of the outline, B right, C below.
        aligned = ("right", (-7, 4)), ("left", (7, 4)), ("center", (0, 18))
        for name, at, (align, shift) in zip("ABC", spots.tolist(), aligned, strict=True):
            place = (at[0] + shift[0], at[1] + shift[1])
            canvas.write(image, name, place, canvas.color_of(label), 13, bold=True, align=align)


def _draw_contours(
    image: np.ndarray, view: View, scene: Scene, count: int, row: int, unit: float
) -> None:
    """Draw the visible edge of each obstacle, and the drops."""
    for label in reversed(range(count)):
        points = scene.contour[row, label, : scene.contour_points[row, label]]
        canvas.line(image, view.pixels(points * unit), (10, 12, 16), 4)
        canvas.line(image, view.pixels(points * unit), canvas.color_of(label), 2)
    drops = _ray_places(scene, row)[scene.free_end[row] == FreeEnd.DROP, 1]
    canvas.dots(image, view.pixels(drops * unit), canvas.DROP, 2.0)


def _ray_places(scene: Scene, row: int) -> np.ndarray:
    """Return start and end of the free floor of each ray (right, forward) [depth units].

    The shape is ``(RAYS, 2, 2)``.
    """
    _, way = ray_bearings()
    return (
        np.asarray(scene.free[row])[..., None] * np.stack([np.real(way), np.imag(way)], -1)[:, None]
    )


def _draw_free(image: np.ndarray, view: View, scene: Scene, row: int, unit: float) -> None:
    """Draw the free floor between neighbouring rays that both have free floor."""
    rows = slice(row, row + 1)
    free = free_floor(scene.free[rows], scene.free_end[rows], unit).in_world(_AHEAD)
    rings = np.split(view.pixels(free.points), np.cumsum(free.corners))[:-1]
    layer = image.copy()
    for ring in rings:
        cv2.fillPoly(layer, [canvas.fixed(ring)], canvas.FREE, cv2.LINE_AA, canvas.SHIFT)
    cv2.addWeighted(layer, 0.3, image, 0.7, 0, dst=image)
