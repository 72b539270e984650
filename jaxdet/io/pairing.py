"""Which depth image belongs to which colour image."""

from typing import NamedTuple

import numpy as np


class Pairing(NamedTuple):
    """The partner of each frame, and the frames without one."""

    depth_of_color: np.ndarray
    """``(F,)`` int64, number of the depth frame of each colour frame, -1 = none."""
    unpaired_depth: np.ndarray
    """``(U,)`` int64, numbers of the depth frames that no colour frame has."""


def pair(color_ns: np.ndarray, depth_ns: np.ndarray, tolerance_s: float) -> Pairing:
    """Mutual nearest neighbours in time, at most ``tolerance_s`` apart, one to one.

    A colour stamp c and a depth stamp d pair when d is the depth stamp nearest to c, c is the
    colour stamp nearest to d, and ``|c - d| <= tolerance``; a tie goes to the earlier stamp.
    So the result doesn't depend on the tolerance beyond what it forbids, and no frame is used
    twice. Frames with one and the same stamp pair in order: first with first, second with
    second. What is left over stays unpaired, never paired with a second choice.

    Args:
        color_ns: ``(F,)`` int64, sorted colour stamps [ns].
        depth_ns: ``(G,)`` int64, sorted depth stamps [ns].
        tolerance_s: Greatest difference [s].
    """
    partner = np.full(len(color_ns), -1, np.int64)
    if len(color_ns) and len(depth_ns):
        color, color_first, color_count = _distinct(color_ns)
        depth, depth_first, depth_count = _distinct(depth_ns)
        to_depth, to_color = _nearest(color, depth), _nearest(depth, color)
        near = np.abs(color - depth[to_depth]) <= round(tolerance_s * 1e9)
        mutual = near & (to_color[to_depth] == np.arange(len(color)))
        groups = np.repeat(np.arange(len(color)), color_count)
        rank = np.arange(len(color_ns)) - color_first[groups]
        target = to_depth[groups]
        taken = mutual[groups] & (rank < depth_count[target])
        partner = np.where(taken, depth_first[target] + rank, -1)
    used = np.zeros(len(depth_ns), bool)
    used[partner[partner >= 0]] = True
    return Pairing(partner, np.flatnonzero(~used))


def _distinct(stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.unique(stamps, return_index=True, return_counts=True)


def _nearest(stamps: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Number of the nearest of ``others`` (sorted) for each of ``stamps``; ties: the earlier."""
    after = np.clip(np.searchsorted(others, stamps), 1, len(others) - 1) if len(others) > 1 else 0
    before = np.maximum(after - 1, 0)
    closer = np.abs(others[after] - stamps) < np.abs(stamps - others[before])
    return np.where(closer, after, before) + np.zeros(len(stamps), np.int64)
