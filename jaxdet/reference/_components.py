"""Connected components of a graph."""

import numpy as np


def components(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Find the connected components of a graph, by propagation of the smallest label.

    Args:
        count: Number of nodes.
        first: First node of each link, ``(L,)`` integer.
        second: Second node of each link, ``(L,)`` integer.

    Returns:
        Smallest node of each node's component, ``(count,)`` int64.

    Example:
        >>> components(5, np.array([1, 4]), np.array([3, 3])).tolist()
        [0, 1, 2, 1, 1]
    """
    label = np.arange(count)
    while True:
        before = label.copy()
        ends = label[first], label[second]
        for end in ends:
            np.minimum.at(label, end, np.minimum(*ends))
        while (label != label[label]).any():
            label = label[label]
        if (label == before).all():
            return label
