"""The free floor of a batch in metres: columns of the result table, and its place in the world."""

from typing import Any, NamedTuple

import numpy as np

from jaxdet.types import FreeEnd, Scene

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


def free_floor(scene: Scene, depth_unit: float) -> FreeFloor:
    """The free floor of a batch in metres, each frame computed alone."""
    line = np.asarray(scene.free).astype(np.float64)
    x, y = np.ascontiguousarray(line[:, :, 1, 0]), np.ascontiguousarray(line[:, :, 1, 1])
    bearing = [np.arctan2(right, forward) for right, forward in zip(x, y, strict=True)]
    start, stop = np.moveaxis(np.sqrt(np.sum(line * line, axis=-1)) * depth_unit, -1, 0)
    seen = np.asarray((line != 0).any(axis=(2, 3)))
    return FreeFloor(seen, np.stack(bearing), start, stop, np.asarray(scene.free_end, np.int8))


def free_columns(free: FreeFloor, good: np.ndarray) -> dict[str, Any]:
    """Columns of ``frames.parquet``, null where ``good`` ``(n,)`` bool is False."""
    values = {
        "free_bearing_rad": free.bearing_rad.astype(np.float32),
        "free_from_m": free.from_m.astype(np.float32),
        "free_to_m": free.to_m.astype(np.float32),
        "free_end": free.end,
    }
    lists = {
        name: [a[i][free.seen[i]] if ok else None for i, ok in enumerate(good.tolist())]
        for name, a in values.items()
    }
    return lists | {"drop_m": np.where(good, free.drop_m[: good.size], np.nan).astype(np.float32)}


def no_free_columns(count: int) -> dict[str, Any]:
    """The same columns where no free floor is looked for."""
    lists = ("free_bearing_rad", "free_from_m", "free_to_m", "free_end")
    return {name: [None] * count for name in lists} | {"drop_m": np.full(count, np.nan)}
