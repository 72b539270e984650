"""Connected components of a graph, written out."""

import numpy as np


def components(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The connected components of a graph, by propagation of the smallest label.

    Args:
        count: Nodes.
        first: ``(L,)`` integer, one end of each link.
        second: ``(L,)`` integer, the other.

    Returns:
        ``(count,)`` int64, the smallest node of each node's component.

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
