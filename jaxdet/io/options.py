"""What a user can say about a log; every field is a flag and a TOML key of ``[log]``.

The flags are ``--log.*``, but those of what is worked on: ``--camera --start --stop --every``.
"""

from dataclasses import dataclass, field

from jaxdet.arguments import check_fields
from jaxdet.config import DEPTH_UNITS_M
from jaxdet.errors import ConfigError
from jaxdet.io.moments import parse_moment

NO_COLOR = "none"
"""In place of the colour topic."""
MAX_OFFSET_S = 4e9
SHORT = {"short": True}
"""Of fields whose flags have no ``log.`` before them."""


@dataclass(frozen=True)
class LogOptions:
    """How to read a log. Everything is found in the log itself unless it is given here."""

    camera: str | None = field(default=None, metadata=SHORT)
    """The camera, where a log has several; unset: all of them, one after the other. Its name is
    what its topics have before colour and depth; jaxdet info lists the names."""
    start: str | None = field(default=None, metadata=SHORT)
    """Begin 12.5s into the log, at 2024-05-01T10:00:00Z, or at a stamp [ns]. Seconds, with s or
    without, count from the log's first depth image. A time without a zone is UTC, and a stamp in
    nanoseconds has 16 to 19 digits (1714557600000000000); both are header stamps. Frame numbers
    stay those of the whole log."""
    stop: str | None = field(default=None, metadata=SHORT)
    """End likewise; a frame with this very stamp is not among them."""
    every: int = field(default=1, metadata=SHORT)
    """Take the frames whose number in the log is a multiple of this."""
    color: str | None = None
    """Topic of the colour images, or none: no colour is used; unset: found by schema, encoding and
    name. Colour is only for pictures, boxes and the preset paper."""
    depth: str | None = None
    """Topic of the depth images; unset: found by encoding and name, aligned depth preferred."""
    color_info: str | None = None
    """Topic of the colour camera's calibration; unset: the one next to the colour images."""
    depth_info: str | None = None
    """Topic of the depth camera's calibration; unset: the one next to the depth images."""
    tf: bool = True
    """Use the log's transforms (extrinsics, floor, poses)."""
    odom: str | None = None
    """Topic with the robot's pose (Odometry, PoseStamped, PoseInFrame); unset: TF, else the
    only Odometry or PoseInFrame topic."""
    pair_tolerance_s: float = 0.15
    """Greatest difference of the header stamps of a depth image and the colour image that is shown
    with it, the nearest one [s]; 0.15 s allows for the long exposures of a dim room (0.10 s on a
    real D435)."""
    color_offset_s: float | None = None
    """How far the clock of colour's stamps is ahead of depth's [s]; unset: measured by the log
    times where it is more than 0.5 s."""
    pose_offset_s: float | None = None
    """How far the clock of transforms or odometry is ahead of depth's [s]; unset: likewise."""
    depth_unit_m: float | None = None
    """Metres in one unit of the recorded depth; unset: 0.001 for 16-bit images, 1 for 32FC1 (0.001
    where it is in millimetres). From 0.00001 to 0.1, or 1."""
    color_from_depth: tuple[float, float, float, float, float, float, float] | None = None
    """T_color_depth, from depth to colour camera: tx ty tz qx qy qz qw [m]; goes before what
    the log says."""
    color_intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the colour camera [pixel]; goes before what the log says."""
    depth_intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the depth camera [pixel]; goes before what the log says."""
    color_distortion: str | None = None
    """Lens model of the colour camera: none, plumb_bob, rational_polynomial, equidistant,
    inverse_brown_conrady; the coefficients are the log's."""
    depth_distortion: str | None = None
    """Lens model of the depth camera, one of the same names."""
    depth_aligned: bool | None = None
    """Whether the depth images are aligned to colour; unset: by topic name, frame and
    calibration."""
    camera_frame: str | None = None
    """TF frame of the depth camera (optical), or of the colour camera where depth is aligned to it;
    unset: the one in the image's header."""
    base_frame: str | None = None
    """TF frame of the robot, whose z = 0 is the floor; unset: base_footprint, else base_link."""
    world_frame: str | None = None
    """TF frame of the world; unset: map, else odom."""
    mask: str | None = field(default=None, metadata={"takes": "FILE"})
    """PNG as large as the depth images, black where the camera sees its own robot: depth counts as
    not measured there. CAMERA=FILE,CAMERA=FILE for several cameras; jaxdet info --suggest-mask FILE
    makes one. Results hold the pixels, not the file."""
    max_chunk_mib: int = 256
    """Largest chunk or message read [MiB], before and after decompression; larger ones are
    rejected, which bounds memory and stops decompression bombs."""
    max_pixels: int = 1 << 25
    """Largest image decoded [pixel]; a larger one is a bad frame."""

    scan: bool = False
    """Read the whole log at opening, instead of trusting its index."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.mask is not None:
            from jaxdet.io.body_mask import masks_text  # which loads NumPy

            object.__setattr__(self, "mask", masks_text(self.mask))
        for name in ("start", "stop"):
            if getattr(self, name) is not None:
                parse_moment(getattr(self, name), f"--{name}")
        if self.every < 1:
            raise ConfigError(f"every {self.every}", remedy="give --every 1 or more")
        _require(0 <= self.pair_tolerance_s < 1e6, "pair-tolerance-s", "at least 0")
        for name in ("color_offset_s", "pose_offset_s"):
            known = getattr(self, name) is None or abs(getattr(self, name)) < MAX_OFFSET_S
            _require(known, name.replace("_", "-"), f"less than {MAX_OFFSET_S:g} s")
        unit, (smallest, largest) = self.depth_unit_m, DEPTH_UNITS_M
        known = unit is None or smallest <= unit <= largest or unit == 1
        _require(known, "depth-unit-m", f"from {smallest:g} to {largest:g} m, or 1 (32FC1)")
        _require(1 <= self.max_chunk_mib <= 1 << 20, "max-chunk-mib", "at least 1")
        _require(self.max_pixels >= 1, "max-pixels", "at least 1")
        for name in ("color_intrinsics", "depth_intrinsics"):
            value = getattr(self, name)
            flag = name.replace("_", "-")
            _require(value is None or min(value[:2]) > 0, flag, "fx fy cx cy with fx, fy above 0")
        of_depth = self.color_from_depth or self.depth_intrinsics
        if self.depth_aligned and of_depth:
            flag = "color-from-depth" if self.color_from_depth else "depth-intrinsics"
            problem = f"log.depth-aligned with log.{flag}, which aligned depth has no use for"
            raise ConfigError(problem, remedy="give one of them")
        rotation = self.color_from_depth[3:] if self.color_from_depth else (0, 0, 0, 1)
        norm = sum(part * part for part in rotation)
        _require(0.98 < norm < 1.02, "color-from-depth", "tx ty tz qx qy qz qw, a unit quaternion")


def _require(condition: bool, flag: str, rule: str) -> None:
    if not condition:
        raise ConfigError(f"log.{flag} must be {rule}", remedy=f"see --log.{flag} in --help")
