"""Free floor of a batch of frames, along rays in metres, and as polygons in the world frame."""

from functools import lru_cache, reduce
from typing import NamedTuple

import numpy as np

from jaxdet.elementary import sin_cos
from jaxdet.results.metric import world_angle
from jaxdet.types import RAYS, Array, FreeEnd

RAY_RAD = 2 * np.pi / RAYS
"""Angle between neighbouring rays [rad]."""
DROP_RAYS = 5
"""Number of neighbouring rays that must show a drop; they cover about three columns of cells."""


class Polygons(NamedTuple):
    """Areas of the floor, each a polygon in the world frame."""

    points: np.ndarray
    """World X and Y of all corners, polygon after polygon, ``(P, 2)`` float64 [m]."""
    corners: np.ndarray
    """Number of corners of each polygon, ``(Q,)`` integer."""
    frame: np.ndarray
    """Index of the frame that each polygon belongs to, ascending, ``(Q,)`` integer."""


class FreeFloor(NamedTuple):
    """Free floor per frame and ray, arrays ``(B, N)``; distances are 0 if a ray shows nothing."""

    seen: np.ndarray
    """Whether the ray shows the floor or an obstacle, bool."""
    way: np.ndarray
    """Unit vector along the ray, complex128: right, and forward times 1j."""
    bearing_rad: np.ndarray
    """Bearing of the ray, float64 [rad], clockwise from above, 0 is ahead."""
    from_m: np.ndarray
    """Distance from the camera's ground projection to the start of the free floor, float64 [m]."""
    to_m: np.ndarray
    """Distance to the end of the free floor, float64 [m]; ``from_m`` if the ray shows no floor."""
    end: np.ndarray
    """Cause of the end, int8, see :class:`jaxdet.types.FreeEnd`."""

    @property
    def drop_m(self) -> np.ndarray:
        """Distance of the nearest drop that ``DROP_RAYS`` rays show, ``(B,)`` float64 [m].

        A drop counts if that many neighbouring rays all end in it; its distance is the largest
        distance along these rays. The value is NaN without a drop.
        """
        to = np.where(self.end == FreeEnd.DROP, self.to_m, np.inf)
        last = to.shape[1] - DROP_RAYS + 1
        if last < 1:
            return np.full(len(to), np.nan)
        together = reduce(np.maximum, (to[:, i : i + last] for i in range(DROP_RAYS)))
        nearest = together.min(axis=1)
        return np.where(np.isfinite(nearest), nearest, np.nan)

    def in_world(self, T_world_camera: np.ndarray) -> Polygons:
        """Return the free floor between neighbouring rays as polygons in the world.

        Between two rays the floor is free as far as both rays show it. A polygon spans as many
        neighbouring rays as possible; it ends at a ray without free floor. A frame whose pose is
        unknown has no polygons.

        Args:
            T_world_camera: Poses of the camera, ``(B, 4, 4)`` float64, NaN if unknown.
        """
        sin, cos = world_angle(T_world_camera)
        sin, cos = sin[:, None], cos[:, None]
        right, ahead = np.real(self.way), np.imag(self.way)
        way, origin = np.empty(self.way.shape, np.complex128), np.empty(len(sin), np.complex128)
        way.real, way.imag = right * cos + ahead * sin, ahead * cos - right * sin
        origin.real, origin.imag = T_world_camera[:, 0, 3], T_world_camera[:, 1, 3]
        start = np.maximum(self.from_m[:, :-1], self.from_m[:, 1:])
        stop = np.minimum(self.to_m[:, :-1], self.to_m[:, 1:])
        free = self.seen[:, :-1] & self.seen[:, 1:] & (start < stop)
        free &= np.isfinite(origin)[:, None] & np.isfinite(sin)
        parts = free.sum(axis=1, dtype=np.int64)
        frame = np.repeat(np.arange(len(parts)), parts)
        column = np.flatnonzero(free) + frame  # index of the left ray, counted over all frames
        left, right = way.ravel()[column], way.ravel()[column + 1]
        start, stop = start[free], stop[free]

        # Polygons go along the far edge to the right and along the near one back.
        first = np.flatnonzero(np.diff(column, prepend=-2) != 1)
        length = np.diff(first, append=column.size)
        turn = np.repeat(2 * (first + first + length), length)
        far = 2 * (np.arange(column.size) + np.repeat(first, length))
        near = 2 * turn - far
        points = np.empty(4 * column.size, np.complex128)
        points[far], points[far + 1] = _scaled(left, stop), _scaled(right, stop)
        points[near - 1], points[near - 2] = _scaled(left, start), _scaled(right, start)
        points += np.repeat(origin, 4 * parts)
        return Polygons(points.view(np.float64).reshape(-1, 2), 4 * length, frame[first])


def _scaled(way: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Multiply complex by real numbers ``(n,)``; the bits of NumPy's product depend on the CPU."""
    return (way.view(np.float64).reshape(-1, 2) * length[:, None]).view(np.complex128).ravel()


def free_floor(free: Array, free_end: Array, depth_unit: float) -> FreeFloor:
    """Return the free floor of a batch in metres, from the first to the last ray that frames show.

    Args:
        free: Start and end along each ray, ``(B, RAYS, 2)`` int32 [depth units], see
            :class:`jaxdet.types.Scene`.
        free_end: Causes of the ends, ``(B, RAYS)`` int32, of the same scene.
        depth_unit: Metres in one depth unit.
    """
    start, stop = np.moveaxis(np.asarray(free), 2, 0)
    used = np.flatnonzero((stop > 0).any(axis=0))
    view = slice(used[0], used[-1] + 1) if used.size else slice(0)
    start, stop, end = start[:, view], stop[:, view], np.asarray(free_end)[:, view]
    bearing, way = (np.broadcast_to(table[view], stop.shape) for table in ray_bearings())
    metres = start * depth_unit, stop * depth_unit
    return FreeFloor(stop > 0, way, bearing, *metres, end.astype(np.int8))


@lru_cache(maxsize=1)
def ray_bearings() -> tuple[np.ndarray, np.ndarray]:
    """Return the bearings of the rays, ``(RAYS,)`` float64 [rad], and unit vectors along them."""
    bearing = (np.arange(RAYS) - RAYS // 2) * RAY_RAD
    way = np.empty(RAYS, np.complex128)
    way.real, way.imag = sin_cos(bearing)
    for table in (bearing, way):
        table.setflags(write=False)
    return bearing, way
