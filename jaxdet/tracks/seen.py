"""Rows of ``obstacles.parquet`` as sightings of things."""

from collections.abc import Mapping

import numpy as np

from jaxdet.tracks.outlines import Outlines
from jaxdet.tracks.things import Things

BORDER_PX = 1
"""So near to it [pixel]."""
NOISE_M = 3.0
"""Where the noise of depth, which grows with its square, is as large as that near by [m]."""


def obstacles_seen(
    frame: np.ndarray,
    stamp_ns: np.ndarray,
    roll_rad: np.ndarray,
    columns: Mapping[str, np.ndarray],
    width: int | None,
) -> Things:
    """Obstacles as things: in the world where a pose is known, else in the camera's ground frame.

    Args:
        frame: ``(N,)``.
        stamp_ns: ``(N,)``.
        roll_rad: ``(N,)``, the camera's, NaN where that is not known.
        columns: Of ``obstacles.parquet``: ``corners_ground``, ``corners_world`` (NaN without a
            pose), ``bottom_m``, ``top_m``, ``distance_m``, ``u_min``, ``u_max``,
            ``x_min``, ``x_max``.
        width: Of the image that boxes are in, None where that is not known [pixel]. Of obstacles
            outside of it ``u_min`` and ``u_max`` are NaN: then no side of theirs is hidden.
    """
    world = columns["corners_world"]
    known = np.asarray(np.isfinite(world).all(axis=1))
    outline = Outlines.of_corners(np.where(known[:, None], world, columns["corners_ground"]))
    wide = width or 1
    columns_of = np.stack([columns["u_min"], columns["u_max"]], axis=1) / wide
    hidden = np.zeros((len(frame), 2), bool)
    if width is not None:
        hidden[:, 0] = columns["u_min"] <= BORDER_PX
        hidden[:, 1] = columns["u_max"] >= width - 1 - BORDER_PX
    across = np.stack([columns["x_min"], columns["x_max"]], axis=1).astype(np.float64)
    rightwards = _rightwards(columns["corners_ground"], world, known) * _across(roll_rad)[:, None]
    distance = columns["distance_m"].astype(np.float64)
    weight = 1 / (1 + (distance / NOISE_M) ** 4)
    bottom, top = (columns[name].astype(np.float64) for name in ("bottom_m", "top_m"))
    one = np.ones(len(frame), np.int64)
    return Things(
        *(frame, stamp_ns, outline, bottom, top, weight),
        *(columns_of, across, distance, rightwards, hidden, known, one),
    )


def _rightwards(ground: np.ndarray, world: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``(N, 2)``, the ground frame's right in that of the outlines, from their diagonals."""
    one, other = (c.astype(np.float64)[:, 4:6] - c[:, :2] for c in (ground, world))
    length = np.maximum((one * one).sum(axis=1), 1e-12)
    # The ground frame is right-handed with x right, y forward: the turn takes one to the other.
    cos = (one * other).sum(axis=1) / length
    sin = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / length
    return np.where(known[:, None], np.stack([cos, sin], axis=1), (1.0, 0.0))


def _across(roll_rad: np.ndarray) -> np.ndarray:
    """``(N,)``, which way the image's columns go: 1 to the right, -1 to the left, 0 neither.

    To the left they go in a camera that is upside down (rolled by 135 degrees or more), neither in
    one on its side (45 degrees or more).
    """
    upright = np.cos(np.where(np.isnan(roll_rad), 0.0, roll_rad))
    return np.where(np.abs(upright) > np.cos(np.pi / 4), np.sign(upright), 0.0)
