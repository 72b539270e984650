"""Median floor of a camera from a sample of its frames."""

from typing import NamedTuple

import numpy as np

from jaxdet.elementary import median
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.types import GroundPlane

ENOUGH = 3
"""Minimum number of sampled frames whose own floor was found; if fewer are sampled, all of them."""
AGREEING = 0.9
"""Minimum fraction of floors that are near the median if the camera is fixed to the robot."""
NEAR_M, NEAR_RAD = 0.03, float(np.radians(2.0))
"""Maximum deviation from the median in height [m], and in pitch and roll [rad]."""


class SampledFloor(NamedTuple):
    """Median floor of a sample, and its spread."""

    plane: GroundPlane
    """Median height, pitch and roll, ``B = 1``; not valid if too few frames show a floor."""
    decided: int
    """Number of frames whose own floor was found."""
    looked_at: int
    """Number of sampled frames."""
    height_spread_m: float
    """``AGREEING`` quantile of the deviation from the median height [m]; NaN without a floor."""
    angle_spread_rad: float
    """``AGREEING`` quantile of the larger deviation in pitch or roll [rad]; NaN without a floor."""

    @property
    def agrees(self) -> bool:
        """Whether the floors agree, that is, whether the camera has a fixed pose on the robot."""
        near = self.height_spread_m <= NEAR_M and self.angle_spread_rad <= NEAR_RAD
        return bool(self.plane.valid[0]) and near

    def shown_by(self, share: float) -> bool:
        """Return whether the floors agree, and a sufficient fraction of the frames shows one."""
        return self.agrees and self.decided >= max(ENOUGH, share * self.looked_at)


def sampled_floor(planes: GroundPlane, own: np.ndarray) -> SampledFloor:
    """Compute the median of the floors found in frames.

    Args:
        planes: ``B`` planes, whose ramps are ignored.
        own: Whether the frame's own depth determined its plane, ``(B,)`` bool.

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
    """Return the ``AGREEING`` quantile, without interpolation."""
    return float(np.quantile(values, AGREEING, method="inverted_cdf"))
