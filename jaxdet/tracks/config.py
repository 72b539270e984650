"""Tracking parameters."""

import math
from dataclasses import dataclass

from jaxdet.arguments import check_fields
from jaxdet.config import FARTHEST_M
from jaxdet.errors import ConfigError


@dataclass(frozen=True)
class TrackConfig:
    """Data association, and the classification of tracks as moving or stationary."""

    max_speed_mps: float = 3.0
    """Maximum speed of an object [m/s]; tracks that seem faster count as stationary."""
    gate_m: float = 0.3
    """Distance by which an outline's displacement between two frames may exceed the distance
    covered at maximum speed [m], for the outlines to be linked."""
    max_gap_frames: int = 3
    """Maximum difference between the frame numbers of two observations that are linked by the
    motion of their edges only."""
    max_gap_s: float = 2.5
    """Maximum time without an observation before a track ends [s]."""
    overlap: float = 0.4
    """Minimum overlap at which obstacles of a frame are merged, as a fraction of the smaller
    outline along every side. Long obstacles are not merged."""
    floats_m: float = 0.25
    """Minimum height above the floor of a floating obstacle [m], which is merged with a larger one
    that it touches."""
    touch_m: float = 0.1
    """Maximum gap between outlines that touch [m]."""
    long_m: float = 1.6
    """Minimum length of long objects [m], such as walls, hedges or shelves, in front of which
    others may stand."""
    min_frames: int = 4
    """Minimum number of frames in which a track is observed."""
    moving_m: float = 0.3
    """Minimum displacement of a moving object's centre [m]; its ends must move by at least half of
    this distance."""
    noise_m: float = 0.25
    """Maximum RMS residual of the ends of a moving long object [m]."""
    smooth_s: float = 0.7
    """Half-width of the time window over which positions and speeds are fitted [s]."""
    most_floor: float = 0.3
    """Maximum fraction of frames that show floor at an obstacle's place (floor_seen); above it the
    obstacle is not drawn on maps."""

    def __post_init__(self) -> None:
        check_fields(self)
        rules = {
            "max-speed-mps": self.max_speed_mps > 0,
            "gate-m": self.gate_m > 0,
            "max-gap-frames": self.max_gap_frames >= 1,
            "max-gap-s": self.max_gap_s > 0,
            "overlap": 0 < self.overlap <= 1,
            "floats-m": self.floats_m >= 0,
            "touch-m": self.touch_m >= 0,
            "long-m": self.long_m > 0,
            "min-frames": self.min_frames >= 1,
            "moving-m": self.moving_m > 0,
            "noise-m": self.noise_m > 0,
            "smooth-s": self.smooth_s > 0,
            "most-floor": 0 <= self.most_floor <= 1,
        }
        for name, kept in rules.items():
            most = FARTHEST_M if name.endswith("-m") else math.inf
            if not (kept and getattr(self, name.replace("-", "_")) < most):
                raise ConfigError(f"{name} is out of range", remedy="see jaxdet track --help")
