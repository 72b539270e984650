"""The paper's rule as a good engineer writes it in NumPy: a loop over frames, packed keys."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import gap_units
from jaxdet.types import MAX_LATERAL, Features

SLOT_BITS = 13
"""Number of bits of a slot in a sort key; a frame has at most 2^13 points."""
LATERAL_BITS = 19
SLOT_MASK = (1 << SLOT_BITS) - 1


def sort_and_gap(features: Features, depth_unit: float, config: Config) -> np.ndarray:
    """Cluster points by gaps in depth and then sideways; the labels equal those of the reference.

    Points are sorted by depth and split at gaps; each set is sorted and split again sideways. Each
    sort key is one integer with the slot in its low bits, which NumPy sorts with vector
    instructions. The only loop is over frames.

    Args:
        features: Points ``(B, N)``.
        depth_unit: Metres in one depth unit.
        config: Configuration, of which the gaps and ``min_points`` of ``cluster`` are used.

    Returns:
        Labels ``(B, N)`` int32, numbered by nearest z, then smallest x.
    """
    depth_gap, lateral_gap = gap_units(config.cluster, depth_unit)
    labels = np.full(features.z.shape, -1, np.int32)
    for b, kept in enumerate(features.kept):
        z, x, least = features.z[b], features.x[b], config.cluster.min_points
        slot = np.flatnonzero(kept)
        if not len(slot):
            continue
        key = np.sort((z[slot].astype(np.uint32) << SLOT_BITS) | slot.astype(np.uint32))
        depth = (key >> SLOT_BITS).astype(np.intp)
        group, large = _runs(depth[1:] - depth[:-1] > depth_gap, least)
        slot, group = (key & SLOT_MASK)[large], group[large]
        if not len(slot):
            continue
        side = (group << LATERAL_BITS) | (x[slot] + MAX_LATERAL)
        key = np.sort((side << SLOT_BITS) | slot)
        slot, side, group = key & SLOT_MASK, key >> SLOT_BITS, key >> (SLOT_BITS + LATERAL_BITS)
        cuts = (side[1:] - side[:-1] > lateral_gap) | (group[1:] != group[:-1])
        run, large = _runs(cuts, least)
        labels[b, slot[large]] = _numbers(z[slot], x[slot], run, large)[large]
    return labels


def _runs(cuts: np.ndarray, min_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the run of each entry, and whether that run has more than ``min_points`` entries."""
    run = np.zeros(len(cuts) + 1, np.intp)
    np.cumsum(cuts, out=run[1:])
    return run, (np.bincount(run) > min_points)[run]


def _numbers(z: np.ndarray, x: np.ndarray, run: np.ndarray, large: np.ndarray) -> np.ndarray:
    """Return the number of each entry's run among the large ones, by nearest z, then smallest x."""
    starts = np.flatnonzero(np.concatenate([[True], run[1:] != run[:-1]]))
    nearest = np.minimum.reduceat(z, starts)
    order = np.lexsort((x[starts], nearest, ~large[starts]))
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order))
    return number[run]
