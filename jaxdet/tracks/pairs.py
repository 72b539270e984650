"""Pairs of rows: whose frames are so far apart, which of them choose each other, chains.

Rows are sorted by frame. All of it is array code over the pairs of many frames at once.
"""

import numpy as np


def pairs_of_frames(frame: np.ndarray, later: np.ndarray, apart: int) -> tuple[np.ndarray, ...]:
    """Each of the rows ``later`` with all rows of the frame ``apart`` frames before.

    Args:
        frame: ``(N,)`` int64, ascending.
        later: ``(L,)`` rows.
        apart: 1 or more.

    Returns:
        The earlier and the later row of each pair, ``(P,)`` each, by the later row, then the
        earlier one.
    """
    wanted = frame[later] - apart
    first = np.searchsorted(frame, wanted, "left")
    count = np.searchsorted(frame, wanted, "right") - first
    return ranges(first, count), np.repeat(later, count)


def pairs_in_frames(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each two rows of a frame, ``(P,)`` each, the earlier first."""
    row = np.arange(len(frame))
    count = np.searchsorted(frame, frame, "right") - row - 1
    return np.repeat(row, count), ranges(row + 1, count)


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """``first[0], first[0] + 1, ...``: ``count[0]`` numbers, then those of ``first[1]``, ..."""
    start = np.cumsum(count) - count
    return np.arange(int(count.sum())) - np.repeat(start, count) + np.repeat(first, count)


def choose(a: np.ndarray, b: np.ndarray, cost: np.ndarray, size: int) -> np.ndarray:
    """One-to-one pairs, the cheapest first, as if they were taken one by one in order of cost.

    Pairs that are the cheapest of both of their rows are taken at once, until none is left; so a
    frame's choice does not depend on the frames that are worked on together with it.

    Args:
        a: ``(P,)`` rows.
        b: ``(P,)`` rows.
        cost: ``(P,)`` float64; of equal ones the pair with the smaller rows.
        size: Rows are less.

    Returns:
        Numbers of the pairs taken, ascending.
    """
    order = np.lexsort((b, a, cost))
    a, b, taken = a[order], b[order], []
    left = np.arange(len(order))
    while len(left):
        # Assigned from the last to the first, so that the cheapest stays.
        best_a, best_b = np.empty(size, np.int64), np.empty(size, np.int64)
        best_a[a[left][::-1]], best_b[b[left][::-1]] = left[::-1], left[::-1]
        mutual = left[(best_a[a[left]] == left) & (best_b[b[left]] == left)]
        taken.append(mutual)
        used_a, used_b = np.zeros(size, bool), np.zeros(size, bool)
        used_a[a[mutual]], used_b[b[mutual]] = True, True
        left = left[~used_a[a[left]] & ~used_b[b[left]]]
    return np.sort(order[np.concatenate(taken)]) if taken else left


def components(size: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``(size,)`` int64, the smallest row that hangs together with each through pairs."""
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
    """``(N,)`` int64, the first row of each row's chain; ``before`` is the row before, or -1."""
    root = np.where(before < 0, np.arange(len(before)), before)
    while True:
        further = root[root]
        if (further == root).all():
            return root
        root = further
