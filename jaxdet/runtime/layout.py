"""Named arrays packed into rows of 32-bit words: one row per frame, or one row for all frames."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxdet.types import Array

Shapes = Mapping[str, tuple[int, ...]]
LINE = 16
"""Number of words per cache line; each array begins at a multiple of it."""


class Layout:
    """Offsets of named arrays in a row.

    Arrays of bool have one byte per element, and other arrays have one word.

    Args:
        shapes: Shapes of the arrays without the axis of rows, in the order in which the arrays are
            listed in C++.
        bools: Names of bool arrays; all other arrays have 32-bit elements.
    """

    def __init__(self, shapes: Shapes, bools: frozenset[str] = frozenset()) -> None:
        self.shapes, self.bools = dict(shapes), bools
        self.begin: dict[str, int] = {}
        """Offset of each array in a row."""
        self.words = 0
        """Number of words per row, at least ``LINE``."""
        for name, shape in self.shapes.items():
            self.begin[name] = self.words
            self.words += -(-self._length(name, shape) // LINE) * LINE
        self.words = max(self.words, LINE)

    def _length(self, name: str, shape: tuple[int, ...]) -> int:
        return -(-math.prod(shape) // 4) if name in self.bools else math.prod(shape)

    def take(self, rows: Any, name: str) -> Any:
        """Return an array ``(B, ...)`` of rows ``(B, words)`` int32, also under ``jax.jit``."""
        shape, first = self.shapes[name], self.begin[name]
        words = rows[:, first : first + self._length(name, shape)]
        if name in self.bools:
            octets = _octets(words)
            words = octets.reshape(len(rows), -1)[:, : math.prod(shape)] != 0
        return words.reshape(len(rows), *shape)

    def pack(self, batch: int, arrays: Mapping[str, Array], fill: int = 0) -> np.ndarray:
        """Pack arrays ``(B, ...)`` into rows ``(B, words)`` int32; all other words are ``fill``."""
        rows = np.full((batch, self.words), fill, np.int32)
        for name, array in arrays.items():
            flat = np.ascontiguousarray(array).reshape(batch, -1)
            octets = flat.astype(np.uint8) if name in self.bools else flat.view(np.uint8)
            first = 4 * self.begin[name]
            rows.view(np.uint8)[:, first : first + octets.shape[1]] = octets
        return rows


def _octets(words: Any) -> Any:
    """Return 32-bit words as bytes; JAX is only imported if the words are a JAX array."""
    if isinstance(words, np.ndarray):
        return np.ascontiguousarray(words).view(np.uint8)
    import jax

    return jax.lax.bitcast_convert_type(words, np.uint8)
