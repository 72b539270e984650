"""Grouping of obstacles between which the robot can't pass."""

import numpy as np

from jaxdet.eval.polygon import hull
from jaxdet.eval.truth import FrameTruth


def group_objects(truth: FrameTruth, lateral_gap_m: float, depth_gap_m: float) -> FrameTruth:
    """Join the obstacles of the truth that are one obstacle by the paper's definition.

    "If the space between the two obstacles cannot pass through the robot, the obstacles can be
    classified as one class" (Section 3.4). In each frame, two visible obstacles are joined if the
    extents of their visible surfaces in the ground frame are at most ``lateral_gap_m`` apart
    sideways and at most ``depth_gap_m`` apart forward; joining is transitive. The definition is
    that of the method, so figures on such a truth favour the method: reports must state that, and
    also have the figures on the original truth.

    Args:
        truth: Ground truth with ``ground_min`` and ``ground_max``.
        lateral_gap_m: Width of the robot [m].
        depth_gap_m: Maximum step in depth within one obstacle [m].

    Returns:
        Ground truth in which each group has the number of its first member, with the sum of pixels,
        the joint extent, the convex hull as footprint and the largest height. The other members are
        not visible.

    Raises:
        ValueError: The truth has no extents.
    """
    if truth.ground_min is None or truth.ground_max is None:
        raise ValueError("objects can't be grouped without ground_min and ground_max")
    out = truth._replace(
        **{k: np.array(v) for k, v in truth._asdict().items() if v is not None and k != "is_wall"}
    )
    gaps = np.array([lateral_gap_m, depth_gap_m])
    for b in range(len(truth.visible_pixels)):
        visible = np.flatnonzero(~truth.is_wall & (truth.visible_pixels[b] > 0))
        low, high = truth.ground_min[b, visible], truth.ground_max[b, visible]
        apart = np.maximum(low[:, None] - high, low - high[:, None])
        for members in _groups(np.all(apart <= gaps, axis=-1)):
            if len(members) > 1:
                _join(out, b, visible[members])
    return out


def _groups(near: np.ndarray) -> list[np.ndarray]:
    """Return the connected components of a symmetric ``(n, n)`` bool relation, ascending."""
    names = np.arange(len(near))
    for _ in range(len(near)):
        names = np.where(near, names, len(near)).min(axis=1, initial=len(near))
    return [np.flatnonzero(names == name) for name in np.unique(names)]


def _join(truth: FrameTruth, b: int, members: np.ndarray) -> None:
    """Join the objects ``members`` of frame ``b`` under the number of the first one, in place."""
    first, rest = members[0], members[1:]
    assert truth.ground_min is not None and truth.ground_max is not None
    picture = truth.obstacle_id[b]
    picture[np.isin(picture, rest + 1)] = first + 1
    truth.visible_pixels[b, first] = truth.visible_pixels[b, members].sum()
    truth.visible_pixels[b, rest] = 0
    lowest = [truth.nearest_m, truth.nearest_forward_m, truth.ground_min]
    lowest += [] if truth.nearest_floor_m is None else [truth.nearest_floor_m]
    for array, join in [*((a, np.min) for a in lowest), (truth.ground_max, np.max)]:
        array[b, first] = join(array[b, members], axis=0)
        array[b, rest] = np.nan
    if truth.height_m is not None:
        truth.height_m[b, first] = truth.height_m[b, members].max()
    if truth.footprint is not None:
        room = truth.footprint.shape[2]
        outline = hull(truth.footprint[b, members].reshape(-1, 2))[:room]
        truth.footprint[b, members] = np.nan
        truth.footprint[b, first, : len(outline)] = outline
