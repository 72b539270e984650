"""Lists of any length in a column of a result table, as Arrow holds them."""

from typing import NamedTuple

import numpy as np


class Lists(NamedTuple):
    """R lists one after the other."""

    values: np.ndarray
    """``(n,)``, of all lists."""
    offsets: np.ndarray
    """``(R + 1,)`` int32, where each begins in ``values``, and where the last ends."""
    null: np.ndarray
    """``(R,)`` bool, there is none; such have no values."""

    @classmethod
    def of_lengths(cls, values: np.ndarray, length: np.ndarray, null: np.ndarray) -> "Lists":
        """Lists of known lengths.

        Args:
            values: ``(n,)``, of all lists.
            length: ``(R,)`` integer, of each; their sum is n, and of nulls it is 0.
            null: ``(R,)`` bool, there is none.
        """
        offsets = np.zeros(len(length) + 1, np.int32)
        np.cumsum(length, out=offsets[1:])
        return cls(values, offsets, null)

    @classmethod
    def nulls(cls, count: int) -> "Lists":
        """``count`` rows without a list."""
        return cls(np.zeros(0), np.zeros(count + 1, np.int32), np.ones(count, bool))
