"""Lists of different lengths in a column of a result table, as Arrow stores them."""

from typing import NamedTuple

import numpy as np


class Lists(NamedTuple):
    """R lists, one after the other."""

    values: np.ndarray
    """Values of all lists, ``(n,)``."""
    offsets: np.ndarray
    """First index in ``values`` of each list, and the end of the last one, ``(R + 1,)`` int32."""
    null: np.ndarray
    """Whether each list is null and has no values, ``(R,)`` bool."""

    @classmethod
    def of_lengths(cls, values: np.ndarray, length: np.ndarray, null: np.ndarray) -> "Lists":
        """Return lists of given lengths.

        Args:
            values: Values of all lists, ``(n,)``.
            length: Length of each list, ``(R,)`` integer; their sum is n, and nulls have 0.
            null: Whether each list is null, ``(R,)`` bool.
        """
        offsets = np.zeros(len(length) + 1, np.int32)
        np.cumsum(length, out=offsets[1:])
        return cls(values, offsets, null)

    @classmethod
    def nulls(cls, count: int) -> "Lists":
        """Return ``count`` nulls."""
        return cls(np.zeros(0), np.zeros(count + 1, np.int32), np.ones(count, bool))
