"""Configuration: one frozen dataclass for each part of the method.

Every field is a command-line flag (``--ground.max-depth-m``) and a TOML key
(``[ground] max_depth_m``). Obstacles are made of surfaces of depth cells by the parts ``floor``,
``surface`` and ``obstacle``, or of points by ``cluster``; the others serve both. All are hashable,
so JAX can take them as static arguments.
"""

import math
from dataclasses import dataclass, field
from typing import Any

from jaxdet.arguments import check_fields
from jaxdet.errors import ConfigError

MAX_POINTS = 8192
"""Most points of a frame that are clustered: what the 32-bit keys and sums hold."""

TRIM_SHARE = 16
"""At most this part of an obstacle's points is passed over at each side, and in front."""

LARGEST_STEP_M = 1.0
"""Largest step, margin or error in a configuration [m]; larger numbers are millimetres."""

LARGEST_SIZE_M = 5.0
"""Largest size of a thing, and gap in depth, in a configuration [m]."""

LARGEST_GAP_M = 10.0
"""Largest gap on the floor in a configuration [m]."""

FARTHEST_M = 65.535
"""Farthest depth [m]: 16 bits of millimetres."""

DEPTH_UNITS_M = 1e-5, 0.1
"""Smallest and largest depth unit: 16 bits of them reach from 0.65 m to 6.5 km."""


def _require(condition: bool, field_name: str, rule: str) -> None:
    if not condition:
        raise ConfigError(f"{field_name} must be {rule}", remedy=f"see --{field_name} in --help")


def _require_within(part: Any, low: float, high: float, *names: str) -> None:
    """Refuses a part of the configuration with such a field outside of the bounds."""
    section, rule = type(part).__name__.removesuffix("Config").lower(), f"from {low:g} to {high:g}"
    for name in names:
        unit = " m" if name.endswith("_m") and "_per_" not in name else ""
        within = low <= getattr(part, name) <= high
        _require(within, f"{section}.{name.replace('_', '-')}", rule + unit)


@dataclass(frozen=True)
class GroundConfig:
    """Range and floor (Section 3.3, Eq. 5)."""

    min_depth_m: float = 0.15
    """Nearest depth used [m]."""
    max_depth_m: float = 4.0
    """Farthest depth used [m]; obstacles begin nearer, see surface.beyond."""
    step_height_m: float = 0.05
    """What the wheels can climb [m]: lower points are floor."""
    step_height_per_m: float = 0.003
    """Added to the step height for each metre of depth, with the floor of each frame for noise:
    cells of s x s pixels add an s-th of it. Clusters of points have one plane, so there it is how
    well the floor's tilt is known (0.003 is 0.2 degrees); the paper's is 0."""
    noise_per_m: float = 0.07
    """Noise of depth on the floor [1/m]: the step height is at least this times the camera's height
    above the floor and the depth, an s-th of it with cells of s x s pixels. 0: as good as none."""
    max_height_m: float = 2.0
    """What the robot fits under [m]: what hangs higher is no obstacle. Of what stands the part
    below counts. 0: no limit; clusters of points have none."""
    camera_height_m: float | None = None
    """Optical centre above the floor [m], as far as known; unset: from the log's TF, else from a
    sample of its frames. Each frame's own depth corrects it."""
    camera_pitch_rad: float | None = None
    """Downward tilt [rad]; given with camera_height_m, 0 where the camera looks level."""
    camera_roll_rad: float = 0.0
    """Clockwise roll seen from behind the camera [rad], with camera_height_m."""
    source: str = "auto"
    """What the floor of each frame is looked for around: auto (flags, then tf), flags, tf, or
    estimate (neither). The median floor of a sample of the log's frames takes its place where
    enough of them show one. none: no floor is looked for, and nothing is dropped as floor."""
    sample_frames: int = 24
    """Frames of that sample, evenly spaced over the log or the window."""
    window_s: float = 0.0
    """Length of the fixed time windows with a sample each [s]. 0: one sample for the log."""

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
            rule = f"within {math.degrees(most):.0f}°, not {math.degrees(value):.0f}°"
            _require(abs(value) <= most + 1e-9, f"ground.camera-{angle}", rule)
            _require(
                not value or self.camera_height_m is not None,
                "ground.camera-height-m",
                f"given with camera-{angle}: one without the other says nothing of the floor",
            )
        _require(
            self.camera_height_m is None or self.camera_pitch_rad is not None,
            "ground.camera-pitch",
            "given with camera-height-m, 0deg where it looks level; without both the floor is "
            "found in each frame",
        )


@dataclass(frozen=True)
class FeaturesConfig:
    """Canny, then Shi-Tomasi on the edge image (Section 3.2)."""

    canny_low: float = 50.0
    """Lower hysteresis bound [grey levels of the L1 gradient]."""
    canny_high: float = 100.0
    """Upper hysteresis bound [grey levels of the L1 gradient]."""
    max_corners: int = 1024
    """Slots for corners: the strongest that are used."""
    quality_level: float = 0.01
    """Weakest corner used, as a share of the strongest one's minimum eigenvalue."""
    min_distance: float = 3.0
    """Least distance between two corners [pixel]; below 1: none."""
    use_mask: bool = True
    """Take corners only on what is in range and above the floor; off: drop them afterwards."""

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
        """Canny's bounds in whole grey levels, the lower first, from -1 to 2047.

        The L1 gradient of a 3x3 Sobel is from 0 to 2040, so bounds farther out mean the same.
        """
        low, high = sorted((self.canny_low, self.canny_high))
        return math.floor(min(max(low, -1), 2047)), math.floor(min(max(high, -1), 2047))


@dataclass(frozen=True)
class FloorConfig:
    """How the floor of each frame, and free floor on it, is looked for.

    The prior is what is known before: from flags, TF, or a sample of the log.
    """

    max_cells: int = 4800
    """Most cells used: a regular part of those given."""
    max_depth_m: float = 6.0
    """Farthest depth used [m]; 0: no floor is looked for."""
    noise_per_m: float = 0.004
    """Error of depth over its square [1/m]; 0.004 is a D435's."""
    max_turn_deg: float = 4.0
    """Most that a prior's pitch and roll are corrected [degree]."""
    max_shift_m: float = 0.07
    """Most that its height is corrected [m]."""
    min_share: float = 0.04
    """Least share of the cells on the floor."""
    min_share_alone: float = 0.06
    """The same without a prior, of a camera pitched by up to 35 degrees; 1.2 % more for each degree
    beyond. Cells clearly below the floor count twice against it."""
    ramps: bool = True
    """Look for a ramp ahead, or for a step where something is known of the floor."""
    bow_per_m: float = 0.01
    """What is measured below the plane by the step height and this, in proportion to z squared, is
    floor still: far floors are bowed [1/m]."""
    drop_m: float = 0.05
    """A floor that falls by more than this at once, and by the noise, is a drop [m]."""
    gap_m: float = 0.5
    """Free floor ends where so much of it shows no measurement [m]."""

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
    """Surfaces in a grid of depth cells, in which the floor is looked for as well."""

    cell_rad: float = 0.0078
    """Angle that a square cell of the depth image takes up at its middle [rad]; 0.0078 is 4 pixels
    of a Kinect's depth image of 640 columns, 3 of a D435's, 7 of a D415's of 1280."""
    step_m: float = 0.03
    """Largest step in depth between neighbouring cells of a surface [m]."""
    step_per_m: float = 0.011
    """Added to it in proportion to z squared [1/m]: some four standard deviations of a D435's
    depth."""
    crease_cells: int = 3
    """A crease is a bend of the depth over so many cells to both sides."""
    crease_m: float = 0.010
    """Bends deeper than this part surfaces [m]."""
    crease_per_m: float = 0.004
    """Added to it in proportion to z squared [1/m]."""
    crease_margin: int = 1
    """Creases are so many cells wider at each side, so that gaps in them join nothing."""
    min_cells: int = 6
    """Smaller components are no surfaces of their own, and smaller creases are noise."""
    hole_cells: int = 8
    """Cells of a row or a column on both sides of at most this many unmeasured ones are linked as
    neighbours are, where their depth goes on. 0: off."""
    bent_m: float = 0.20
    """Surfaces at most so high without a steep side are floor that the sensor bends up, at the
    margins of the image or far away [m]. 0: off."""
    beyond: float = 1.15
    """Surfaces are followed so much farther than the largest depth, so that the end of the range
    does not cut a thing into pieces; what begins beyond the range is no obstacle."""

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
"""Tables of :mod:`jaxdet.affinity`."""


@dataclass(frozen=True)
class ObstacleConfig:
    """Obstacles made of surfaces: gaps on the floor, and what else is seen of two surfaces."""

    affinity: str = "surfaces"
    """Table that says what of two surfaces speaks for their being one: surfaces, learnt in rooms
    and streets, or tabletop. It counts cells of the default size."""
    lateral_gap_m: float = 1.5
    """Surfaces farther apart sideways are not looked at together, d_x [m]."""
    forward_gap_m: float = 0.8
    """Nor those farther apart in depth on the floor, d_z [m]."""
    depth_gap_m: float = 0.12
    """Depths of one surface on both sides of a nearer thing or of a hole differ by at most this,
    and by a tenth of what lies between [m]."""
    contact_m: float = 0.10
    """Pieces too small to be an obstacle join the surface they touch, over at most such a step
    [m]."""
    bend_m: float = 0.15
    """Obstacles whose contour lies so far behind the chord of its ends are split there: walls of a
    room [m]. 0: off."""
    side_m: float = 1.0
    """Their sides are at least so long, and at the corner neighbouring points of the contour at
    most so far apart [m]."""
    min_size_m: float = 0.05
    """Obstacles are at least so wide or so high [m]."""
    min_cells: int = 6
    """Minimum number of depth cells."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 0, LARGEST_STEP_M, "contact_m")
        _require_within(self, 0, LARGEST_SIZE_M, "depth_gap_m", "bend_m", "min_size_m")
        _require_within(self, 0, LARGEST_GAP_M, "lateral_gap_m", "forward_gap_m", "side_m")
        _require(self.affinity in AFFINITIES, "obstacle.affinity", " or ".join(AFFINITIES))
        _require_within(self, 1, MAX_POINTS, "min_cells")


@dataclass(frozen=True)
class ClusterConfig:
    """Clusters of points: gaps in depth, then sideways (Section 3.4, Eq. 6); preset paper."""

    points: bool = False
    """Make obstacles of points, as the paper does; off: of surfaces. The other settings of this
    part are for points alone."""
    depth_gap_m: float = 0.10
    """d_z [m]: a larger gap between neighbours in depth starts a new set."""
    lateral_gap_m: float = 0.40
    """d_x [m]: a larger sideways gap starts a new set; the robot's width."""
    min_points: int = 10
    """N: sets of this many points or fewer are dropped."""

    def __post_init__(self) -> None:
        check_fields(self)
        _require_within(self, 0, LARGEST_SIZE_M, "depth_gap_m")
        _require_within(self, 0, LARGEST_GAP_M, "lateral_gap_m")
        _require_within(self, 0, MAX_POINTS, "min_points")


@dataclass(frozen=True)
class FootprintConfig:
    """Outline on the floor (Section 3.5, Eq. 7-9)."""

    vertex_threshold_m: float = 0.03
    """d_threshold of Eq. 7 [m], about the sensor's error: C must be this much nearer than A
    and B to count as a vertex."""
    trim: int = 2
    """So many of the outermost points of each side, and of the nearest ones, are outliers that
    don't make A, B or C, at most a sixteenth of the obstacle's points. The paper's is 0."""
    side_band_per_m: float = 0.006
    """A and B are the median of the points at most this far inside of the outermost [m], for each
    metre of distance: a silhouette is smeared over about three pixels. The paper's is 0."""
    near_band_per_m2: float = 0.012
    """C is the median of the points at most this far behind the nearest [m], times the distance
    squared [1/m]: of many noisy points the nearest is too near, and stereo noise grows so; 0.012
    is some four standard deviations of a D435's. The paper's is 0."""
    extension_m: float = 0.20
    """How far the edge AB is extended backward when there is no vertex [m]; fitted rectangles end
    with their obstacle's cells."""
    margin_m: float = 0.0
    """Added to the rectangle on all sides [m]."""
    margin_per_m2: float = 0.007
    """Added to it in proportion to the square of the obstacle's smallest z [1/m], as stereo noise
    grows; 0.007 is nearly two standard deviations of a D435's."""
    long_m: float = 3.0
    """Fitted rectangles longer than this pass over a twentieth of their cells at each long side:
    walls are smeared over the floor before them [m]."""

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
    """The whole method."""

    ground: GroundConfig = field(default_factory=GroundConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    footprint: FootprintConfig = field(default_factory=FootprintConfig)
    floor: FloorConfig = field(default_factory=FloorConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    obstacle: ObstacleConfig = field(default_factory=ObstacleConfig)

    def __post_init__(self) -> None:
        check_fields(self)
