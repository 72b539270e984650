"""Rasterise the shapes of a frame onto a floor grid fixed in the world."""

from collections.abc import Sequence
from itertools import islice
from typing import Literal, NamedTuple

import cv2
import numpy as np

from jaxdet.results.occupancy import CELL_M, SHIFT, placed


class Layer(NamedTuple):
    """Shapes whose cells get the same value."""

    value: int
    kind: Literal["areas", "outlines", "lines", "dots"]
    """Polygons that do not overlap; convex polygons; open lines; or sets of points."""
    shapes: Sequence[np.ndarray]
    """Corners of each shape, ``(n, 2)`` float64, world X and Y [m]."""
    thickness: int = 1
    """Thickness of lines and dots [cell]."""


class Raster(NamedTuple):
    """Cells around the shapes of a frame."""

    cells: np.ndarray
    """Values ``(rows, columns)`` uint8, 0 without a shape; row 0 is the lowest Y."""
    low: np.ndarray
    """Column and row of the first cell, counted from the world's origin, ``(2,)`` int64."""


def rasterize(layers: Sequence[Layer]) -> Raster | None:
    """Draw layers, each over the previous ones.

    Args:
        layers: Shapes; those that are too large or too far for a map are left out.

    Returns:
        The smallest raster around the shapes; None without shapes, or if it would be too large.
    """
    shapes = [shape for layer in layers for shape in layer.shapes]
    if not shapes:
        return None
    fits = placed(np.concatenate(shapes), np.array([len(shape) for shape in shapes])).fits
    fitting = [shape for shape, fit in zip(shapes, fits, strict=True) if fit]
    if not fitting:
        return None
    pad = CELL_M * max(layer.thickness // 2 + 1 for layer in layers)
    points = np.concatenate(fitting)
    around = [points, points.min(axis=0, keepdims=True) - pad, points.max(axis=0)[None] + pad]
    together = placed(np.concatenate(around), np.array([len(points) + 2]))
    if not together.fits[0]:
        return None
    places = np.split(together.points[:-2], np.cumsum([len(shape) for shape in fitting])[:-1])
    cells = np.zeros(together.size[0, ::-1], np.uint8)
    of = np.repeat(np.arange(len(layers)), [len(layer.shapes) for layer in layers])[fits]
    left = iter(places)
    for layer, count in zip(layers, np.bincount(of, minlength=len(layers)), strict=True):
        _draw(cells, layer, list(islice(left, count)))
    return Raster(cells, together.low[0])


def _draw(cells: np.ndarray, layer: Layer, places: list[np.ndarray]) -> None:
    if layer.kind == "areas" and places:
        cv2.fillPoly(cells, places, (layer.value,), cv2.LINE_8, SHIFT)
    elif layer.kind == "outlines":
        for place in places:
            cv2.fillConvexPoly(cells, place, (layer.value,), cv2.LINE_8, SHIFT)
    elif layer.kind == "dots":
        for place in places:  # a closed line of one point is a dot
            lines = list(place[:, None])
            cv2.polylines(cells, lines, True, (layer.value,), layer.thickness, cv2.LINE_8, SHIFT)
    elif places:
        cv2.polylines(cells, places, False, (layer.value,), layer.thickness, cv2.LINE_8, SHIFT)
