"""What links obstacles to tracks."""

import math
from dataclasses import dataclass

from jaxdet.arguments import check_fields
from jaxdet.config import FARTHEST_M
from jaxdet.errors import ConfigError


@dataclass(frozen=True)
class TrackConfig:
    """When obstacles of different frames are one thing, and when that moves."""

    max_speed_mps: float = 3.0
    """Nothing moves faster [m/s]; a track that seems to stands."""
    gate_m: float = 0.3
    """So much more may the nearest edges of an outline move between frames [m]."""
    max_gap_frames: int = 3
    """Outlines this many frames apart are linked by their edges alone."""
    max_gap_s: float = 2.5
    """A thing that was not seen for longer begins a new track [s]."""
    overlap: float = 0.4
    """Outlines of a frame that overlap by this share of the smaller, along every side, are one
    thing, unless it is a long one."""
    floats_m: float = 0.25
    """What begins higher above the floor and touches a larger thing is a part of it [m]."""
    touch_m: float = 0.1
    """Outlines that are nearer to each other than this touch [m]."""
    long_m: float = 1.6
    """Things longer than this are walls, hedges or shelves, before which others stand [m]."""
    min_frames: int = 4
    """A track is seen in at least so many frames."""
    moving_m: float = 0.3
    """A thing moves if its middle leaves its place by more, and both of its ends by half of it
    [m]."""
    noise_m: float = 0.25
    """A long thing whose ends jump about their way by more, root mean square, stands [m]."""
    smooth_s: float = 0.7
    """Positions and speeds are fitted over so much time before and after a frame [s]."""

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
        }
        for name, kept in rules.items():
            most = FARTHEST_M if name.endswith("-m") else math.inf
            if not (kept and getattr(self, name.replace("-", "_")) < most):
                raise ConfigError(f"{name} is out of its range", remedy="see jaxdet track --help")
