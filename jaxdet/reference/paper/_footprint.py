"""Stage 5, footprint: extent and outline of each obstacle on the floor (Section 3.5)."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import GROUND_BITS, ground_axes
from jaxdet.reference._measures import footprint_on_floor
from jaxdet.types import MAX_LATERAL, Features, GroundPlane, Labels, Obstacles


def footprint(
    features: Features,
    labels: Labels,
    plane: GroundPlane,
    depth_unit: float,
    config: Config,
) -> Obstacles:
    """Measure each obstacle and find its points A, B and C on the floor (Eq. 7).

    The points are projected onto the floor (:func:`to_ground`), at most MAX_LATERAL away. A is the
    leftmost, B the rightmost, C the nearest; ties go to the nearer point, for C to the leftmost. If
    the configuration sets a trim and bands, the outermost and nearest points are trimmed, and A, B
    and C are medians of bands instead (:func:`_outermost`). C is a vertex unless

        min(d_A, d_B) - d_C < d_threshold

    with d the distance forward. :func:`jaxdet.results.metric.rectangles` draws the rectangle, which
    need not contain all points: points in front of AB, to the side of C or behind are outside.
    Therefore ``nearest`` is computed from all points.

    Args:
        features: Points ``(B, N)``.
        labels: Obstacle of each point.
        plane: Floor of each frame, for the axes of the ground frame.
        depth_unit: Metres in one depth unit.
        config: Configuration, of which ``footprint`` is used; ``M`` follows from N and
            ``cluster.min_points``.

    Returns:
        Obstacles ``(B, M)`` in the order of their labels.
    """
    slots = max(1, labels.labels.shape[1] // (config.cluster.min_points + 1))
    floor = np.clip(to_ground(features, plane), -MAX_LATERAL, MAX_LATERAL)
    found = footprint_on_floor(features, labels, floor, depth_unit, config.footprint, slots=slots)
    return found._replace(nearest=_nearest(labels, floor, slots))


def _nearest(labels: Labels, floor: np.ndarray, slots: int) -> np.ndarray:
    """Return the squared distance of each obstacle's nearest point, as a divmod by 2^18.

    Returns:
        Quotient and remainder, ``(B, M, 2)`` int32.
    """
    squared = (floor.astype(np.int64) ** 2).sum(axis=-1)
    nearest = np.zeros((len(floor), slots), np.int64)
    for b, count in enumerate(labels.num_obstacles):
        for label in range(int(count)):
            nearest[b, label] = squared[b, labels.labels[b] == label].min()
    return np.stack(np.divmod(nearest, 1 << 18), axis=-1).astype(np.int32)


def to_ground(features: Features, plane: GroundPlane) -> np.ndarray:
    """Transform points to the ground frame, in integer depth units.

    Returns:
        Right and forward ``(B, N, 2)`` int32.
    """
    xyz = np.stack([features.x, features.y, features.z], axis=-1).astype(np.int64)
    axes = ground_axes(plane).astype(np.int64)
    along = np.einsum("bnk,bak->bna", xyz, axes)  # noqa: TID251, of integers
    return ((along + (1 << (GROUND_BITS - 1))) >> GROUND_BITS).astype(np.int32)
