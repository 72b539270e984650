"""Rows of ``obstacles.parquet`` as sightings of things."""

from collections.abc import Mapping

import numpy as np

from jaxdet.tracks.outlines import Outlines
from jaxdet.tracks.things import Things

CUT = 0.5
"""Weight of an outline that the image's left or right border cuts off."""
BORDER_PX = 1
"""So near to it [pixel]."""
NOISE_M = 3.0
"""Where the noise of depth, which grows with its square, is as large as that near by [m]."""


def obstacles_seen(
    frame: np.ndarray,
    stamp_ns: np.ndarray,
    columns: Mapping[str, np.ndarray],
    width: int | None,
) -> Things:
    """Obstacles as things: in the world where a pose is known, else in the camera's ground frame.

    Args:
        frame: ``(N,)``.
        stamp_ns: ``(N,)``.
        columns: Of ``obstacles.parquet``: ``corners_ground``, ``corners_world`` (NaN without a
            pose), ``bottom_m``, ``top_m``, ``distance_m``, ``u_min``, ``u_max``.
        width: Of the colour image, None where that is not known [pixel].
    """
    world = columns["corners_world"]
    known = np.asarray(np.isfinite(world).all(axis=1))
    outline = Outlines.of_corners(np.where(known[:, None], world, columns["corners_ground"]))
    right = np.inf if width is None else width - 1 - BORDER_PX
    side = (columns["u_max"] >= right) - (columns["u_min"] <= BORDER_PX).astype(np.float64)
    cut = side[:, None] * _rightwards(columns["corners_ground"], world, known)
    noise = 1 + (columns["distance_m"].astype(np.float64) / NOISE_M) ** 4
    weight = np.where(side != 0, CUT, 1.0) / noise
    bottom, top = (columns[name].astype(np.float64) for name in ("bottom_m", "top_m"))
    one = np.ones(len(frame), np.int64)
    return Things(frame, stamp_ns, outline, bottom, top, weight, cut, known, one)


def _rightwards(ground: np.ndarray, world: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``(N, 2)``, the camera's right in the frame of the outlines, from their diagonals."""
    one, other = (c.astype(np.float64)[:, 4:6] - c[:, :2] for c in (ground, world))
    length = np.maximum((one * one).sum(axis=1), 1e-12)
    # The ground frame is right-handed with x right, y forward: the turn takes one to the other.
    cos = (one * other).sum(axis=1) / length
    sin = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / length
    return np.where(known[:, None], np.stack([cos, sin], axis=1), (1.0, 0.0))
