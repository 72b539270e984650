"""Configuration: one frozen dataclass for each stage but align, which has no free parameters.

Every field is a command-line flag (``--cluster.depth-gap-m``) and a TOML key
(``[cluster] depth_gap_m``). All are hashable, so JAX can take them as static arguments.
"""

import math
from dataclasses import dataclass, field

from jaxdet.errors import ConfigError

MAX_POINTS = 8192
"""Most points of a frame, corners and grid together: what the 32-bit keys and sums hold."""

REACH = 20
"""A surface behind a nearer thing is looked for so many pixels of the grid to the left."""

TRIM_SHARE = 16
"""At most this part of an obstacle's points is passed over at each side, and in front."""

STAGES = ("align", "ground", "features", "cluster", "footprint")
"""The names of the stages, in order; one name for a stage everywhere."""


FARTHEST_M = 1000.0
"""Largest length in a configuration [m]: what 32-bit integers of depth units hold."""


def _require(condition: bool, field_name: str, rule: str) -> None:
    if not condition:
        raise ConfigError(f"{field_name} must be {rule}", remedy=f"see --{field_name} in --help")


def _require_within(value: float, low: float, high: float, field_name: str) -> None:
    _require(low <= value <= high, field_name, f"from {low:g} to {high:g}")


@dataclass(frozen=True)
class GroundConfig:
    """Range and floor (Section 3.3, Eq. 5)."""

    min_depth_m: float = 0.15
    """Nearest depth used [m]."""
    max_depth_m: float = 4.0
    """Farthest depth used [m]."""
    step_height_m: float = 0.05
    """What the wheels can climb [m]: lower points are floor."""
    step_height_per_m: float = 0.003
    """Added to the step height for each metre of depth: how well the floor's tilt is known
    (0.003 is 0.2 degrees; the robot rocks, floors are not flat). The paper's is 0."""
    camera_height_m: float | None = None
    """Optical centre above the floor [m]; unset: from the log's TF, else estimated."""
    camera_pitch_rad: float = 0.0
    """Downward tilt [rad], used with camera_height_m."""
    camera_roll_rad: float = 0.0
    """Clockwise roll seen from behind the camera [rad], used with camera_height_m."""
    source: str = "auto"
    """Where the plane comes from: auto (flags, then tf, then estimate), flags, tf, estimate,
    none."""
    sample_frames: int = 24
    """Frames the estimate looks at, evenly spaced over the log or the window."""
    window_s: float = 0.0
    """Length of the fixed time windows with an estimate each [s]: of the plane where it is not
    known, and of a ramp ahead. 0: one plane for the log, and no ramps."""

    def __post_init__(self) -> None:
        _require(0 <= self.min_depth_m < self.max_depth_m, "ground.min-depth-m", "in [0, max)")
        _require(self.max_depth_m <= 65.535, "ground.max-depth-m", "at most 65.535 m")
        _require(self.step_height_m >= 0, "ground.step-height-m", "at least 0")
        _require(0 <= self.step_height_per_m < 1, "ground.step-height-per-m", "in [0, 1)")
        _require(
            self.camera_height_m is None or 0 < self.camera_height_m < 20,
            "ground.camera-height-m",
            "between 0 and 20 m",
        )
        sources = ("auto", "flags", "tf", "estimate", "none")
        _require(self.source in sources, "ground.source", "one of " + ", ".join(sources))
        _require(
            self.source != "flags" or self.camera_height_m is not None,
            "ground.camera-height-m",
            "given with --ground.source flags",
        )
        _require(self.sample_frames >= 1, "ground.sample-frames", "at least 1")
        _require(self.window_s >= 0, "ground.window-s", "at least 0")


@dataclass(frozen=True)
class FeaturesConfig:
    """Canny, then Shi-Tomasi on the edge image (Section 3.2)."""

    canny_low: float = 50.0
    """Lower hysteresis bound [grey levels of the L1 gradient]."""
    canny_high: float = 100.0
    """Upper hysteresis bound [grey levels of the L1 gradient]."""
    max_corners: int = 1024
    """Feature slots N: the strongest corners that are used."""
    quality_level: float = 0.01
    """Weakest corner used, as a share of the strongest one's minimum eigenvalue."""
    min_distance: float = 3.0
    """Least distance between two corners [pixel]; below 1: none."""
    grid_columns: int = 80
    """Columns of a regular grid whose kept pixels are points too, with square meshes, so that
    surfaces without corners (plain, dim) are seen by their depth. 0: corners only."""
    use_mask: bool = True
    """Take corners only where the ground stage keeps the pixel; off: drop points afterwards."""

    def __post_init__(self) -> None:
        _require(1 <= self.max_corners <= 8192, "features.max-corners", "from 1 to 8192")
        _require(0 < self.quality_level <= 1, "features.quality-level", "in (0, 1]")
        _require_within(self.min_distance, 0, MAX_POINTS, "features.min-distance")
        _require(0 <= self.grid_columns <= 320, "features.grid-columns", "from 0 to 320")

    @property
    def canny_bounds(self) -> tuple[int, int]:
        """Canny's bounds in whole grey levels, the lower first, from -1 to 2047.

        The L1 gradient of a 3x3 Sobel is from 0 to 2040, so bounds farther out mean the same.
        """
        low, high = sorted((self.canny_low, self.canny_high))
        return math.floor(min(max(low, -1), 2047)), math.floor(min(max(high, -1), 2047))


@dataclass(frozen=True)
class ClusterConfig:
    """Gaps in depth, then sideways (Section 3.4, Eq. 6), or slice by slice."""

    depth_gap_m: float = 0.10
    """d_z [m]: a larger gap between neighbours in depth starts a new set."""
    lateral_gap_m: float = 0.15
    """d_x [m]: a larger sideways gap starts a new set. The paper's is the robot's width, 0.40."""
    min_points: int = 18
    """N: sets of this many points or fewer are dropped. The paper's is 10."""
    slice_m: float = 0.15
    """Sideways gaps are looked for in slices of this depth [m], cut twice, half a slice apart;
    sets that share a point are one. What stands at the same depth far away, or to the same side
    farther back, then joins nothing. 0: the paper's order, all depths first and then sideways."""
    occluder_m: float = 1.0
    """With slices: surfaces in a row of the grid on both sides of a nearer thing, at most this far
    apart [m], are one when their depths are within d_z. 0: off."""
    occluder_slope: float = 0.25
    """d_z grows by so much for each metre between two such surfaces: they are seen obliquely."""
    max_holes: int = 2
    """With slices: so many pixels of the grid without depth may lie between such surfaces."""
    surface_height_m: float = 0.65
    """With slices: surfaces at least so high stand on their own: they are never one because of
    what is near them sideways. A surface is pixels of the grid whose depths go on to the next
    column or row, or behind a nearer thing. 0: off."""
    surface_gap_m: float = 0.03
    """Largest step in depth between neighbouring pixels of a surface [m]."""
    surface_gap_per_m: float = 0.011
    """Added to it in proportion to z squared [1/m], as stereo noise grows: some four standard
    deviations of a D435's depth."""

    def __post_init__(self) -> None:
        _require_within(self.depth_gap_m, 0, FARTHEST_M, "cluster.depth-gap-m")
        _require_within(self.lateral_gap_m, 0, FARTHEST_M, "cluster.lateral-gap-m")
        _require_within(self.min_points, 0, MAX_POINTS, "cluster.min-points")
        _require_within(self.slice_m, 0, FARTHEST_M, "cluster.slice-m")
        _require_within(self.occluder_m, 0, FARTHEST_M, "cluster.occluder-m")
        _require_within(self.occluder_slope, 0, 2, "cluster.occluder-slope")
        _require_within(self.max_holes, 0, REACH, "cluster.max-holes")
        _require_within(self.surface_height_m, 0, FARTHEST_M, "cluster.surface-height-m")
        _require_within(self.surface_gap_m, 0, FARTHEST_M, "cluster.surface-gap-m")
        _require_within(self.surface_gap_per_m, 0, FARTHEST_M, "cluster.surface-gap-per-m")


@dataclass(frozen=True)
class FootprintConfig:
    """Outline on the floor (Section 3.5, Eq. 7-9)."""

    vertex_threshold_m: float = 0.03
    """d_threshold of Eq. 7 [m], about the sensor's error: C must be this much nearer than A
    and B to count as a vertex."""
    trim: int = 2
    """So many of the outermost points of each side, and of the nearest ones, are outliers that
    don't make A, B or C, at most a sixteenth of the obstacle's points. The rectangle still covers
    them. The paper's is 0."""
    side_band_per_m: float = 0.006
    """A and B are the median of the points at most this far inside of the outermost [m], for each
    metre of distance: a silhouette is smeared over about three pixels. The paper's is 0."""
    near_band_per_m2: float = 0.012
    """C is the median of the points at most this far behind the nearest [m], times the distance
    squared [1/m]: of many noisy points the nearest is too near, and stereo noise grows so; 0.012
    is some four standard deviations of a D435's. The paper's is 0."""
    extension_m: float = 0.20
    """How far the edge AB is extended backward when there is no vertex [m]."""
    cover: bool = True
    """Widen the rectangle along and across AB until all of the obstacle's points are inside; off:
    the paper's, which leaves out what stands beyond A, B or C."""
    margin_m: float = 0.03
    """Added to the rectangle on all sides [m]."""

    def __post_init__(self) -> None:
        _require_within(self.vertex_threshold_m, 0, FARTHEST_M, "footprint.vertex-threshold-m")
        _require_within(self.trim, 0, MAX_POINTS, "footprint.trim")
        _require_within(self.side_band_per_m, 0, FARTHEST_M, "footprint.side-band-per-m")
        _require_within(self.near_band_per_m2, 0, FARTHEST_M, "footprint.near-band-per-m2")
        _require(0 < self.extension_m <= FARTHEST_M, "footprint.extension-m", "above 0, to 1000 m")
        _require_within(self.margin_m, 0, FARTHEST_M, "footprint.margin-m")


@dataclass(frozen=True)
class Config:
    """The whole method."""

    ground: GroundConfig = field(default_factory=GroundConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    footprint: FootprintConfig = field(default_factory=FootprintConfig)
