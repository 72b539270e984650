"""Merging of overlapping obstacles of a frame into one observation."""

import numpy as np

from jaxdet.elementary import dot
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.observations import Observations
from jaxdet.tracks.outlines import Outlines, gap, overlap, perpendicular
from jaxdet.tracks.pairs import components, pairs_in_frames


def merge_overlapping(
    obs: Observations, size: np.ndarray, config: TrackConfig
) -> tuple[Observations, np.ndarray]:
    """Merge obstacles of a frame that belong to the same object, as their outlines overlap.

    For example, a walking person may be detected as two legs with overlapping outlines, or with a
    separate arm next to the body. Obstacles that seem to float because a nearer one hides their
    lower part are not merged for that reason.

    Args:
        obs: ``N`` obstacles.
        size: Number of cells of each obstacle, ``(N,)``; the largest one determines the
            orientation.
        config: Limits of overlap and contact.

    Returns:
        Merged observations, and the index ``(N,)`` int64 of each obstacle's observation.
    """
    a, b = pairs_in_frames(obs.frame)
    larger = size[b] > size[a]
    small, large = np.where(larger, a, b), np.where(larger, b, a)
    before = np.bincount(small, _is_before(obs, large, small), len(obs.frame))
    before += np.bincount(large, _is_before(obs, small, large), len(obs.frame))
    short = 2 * obs.outline.half.max(axis=1) <= config.long_m
    both = short[a] & short[b]
    a, b, small, large = a[both], b[both], small[both], large[both]
    shared = overlap(obs.outline.take(a), obs.outline.take(b))
    others = before[small] > _is_before(obs, large, small)
    floats = (obs.bottom_m[small] > config.floats_m) & ~others
    near = gap(obs.outline.take(a), obs.outline.take(b)) <= config.touch_m
    held = (shared >= config.overlap) | (floats & near)
    a, b = a[held], b[held]
    root = components(len(obs.frame), a, b)
    leaders, group = np.unique(root, return_inverse=True)
    if len(leaders) == len(root):
        return obs, group
    # The largest obstacle of each group, the first one in a tie.
    order = np.lexsort((np.arange(len(root)), -size, group))
    lead = order[np.searchsorted(group[order], np.arange(len(leaders)))]
    return _joined(obs, group, lead), group


def _is_before(obs: Observations, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return whether ``one`` is nearer than ``other`` and covers half of its columns or more."""
    columns = obs.columns
    width = np.minimum(columns[one, 1], columns[other, 1])
    width -= np.maximum(columns[one, 0], columns[other, 0])
    nearer = obs.distance_m[one] < obs.distance_m[other]
    return nearer & (2 * width >= columns[other, 1] - columns[other, 0])


def _joined(obs: Observations, group: np.ndarray, lead: np.ndarray) -> Observations:
    """Return the bounding rectangle of each group, oriented like its largest obstacle."""
    count = len(lead)
    axis, middle = obs.outline.axis[lead], obs.outline.center[lead]
    shift = obs.outline.center - middle[group]
    center, half = middle.copy(), np.empty((count, 2))
    for side, direction in enumerate((axis, perpendicular(axis))):
        along, reach = dot(shift, direction[group]), obs.outline.reach(direction[group])
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(low, group, along - reach)
        np.maximum.at(high, group, along + reach)
        center += ((low + high) / 2)[:, None] * direction
        half[:, side] = (high - low) / 2
    bottom, top = np.full((2, count), np.nan)
    np.fmin.at(bottom, group, obs.bottom_m)
    np.fmax.at(top, group, obs.top_m)
    weight, distance = np.ones(count), np.full(count, np.inf)
    np.minimum.at(weight, group, obs.weight)
    np.minimum.at(distance, group, obs.distance_m)
    columns, across = np.full((2, count, 2), np.nan)
    for joined, own in ((columns, obs.columns), (across, obs.across_m)):
        np.fmin.at(joined[:, 0], group, own[:, 0])
        np.fmax.at(joined[:, 1], group, own[:, 1])
    hidden = np.zeros((count, 2), bool)
    np.logical_or.at(hidden, group, obs.hidden)
    obstacles = np.bincount(group, obs.obstacles, count).astype(np.int64)
    kept = obs.take(lead)
    return kept._replace(
        outline=Outlines(center, axis, half),
        bottom_m=bottom,
        top_m=top,
        weight=weight,
        columns=columns,
        across_m=across,
        distance_m=distance,
        hidden=hidden,
        obstacles=obstacles,
    )
