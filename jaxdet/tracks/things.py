"""What is seen of things: the obstacles of a frame, those joined whose outlines overlap."""

from typing import NamedTuple

import numpy as np

from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.outlines import Outlines, gap, overlap, turned
from jaxdet.tracks.pairs import components, pairs_in_frames


class Things(NamedTuple):
    """``N`` sightings of things, by frame."""

    frame: np.ndarray
    """``(N,)`` int64, ascending."""
    stamp_ns: np.ndarray
    """``(N,)`` int64."""
    outline: Outlines
    """``(N,)`` on the floor."""
    bottom_m: np.ndarray
    """``(N,)`` float64, lowest point above the floor, NaN where it is not known [m]."""
    top_m: np.ndarray
    """``(N,)`` float64, highest point, likewise [m]."""
    weight: np.ndarray
    """``(N,)`` float64, how much its outline says about where it is, 1 for a near and whole one."""
    columns: np.ndarray
    """``(N, 2)`` float64, its least and greatest column, in widths of the image."""
    across_m: np.ndarray
    """``(N, 2)`` float64, its least and greatest x in the camera [m]."""
    distance_m: np.ndarray
    """``(N,)`` float64, of its nearest point from the camera's foot [m]."""
    rightwards: np.ndarray
    """``(N, 2)`` float64, where the image's columns go on the floor, a unit vector in the outline's
    frame; 0 where they go up or down."""
    hidden: np.ndarray
    """``(N, 2)`` bool, whether its left and its right side are out of sight: beyond the image's
    border, or behind something nearer."""
    in_world: np.ndarray
    """``(N,)`` bool, whether the outline is in the world, else in the camera's ground frame; the
    same for all of a frame."""
    obstacles: np.ndarray
    """``(N,)`` int64, obstacles joined to it."""

    def take(self, rows: np.ndarray) -> "Things":
        """Those of some rows, or of a mask."""
        rest = {name: getattr(self, name)[rows] for name in Things._fields if name != "outline"}
        return Things(outline=self.outline.take(rows), **rest)


def join_things(first: Things, second: Things) -> Things:
    """Those of ``first``, then those of ``second``."""
    outline = Outlines(*map(np.concatenate, zip(first.outline, second.outline, strict=True)))
    rest = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in Things._fields
        if name != "outline"
    }
    return Things(outline=outline, **rest)


def whole_things(seen: Things, size: np.ndarray, config: TrackConfig) -> tuple[Things, np.ndarray]:
    """Joins obstacles of a frame that can't be two things, as their outlines overlap.

    Of a person who walks a frame may show two legs, which stand within each other's outlines, or an
    arm, which floats beside the body. What seems to float behind something nearer may well stand.

    Args:
        seen: ``N`` obstacles.
        size: ``(N,)``, their cells in the image; a thing is turned as its largest obstacle.
        config: How much they overlap.

    Returns:
        The things, and ``(N,)`` int64, the thing of each obstacle.
    """
    a, b = pairs_in_frames(seen.frame)
    larger = size[b] > size[a]
    small, large = np.where(larger, a, b), np.where(larger, b, a)
    before = np.bincount(small, _is_before(seen, large, small), len(seen.frame))
    before += np.bincount(large, _is_before(seen, small, large), len(seen.frame))
    short = 2 * seen.outline.half.max(axis=1) <= config.long_m
    both = short[a] & short[b]
    a, b, small, large = a[both], b[both], small[both], large[both]
    shared = overlap(seen.outline.take(a), seen.outline.take(b))
    others = before[small] > _is_before(seen, large, small)
    floats = (seen.bottom_m[small] > config.floats_m) & ~others
    near = gap(seen.outline.take(a), seen.outline.take(b)) <= config.touch_m
    held = (shared >= config.overlap) | (floats & near)
    a, b = a[held], b[held]
    root = components(len(seen.frame), a, b)
    leaders, thing = np.unique(root, return_inverse=True)
    if len(leaders) == len(root):
        return seen, thing
    # The largest obstacle of each thing, the first of equals.
    order = np.lexsort((np.arange(len(root)), -size, thing))
    lead = order[np.searchsorted(thing[order], np.arange(len(leaders)))]
    return _joined(seen, thing, lead), thing


def _is_before(seen: Things, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether ``one`` is nearer than ``other``, before at least half of its columns."""
    columns = seen.columns
    width = np.minimum(columns[one, 1], columns[other, 1])
    width -= np.maximum(columns[one, 0], columns[other, 0])
    nearer = seen.distance_m[one] < seen.distance_m[other]
    return nearer & (2 * width >= columns[other, 1] - columns[other, 0])


def _joined(seen: Things, thing: np.ndarray, lead: np.ndarray) -> Things:
    """The rectangle around all obstacles of each thing, turned as its leader's."""
    count = len(lead)
    axis, middle = seen.outline.axis[lead], seen.outline.center[lead]
    shift = seen.outline.center - middle[thing]
    center, half = middle.copy(), np.empty((count, 2))
    for side, way in enumerate((axis, turned(axis))):
        along, reach = (shift * way[thing]).sum(axis=1), seen.outline.reach(way[thing])
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(low, thing, along - reach)
        np.maximum.at(high, thing, along + reach)
        center += ((low + high) / 2)[:, None] * way
        half[:, side] = (high - low) / 2
    bottom, top = np.full((2, count), np.nan)
    np.fmin.at(bottom, thing, seen.bottom_m)
    np.fmax.at(top, thing, seen.top_m)
    weight, distance = np.ones(count), np.full(count, np.inf)
    np.minimum.at(weight, thing, seen.weight)
    np.minimum.at(distance, thing, seen.distance_m)
    columns, across = np.full((2, count, 2), np.nan)
    for joined, own in ((columns, seen.columns), (across, seen.across_m)):
        np.fmin.at(joined[:, 0], thing, own[:, 0])
        np.fmax.at(joined[:, 1], thing, own[:, 1])
    hidden = np.zeros((count, 2), bool)
    np.logical_or.at(hidden, thing, seen.hidden)
    obstacles = np.bincount(thing, seen.obstacles, count).astype(np.int64)
    kept = seen.take(lead)
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
