"""Pairs of rows by frame, greedy matching, connected components and chains.

Rows are sorted by frame. The functions are vectorised over the pairs of many frames.
"""

import numpy as np


def pairs_of_frames(frame: np.ndarray, later: np.ndarray, apart: int) -> tuple[np.ndarray, ...]:
    """Pair the rows ``later`` with all rows ``apart`` frames before.

    Args:
        frame: Frame of each row, ``(N,)`` int64, ascending.
        later: Rows ``(L,)``.
        apart: Number of frames; 0 pairs rows of the same frame.

    Returns:
        Earlier and later row of each pair, ``(P,)`` each, sorted by the later row, then the
        earlier one.
    """
    wanted = frame[later] - apart
    first = np.searchsorted(frame, wanted, "left")
    count = np.searchsorted(frame, wanted, "right") - first
    return ranges(first, count), np.repeat(later, count)


def pairs_in_frames(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all pairs of rows of the same frame, ``(P,)`` each, the earlier row first."""
    row = np.arange(len(frame))
    count = np.searchsorted(frame, frame, "right") - row - 1
    return np.repeat(row, count), ranges(row + 1, count)


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Concatenate the ranges of ``count[i]`` integers from ``first[i]`` on."""
    start = np.cumsum(count) - count
    return np.arange(int(count.sum())) - np.repeat(start, count) + np.repeat(first, count)


def greedy_matching(a: np.ndarray, b: np.ndarray, cost: np.ndarray, size: int) -> np.ndarray:
    """Match rows one to one, greedily in order of cost.

    Each round takes all pairs that are the cheapest for both of their rows. The result is the same
    as with one pair at a time, so it does not depend on other frames in the arrays.

    Args:
        a: Rows ``(P,)``.
        b: Rows ``(P,)``.
        cost: Costs ``(P,)`` float64; the pair with the smaller rows wins a tie.
        size: Number of rows.

    Returns:
        Indices of the matched pairs, ascending.
    """
    order = np.lexsort((b, a, cost))
    a, b, taken = a[order], b[order], []
    left = np.arange(len(order))
    while len(left):
        # Assign in reverse order, so that the cheapest pair remains.
        best_a, best_b = np.empty(size, np.int64), np.empty(size, np.int64)
        best_a[a[left][::-1]], best_b[b[left][::-1]] = left[::-1], left[::-1]
        mutual = left[(best_a[a[left]] == left) & (best_b[b[left]] == left)]
        taken.append(mutual)
        used_a, used_b = np.zeros(size, bool), np.zeros(size, bool)
        used_a[a[mutual]], used_b[b[mutual]] = True, True
        left = left[~used_a[a[left]] & ~used_b[b[left]]]
    return np.sort(order[np.concatenate(taken)]) if taken else left


def components(size: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest row in the connected component of each row, ``(size,)`` int64.

    Rows ``a[i]`` and ``b[i]`` are connected.
    """
    root = np.arange(size)
    while True:
        low = np.minimum(root[a], root[b])
        new = root.copy()
        np.minimum.at(new, a, low)
        np.minimum.at(new, b, low)
        new = new[new]
        if (new == root).all():
            return root
        root = new


def chain_starts(before: np.ndarray) -> np.ndarray:
    """Return the first row of each row's chain, ``(N,)`` int64.

    ``before`` has the previous row in the chain, -1 if there is none.
    """
    root = np.where(before < 0, np.arange(len(before)), before)
    while True:
        further = root[root]
        if (further == root).all():
            return root
        root = further
