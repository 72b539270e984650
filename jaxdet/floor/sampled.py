"""One floor for all frames of a camera, from the floors that a sample of them shows."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import median
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.types import GroundPlane

ENOUGH = 3
"""So many sampled frames must show their floor, or all where there are fewer."""
AGREEING = 0.9
"""A camera keeps its place on the robot where this share of the floors is near the median."""
NEAR_M, NEAR_RAD = 0.03, float(np.radians(2.0))
"""How near: height, and pitch and roll."""


class SampledFloor(NamedTuple):
    """What the floors of a sample say together."""

    plane: GroundPlane
    """``B = 1``, the median of height, pitch and roll; not valid where too few show a floor."""
    decided: int
    """Frames whose own depth showed the floor."""
    looked_at: int
    height_spread_m: float
    """The ``AGREEING`` quantile of the distances from the median [m]; NaN without a floor."""
    angle_spread_rad: float
    """The same of the larger of the two angles."""

    @property
    def agrees(self) -> bool:
        """Whether the camera keeps its place."""
        near = self.height_spread_m <= NEAR_M and self.angle_spread_rad <= NEAR_RAD
        return bool(self.plane.valid[0]) and near


def sampled_floor(planes: GroundPlane, own: np.ndarray) -> SampledFloor:
    """The median of the floors that frames show themselves.

    Args:
        planes: ``B`` planes; their ramps are left out.
        own: ``(B,)`` bool, the frame's own depth decided.

    Example:
        >>> tilts, level = np.radians([10.0, 11.0, 30.0, 10.0]), np.zeros(4)
        >>> seen = flat_plane(np.array([0.3, 0.31, 0.5, 0.3]), tilts, level)
        >>> found = sampled_floor(seen, np.array([True, True, False, True]))
        >>> found.plane.height.tolist(), found.decided, found.agrees
        ([0.3], 3, True)
    """
    decided = int(np.count_nonzero(own))
    if decided < min(ENOUGH, len(own)) or not decided:
        nothing = float("nan")
        return SampledFloor(unknown_plane(1), decided, len(own), nothing, nothing)
    values = np.stack([planes.height, planes.pitch, planes.roll])[:, own]
    middle = median(values, axis=1)
    off = np.abs(values - middle[:, None])
    height, angle = (_quantile(a) for a in (off[0], off[1:].max(axis=0)))
    return SampledFloor(flat_plane(*middle[:, None]), decided, len(own), height, angle)


def _quantile(values: np.ndarray) -> float:
    """The smallest value that ``AGREEING`` of them don't exceed."""
    return float(np.quantile(values, AGREEING, method="inverted_cdf"))
