"""The free floor of a batch in metres: columns of the result table, and its place in the world."""

from typing import Any, NamedTuple

import numpy as np

from jaxdet.results.lists import Lists
from jaxdet.types import Array, FreeEnd

DROP_COLUMNS = 3
"""So many neighbouring columns of cells must show a drop."""


class FreeFloor(NamedTuple):
    """By frame and column of cells, each ``(B, C)``; 0 where nothing is seen."""

    seen: np.ndarray
    """bool, the floor or an obstacle."""
    bearing_rad: np.ndarray
    """float64, of where it ends, clockwise from above, 0 ahead: ``arctan2(right, forward)``."""
    from_m: np.ndarray
    """float64, distance from the camera's foot on the floor to where the free floor begins [m]."""
    to_m: np.ndarray
    """float64, and to where it ends [m]; the same where only an obstacle is seen."""
    end: np.ndarray
    """int8, what ends it, see :class:`jaxdet.types.FreeEnd`."""

    @property
    def drop_m(self) -> np.ndarray:
        """``(B,)`` float64, distance of the nearest drop that ``DROP_COLUMNS`` columns show [m].

        The farthest of so many neighbouring columns that all end in a drop, and of these the
        nearest; NaN where there are none.
        """
        to = np.where(self.end == FreeEnd.DROP, self.to_m, np.inf)
        if to.shape[1] < DROP_COLUMNS:
            return np.full(len(to), np.nan)
        together = np.lib.stride_tricks.sliding_window_view(to, DROP_COLUMNS, axis=1).max(axis=-1)
        nearest = together.min(axis=1)
        return np.where(np.isfinite(nearest), nearest, np.nan)

    def fans(self) -> np.ndarray:
        """The free floor between neighbouring columns.

        Returns:
            ``(B, C - 1, 4, 2)`` float64, right and forward in the ground frame [m], free as far as
            both columns show it; NaN where they don't, as by a column in which nothing is seen.
        """
        start = np.maximum(self.from_m[:, :-1], self.from_m[:, 1:])
        stop = np.minimum(self.to_m[:, :-1], self.to_m[:, 1:])
        free = self.seen[:, :-1] & self.seen[:, 1:] & (start < stop)
        way = np.stack([np.sin(self.bearing_rad), np.cos(self.bearing_rad)], axis=-1)
        left, right = way[:, :-1], way[:, 1:]
        ends = [(left, start), (left, stop), (right, stop), (right, start)]
        fans = np.stack([side * length[..., None] for side, length in ends], axis=-2)
        return np.where(free[..., None, None], fans, np.nan)


def free_floor(free: Array, free_end: Array, depth_unit: float) -> FreeFloor:
    """The free floor of a batch in metres.

    Args:
        free: ``(B, C, 2, 2)`` int32 [depth units], of :class:`jaxdet.types.Scene`.
        free_end: ``(B, C)`` int32, of the same.
        depth_unit: Metres in one depth unit.
    """
    line = np.asarray(free)
    near, far = (_lengths(line[:, :, i]) * depth_unit for i in (0, 1))
    x, y = (line[:, :, 1, i].astype(np.float64) for i in (0, 1))
    seen = (line != 0).any(axis=(2, 3))
    return FreeFloor(seen, np.arctan2(x, y), near, far, np.asarray(free_end, np.int8))


def _lengths(points: np.ndarray) -> np.ndarray:
    """Of points ``(..., 2)`` from the origin, float64."""
    x, y = (points[..., i].astype(np.float64) for i in (0, 1))
    return np.sqrt(x * x + y * y)


def free_columns(free: FreeFloor, good: np.ndarray) -> dict[str, Any]:
    """Columns of ``frames.parquet``, null where ``good`` ``(n,)`` bool is False."""
    used = free.seen & good[:, None]
    length = used.sum(axis=1, dtype=np.int32)
    values = {
        "free_bearing_rad": free.bearing_rad.astype(np.float32),
        "free_from_m": free.from_m.astype(np.float32),
        "free_to_m": free.to_m.astype(np.float32),
        "free_end": free.end,
    }
    columns: dict[str, Any] = {
        k: Lists.of_lengths(a[used], length, ~good) for k, a in values.items()
    }
    return columns | {"drop_m": np.where(good, free.drop_m, np.nan).astype(np.float32)}


def no_free_columns(count: int) -> dict[str, Any]:
    """The same columns where no free floor is looked for."""
    names = ("free_bearing_rad", "free_from_m", "free_to_m", "free_end")
    return {name: Lists.nulls(count) for name in names} | {"drop_m": np.full(count, np.nan)}
