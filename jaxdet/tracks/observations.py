"""Observations of objects, each from one obstacle or merged from several obstacles of a frame."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import cos, dot
from jaxdet.tracks.outlines import Outlines

BORDER_PX = 1
"""Distance from the image border within which a box counts as cut off [pixel]."""
NOISE_M = 3.0
"""Distance at which depth noise, which grows with the square of the distance, equals the constant
noise [m]."""


class Observations(NamedTuple):
    """``N`` observations of objects, sorted by frame."""

    frame: np.ndarray
    """Frame index ``(N,)`` int64, ascending."""
    stamp_ns: np.ndarray
    """Timestamps ``(N,)`` int64."""
    outline: Outlines
    """Outlines on the floor, ``(N,)``."""
    bottom_m: np.ndarray
    """Height of the lowest point above the floor, ``(N,)`` float64, NaN if unknown [m]."""
    top_m: np.ndarray
    """Height of the highest point above the floor, ``(N,)`` float64, NaN if unknown [m]."""
    weight: np.ndarray
    """Weight of the outline in position fits, ``(N,)`` float64: 1 near the camera, less far away.
    """
    columns: np.ndarray
    """First and last image column, ``(N, 2)`` float64 [image widths]."""
    across_m: np.ndarray
    """Minimum and maximum x in the camera frame, ``(N, 2)`` float64 [m]."""
    distance_m: np.ndarray
    """Distance of the nearest point from the camera's ground projection, ``(N,)`` float64 [m]."""
    rightwards: np.ndarray
    """Direction of increasing image columns on the floor, in the outline's frame, ``(N, 2)``
    float64, unit vector; 0 if the camera is on its side."""
    hidden: np.ndarray
    """Whether the left and the right side are hidden, by the image border or a nearer object,
    ``(N, 2)`` bool."""
    in_world: np.ndarray
    """Whether the outline is in the world frame, else in the camera's ground frame, ``(N,)`` bool;
    equal for all observations of a frame."""
    obstacles: np.ndarray
    """Number of merged obstacles, ``(N,)`` int64."""

    def take(self, rows: np.ndarray) -> "Observations":
        """Return the observations selected by indices or a mask."""
        names = [name for name in self._fields if name != "outline"]
        rest = {name: getattr(self, name)[rows] for name in names}
        return Observations(outline=self.outline.take(rows), **rest)


def concatenate(first: Observations, second: Observations) -> Observations:
    """Concatenate two sets of observations."""
    outline = Outlines(*map(np.concatenate, zip(first.outline, second.outline, strict=True)))
    rest = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in Observations._fields
        if name != "outline"
    }
    return Observations(outline=outline, **rest)


def observations_of(
    frame: np.ndarray,
    stamp_ns: np.ndarray,
    roll_rad: np.ndarray,
    columns: Mapping[str, np.ndarray],
    width: int | None,
) -> Observations:
    """Build one observation per obstacle, in the world frame if the pose is known.

    Without a pose the camera's ground frame is used.

    Args:
        frame: Frame indices ``(N,)``.
        stamp_ns: Timestamps ``(N,)``.
        roll_rad: Camera roll ``(N,)``, NaN if unknown.
        columns: Columns of ``obstacles.parquet``: ``corners_ground``, ``corners_world`` (NaN
            without a pose), ``bottom_m``, ``top_m``, ``distance_m`` (NaN without a floor),
            ``z_min``, ``u_min``, ``u_max``, ``x_min``, ``x_max``.
        width: Width of the image that the boxes refer to [pixel], None if unknown. Obstacles
            outside of this image have NaN in ``u_min`` and ``u_max``, and no hidden side.
    """
    world = columns["corners_world"]
    in_world = np.asarray(np.isfinite(world).all(axis=1))
    outline = Outlines.of_corners(np.where(in_world[:, None], world, columns["corners_ground"]))
    wide = width or 1
    columns_of = np.stack([columns["u_min"], columns["u_max"]], axis=1) / wide
    hidden = np.zeros((len(frame), 2), bool)
    if width is not None:
        hidden[:, 0] = columns["u_min"] <= BORDER_PX
        hidden[:, 1] = columns["u_max"] >= width - 1 - BORDER_PX
    across = np.stack([columns["x_min"], columns["x_max"]], axis=1).astype(np.float64)
    rightwards = (
        _rightwards(columns["corners_ground"], world, in_world) * _across(roll_rad)[:, None]
    )
    distance, depth = (columns[name].astype(np.float64) for name in ("distance_m", "z_min"))
    distance = np.where(np.isnan(distance), depth, distance)
    weight = 1 / (1 + ((distance / NOISE_M) ** 2) ** 2)
    bottom, top = (columns[name].astype(np.float64) for name in ("bottom_m", "top_m"))
    one = np.ones(len(frame), np.int64)
    return Observations(
        *(frame, stamp_ns, outline, bottom, top, weight),
        *(columns_of, across, distance, rightwards, hidden, in_world, one),
    )


def _rightwards(ground: np.ndarray, world: np.ndarray, in_world: np.ndarray) -> np.ndarray:
    """Return the right axis of the ground frame in the frame of the outlines, ``(N, 2)``."""
    one, other = (c.astype(np.float64)[:, 4:6] - c[:, :2] for c in (ground, world))
    length = np.maximum(dot(one, one), 1e-12)
    # In the ground frame x is right and y is forward; the rotation maps one diagonal to the other.
    cos = dot(one, other) / length
    sin = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / length
    return np.where(in_world[:, None], np.stack([cos, sin], axis=1), (1.0, 0.0))


def _across(roll_rad: np.ndarray) -> np.ndarray:
    """Return the direction of increasing image columns, ``(N,)``: 1 right, -1 left, 0 neither.

    The direction is left for an upside-down camera (roll of 135 degrees or more), and neither for a
    camera on its side (45 degrees or more).
    """
    upright = cos(np.where(np.isnan(roll_rad), 0.0, roll_rad))
    return np.where(np.abs(upright) > cos(np.pi / 4), np.sign(upright), 0.0)
