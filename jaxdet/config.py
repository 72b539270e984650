"""Configuration: one frozen dataclass for each part of the method.

Every field is a command-line flag (``--ground.max-depth-m``) and a TOML key
(``[ground] max_depth_m``). The parts ``floor``, ``surface`` and ``obstacle`` configure the methods
on depth cells, ``features`` and ``cluster`` the preset ``paper``; the other parts serve both. The
dataclasses are hashable, so JAX can take them as static arguments. Numbers of sections and
equations are those of the paper (``jaxdet help paper``).
"""

import math
from dataclasses import dataclass, field
from typing import Any

from jaxdet.arguments import check_fields
from jaxdet.errors import ConfigError

MAX_POINTS = 8192
"""Maximum number of points clustered per frame; with more, the 32-bit keys and sums overflow."""

TRIM_SHARE = 16
"""Divisor of an obstacle's number of points; the quotient is the maximum number of points that are
trimmed at each side, and in front."""

LARGEST_STEP_M = 1.0
"""Largest step, margin or error that a configuration accepts [m]; larger values are probably in
millimetres."""

LARGEST_SIZE_M = 5.0
"""Largest object size and gap in depth that a configuration accepts [m]."""

LARGEST_GAP_M = 10.0
"""Largest gap on the floor that a configuration accepts [m]."""

FARTHEST_M = 65.535
"""Largest depth that a configuration accepts [m]: the largest 16-bit number of millimetres."""

DEPTH_UNITS_M = 1e-5, 0.1
"""Smallest and largest depth unit [m]; the largest 16-bit depth is then 0.65 m and 6.5 km."""


def _require(condition: bool, field_name: str, rule: str) -> None:
    if not condition:
        remedy = f"see --{field_name} in --help-all"
        raise ConfigError(f"{field_name} must be {rule}", remedy=remedy)


def _require_within(part: Any, low: float, high: float, *names: str) -> None:
    """Raise ConfigError if one of the named fields of a section is set and outside the bounds."""
    section, rule = type(part).__name__.removesuffix("Config").lower(), f"from {low:g} to {high:g}"
    for name in names:
        unit = " m" if name.endswith("_m") and "_per_" not in name else ""
        value = getattr(part, name)
        within = value is None or low <= value <= high
        _require(within, f"{section}.{name.replace('_', '-')}", rule + unit)


@dataclass(frozen=True)
class GroundConfig:
    """Depth range and floor (Section 3.3, Eq. 5)."""

    min_depth_m: float = 0.15
    """Minimum depth [m]."""
    max_depth_m: float = 4.0
    """Maximum depth at which an obstacle may begin [m]; see surface.beyond."""
    step_height_m: float = 0.05
    """Maximum height that the wheels can climb [m]; lower points are floor."""
    step_height_per_m: float = 0.003
    """Increase of the step height per metre of depth [m/m], for noise; it is divided by s for cells
    of s x s pixels. In the method of the paper it is the uncertainty of the floor's tilt (0.003 is
    0.2 degrees) and is not divided; the preset paper sets it to 0, as in the paper.
    """
    noise_per_m: float = 0.07
    """Maximum depth noise on the floor [1/m]: the step height is at least the noise that the floor
    of the frame shows, and that is at most the product of this value, the camera's height and the
    depth, divided by s for cells of s x s pixels. 0 disables it.
    """
    max_height_m: float = 2.0
    """Maximum obstacle height, the robot's clearance [m]. Objects that hang higher are ignored, and
    taller ones are clipped. 0: no limit. Not used by paper."""
    camera_height_m: float | None = None
    """Camera mounting height above the floor [m]. Unset: taken from the log's TF, else estimated
    from a sample of its frames. The depth of each frame corrects it."""
    camera_pitch_rad: float | None = None
    """Downward tilt of the camera [rad], required with the height; 0 for a level camera."""
    camera_roll_rad: float = 0.0
    """Roll of the camera [rad], clockwise seen from behind; used with camera_height_m."""
    source: str = "auto"
    """Source of the prior for the floor estimate of each frame: flags, tf, auto (flags, else tf),
    or estimate (neither). If enough frames of a sample show the floor, their median floor replaces
    the prior. none: no floor is estimated, and no points are removed as floor."""
    sample_frames: int = 24
    """Number of frames in the sample, evenly spaced over the log or over each time window."""
    window_s: float = 0.0
    """Length of time windows with one sample each [s]. 0: one sample for the whole log."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 0, FARTHEST_M, "max_depth_m")
        _require(
            0 <= self.min_depth_m < self.max_depth_m, "ground.min-depth-m", "in [0, max-depth-m)"
        )
        _require_within(self, 0, LARGEST_STEP_M, "step_height_m")
        _require(
            self.max_height_m == 0 or self.step_height_m < self.max_height_m <= LARGEST_GAP_M,
            "ground.max-height-m",
            f"above the step height, to {LARGEST_GAP_M:g} m, or 0",
        )
        _require(0 <= self.step_height_per_m < 1, "ground.step-height-per-m", "in [0, 1)")
        _require(0 <= self.noise_per_m < 1, "ground.noise-per-m", "in [0, 1)")
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
        _require_within(self, 0, 1e9, "window_s")
        for angle, most in (("pitch", math.pi / 2), ("roll", math.pi)):
            value = getattr(self, f"camera_{angle}_rad") or 0.0
            rule = f"within {math.degrees(most):.0f}°, got {math.degrees(value):.0f}°"
            _require(abs(value) <= most + 1e-9, f"ground.camera-{angle}", rule)
            _require(
                not value or self.camera_height_m is not None,
                "ground.camera-height-m",
                f"given with camera-{angle}: one without the other does not determine the floor",
            )
        _require(
            self.camera_height_m is None or self.camera_pitch_rad is not None,
            "ground.camera-pitch",
            "given with --ground.camera-height-m, 0deg for a level camera; without both, the floor "
            "is estimated in each frame",
        )


@dataclass(frozen=True)
class FeaturesConfig:
    """Canny edges, then Shi-Tomasi corners of the edge image (Section 3.2)."""

    canny_low: float = 50.0
    """Lower hysteresis threshold [grey levels of the L1 gradient]."""
    canny_high: float = 100.0
    """Upper hysteresis threshold [grey levels of the L1 gradient]."""
    max_corners: int = 1024
    """Maximum number of corners; the strongest are kept."""
    quality_level: float = 0.01
    """Minimum corner strength, as a fraction of the strongest corner's minimum eigenvalue."""
    min_distance: float = 3.0
    """Minimum distance between two corners [pixel]; values below 1 have no effect."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 1, MAX_POINTS, "max_corners")
        for name in ("canny_low", "canny_high"):
            field = f"features.{name.replace('_', '-')}"
            _require(not math.isnan(getattr(self, name)), field, "a number")
        _require(0 < self.quality_level <= 1, "features.quality-level", "in (0, 1]")
        _require_within(self, 0, MAX_POINTS, "min_distance")

    @property
    def canny_bounds(self) -> tuple[int, int]:
        """Canny's thresholds as integers from -1 to 2047, the lower first.

        The L1 gradient of a 3x3 Sobel filter is between 0 and 2040, so clipping changes nothing.
        """
        low, high = sorted((self.canny_low, self.canny_high))
        return math.floor(min(max(low, -1), 2047)), math.floor(min(max(high, -1), 2047))


@dataclass(frozen=True)
class FloorConfig:
    """Floor estimation per frame, and free floor.

    The prior comes from flags, TF, or a sample of the log's frames.
    """

    max_cells: int = 4800
    """Maximum number of cells from which the floor is estimated; if an image has more, they are
    subsampled on a regular grid."""
    max_depth_m: float = 6.0
    """Maximum depth from which the floor is estimated [m]; 0: no floor is estimated."""
    noise_per_m: float = 0.004
    """Depth error divided by depth squared [1/m]; 0.004 for a D435."""
    max_turn_deg: float = 4.0
    """Largest correction of the prior's pitch and roll [degree]."""
    max_shift_m: float = 0.07
    """Largest correction of the prior's height [m]."""
    min_share: float = 0.04
    """Minimum inlier fraction: cells on the floor, divided by all cells used."""
    min_share_alone: float = 0.06
    """Minimum inlier fraction without a prior, for a pitch of up to 35 degrees; it rises by 1.2
    percentage points per additional degree. Each cell clearly below the plane costs two inliers."""
    ramps: bool = True
    """Whether to search for a ramp ahead; with a prior, also for a step."""
    bow_per_m: float = 0.01
    """Tolerance for stereo bowing of distant floors [1/m]: cells below the plane by at most the
    step height plus this value times z squared are still floor."""
    drop_m: float = 0.05
    """Minimum height of a drop [m]; the noise is added to it."""
    gap_m: float = 0.5
    """Maximum length of unmeasured floor across which the free floor continues [m]."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require(self.max_cells >= 100, "floor.max-cells", "at least 100")
        _require_within(self, 0, FARTHEST_M, "max_depth_m")
        _require_within(
            self, 0, 1, "noise_per_m", "max_shift_m", "min_share", "min_share_alone", "bow_per_m"
        )
        _require_within(self, 0, 10, "max_turn_deg")
        _require_within(self, 0, LARGEST_SIZE_M, "drop_m")
        _require_within(self, 0, LARGEST_GAP_M, "gap_m")


@dataclass(frozen=True)
class SurfaceConfig:
    """Surfaces in a grid of depth cells; the floor is estimated from the same grid."""

    cell_rad: float = 0.0078
    """Angular size of a square cell at the centre of the depth image [rad]; 0.0078 is 4 pixels of a
    Kinect with 640 columns, 3 of a D435, 7 of a D415 with 1280."""
    step_m: float = 0.03
    """Maximum depth difference between neighbouring cells of a surface [m]."""
    step_per_m: float = 0.011
    """Increase of the maximum depth difference, in proportion to z squared [1/m]; 0.011 is about
    four standard deviations of a D435's depth."""
    crease_cells: int = 3
    """Number of cells on each side over which a crease (a bend in depth) is measured."""
    crease_m: float = 0.010
    """Minimum deviation in depth at a crease that separates surfaces [m]."""
    crease_per_m: float = 0.004
    """Increase of crease_m, in proportion to z squared [1/m]."""
    crease_margin: int = 1
    """Number of cells by which creases are dilated, to close gaps in them."""
    min_cells: int = 6
    """Minimum number of cells of a surface or of a crease."""
    hole_cells: int = 8
    """Maximum number of consecutive unmeasured cells, in a row or column, across which cells count
    as connected for min_cells, if their depth continues. 0 disables it."""
    bent_m: float = 0.20
    """Maximum height of stereo bowing [m]: a lower surface is floor if it has no steep side and is
    far away or at the image border. 0 disables it."""
    beyond: float = 1.15
    """Factor by which surfaces extend beyond the maximum depth, so that the end of the range does
    not cut objects into pieces; objects that begin beyond the range are ignored."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 1e-4, 0.1, "cell_rad")
        _require_within(self, 0, LARGEST_STEP_M, "step_m", "crease_m", "bent_m")
        _require_within(self, 0, 1, "step_per_m", "crease_per_m")
        _require_within(self, 1, 16, "crease_cells")
        _require_within(self, 0, 16, "crease_margin")
        _require_within(self, 0, 512, "hole_cells")
        _require_within(self, 1, MAX_POINTS, "min_cells")
        _require_within(self, 1, 4, "beyond")


AFFINITIES = ("surfaces", "tabletop")
"""Names of the models in :mod:`jaxdet.affinity`."""


@dataclass(frozen=True)
class ObstacleConfig:
    """Merging of surfaces into obstacles, by their gaps on the floor and other pair features."""

    affinity: str = "surfaces"
    """Learned model for merging pairs of surfaces: surfaces (rooms and streets) or tabletop. It
    assumes the default cell size."""
    lateral_gap_m: float = 1.5
    """Maximum lateral gap between surfaces that may be merged, d_x [m]."""
    forward_gap_m: float = 0.8
    """Maximum forward gap between surfaces that may be merged, on the floor, d_z [m]."""
    depth_gap_m: float = 0.12
    """Maximum depth difference between two parts of a surface on both sides of an occluder or a
    hole [m]; a tenth of the distance between them is added."""
    contact_m: float = 0.10
    """Maximum depth difference at which a piece too small for an obstacle joins a touching surface
    [m]."""
    bend_m: float = 0.15
    """Maximum distance of an obstacle's contour behind the chord between its ends [m]; beyond it
    the obstacle is split there, like two walls at a corner of a room. 0 disables it."""
    side_m: float = 1.0
    """Minimum length of both sides of a split at a corner [m], and maximum distance between
    neighbouring contour points there; see bend_m."""
    min_size_m: float = 0.05
    """Minimum width or height of an obstacle [m]."""
    min_cells: int = 6
    """Minimum number of depth cells of an obstacle."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 0, LARGEST_STEP_M, "contact_m")
        _require_within(self, 0, LARGEST_SIZE_M, "depth_gap_m", "bend_m", "min_size_m")
        _require_within(self, 0, LARGEST_GAP_M, "lateral_gap_m", "forward_gap_m", "side_m")
        _require(self.affinity in AFFINITIES, "obstacle.affinity", " or ".join(AFFINITIES))
        _require_within(self, 1, MAX_POINTS, "min_cells")


@dataclass(frozen=True)
class ClusterConfig:
    """Clustering of points by gaps in depth, then sideways (Section 3.4, Eq. 6); preset paper."""

    points: bool = False
    """Cluster points, as in the paper, instead of merging surfaces. The other settings of this
    section apply to points only."""
    depth_gap_m: float | None = None
    """d_z, depth gap between neighbouring points above which a new cluster starts [m]. Unset:
    robot_width_m; without it, 0.15."""
    lateral_gap_m: float | None = None
    """d_x, lateral gap above which a new cluster starts [m]. Unset: robot_width_m; without it,
    0.27."""
    min_points: int = 10
    """N of the paper: clusters of this many points or fewer are dropped."""
    robot_width_m: float | None = None
    """Width that the robot needs to pass [m], used as both gaps: obstacles that it can't pass
    between are one (Sections 3.4 and 6)."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 0, LARGEST_SIZE_M, "depth_gap_m", "robot_width_m")
        _require_within(self, 0, LARGEST_GAP_M, "lateral_gap_m")
        _require_within(self, 0, MAX_POINTS, "min_points")
        for name, gap_m in (("depth", self.depth_gap_m), ("lateral", self.lateral_gap_m)):
            _require(
                self.robot_width_m is None or gap_m is None,
                f"cluster.{name}-gap-m",
                "unset (None) if cluster.robot-width-m is given, which sets both gaps",
            )

    @property
    def gaps_m(self) -> tuple[float, float]:
        """Gaps d_z and d_x of Eq. 6 [m]."""
        width_m = self.robot_width_m
        depth_m, lateral_m = (0.15, 0.27) if width_m is None else (width_m, width_m)
        return (
            depth_m if self.depth_gap_m is None else self.depth_gap_m,
            lateral_m if self.lateral_gap_m is None else self.lateral_gap_m,
        )


@dataclass(frozen=True)
class FootprintConfig:
    """Outline on the floor (Section 3.5, Eq. 7-9).

    A and B are the outermost points of an obstacle on the left and on the right, C its nearest one.
    """

    vertex_threshold_m: float = 0.03
    """d_threshold of Eq. 7 [m], about the sensor's error. C is a vertex if it is nearer than A and
    B by at least this distance."""
    trim: int = 2
    """Number of outermost points on each side, and of nearest points, that are ignored as outliers
    in A, B and C; at most a sixteenth of the obstacle's points. The paper has 0."""
    side_band_per_m: float = 0.006
    """Width per metre of distance [m/m] of two bands of points, behind the leftmost and the
    rightmost point. Their medians are A and B, since silhouettes blur over about three pixels. The
    paper has no bands (0)."""
    near_band_per_m2: float = 0.012
    """Depth of a band of points behind the nearest point, divided by the distance squared [1/m], as
    stereo noise grows with this square; 0.012 is about four standard deviations of a D435. The
    median of the band is C, since the minimum of noisy depths is biased. The paper has no band (0).
    """
    extension_m: float = 0.20
    """Distance by which the edge AB is extended backward if there is no vertex [m]. Rectangles that
    are fitted to cells are not extended."""
    margin_m: float = 0.0
    """Margin added to the rectangle on all sides [m]."""
    margin_per_m2: float = 0.007
    """Increase of the margin in proportion to the square of the obstacle's smallest z [1/m], like
    stereo noise; 0.007 is nearly two standard deviations of a D435."""
    long_m: float = 3.0
    """Length above which a fitted rectangle ignores a twentieth of its cells at each long side [m],
    since the depth of walls spreads over the floor in front of them."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 0, LARGEST_STEP_M, "vertex_threshold_m", "margin_m")
        _require_within(self, 0, 1, "side_band_per_m", "near_band_per_m2", "margin_per_m2")
        _require_within(self, 0, MAX_POINTS, "trim")
        extension = 0 < self.extension_m <= LARGEST_SIZE_M
        rule = f"above 0 and at most {LARGEST_SIZE_M:g} m"
        _require(extension, "footprint.extension-m", rule)
        _require_within(self, 0, FARTHEST_M, "long_m")


@dataclass(frozen=True)
class Config:
    """Configuration of the whole method."""

    ground: GroundConfig = field(default_factory=GroundConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    footprint: FootprintConfig = field(default_factory=FootprintConfig)
    floor: FloorConfig = field(default_factory=FloorConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    obstacle: ObstacleConfig = field(default_factory=ObstacleConfig)

    def __post_init__(self) -> None:
        check_fields(self)
