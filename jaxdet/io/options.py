"""Options for reading logs; every field is a flag and a TOML key in ``[log]``.

The flags start with ``--log.``, except for the selection: ``--camera --start --stop --every``.
"""

from dataclasses import dataclass, field

from jaxdet.arguments import check_fields
from jaxdet.config import DEPTH_UNITS_M
from jaxdet.errors import ConfigError
from jaxdet.io.moments import parse_moment

NO_COLOR = "none"
"""Value of ``color`` that ignores colour."""
MAX_OFFSET_S = 4e9
SHORT = {"short": True}
"""Metadata of fields whose flags do not start with ``log.``."""


@dataclass(frozen=True)
class LogOptions:
    """Options for reading a log; unset options are determined from the log."""

    camera: str | None = field(default=None, metadata=SHORT)
    """Camera to read if a log has several; unset: all cameras, one after the other. The name of a
    camera is the prefix of its topics before colour and depth; jaxdet info lists the names."""
    start: str | None = field(default=None, metadata=SHORT)
    """Start 12.5s into the log, at 2024-05-01T10:00:00Z, or at a stamp [ns]. Seconds (the s
    is optional) count from the log's first depth image. Times are UTC unless they have a time zone,
    and timestamps in nanoseconds have 16 to 19 digits (1714557600000000000); both refer to header
    timestamps. Frames keep their numbers in the log."""
    stop: str | None = field(default=None, metadata=SHORT)
    """End before this time, in the same forms as --start."""
    every: int = field(default=1, metadata=SHORT)
    """Select the frames whose number in the log is a multiple of this."""
    color: str | None = None
    """Topic of the colour images, or none to ignore colour; unset: determined by schema, encoding
    and name. Colour is only used for pictures, boxes and the preset paper."""
    depth: str | None = None
    """Topic of the depth images; unset: determined by encoding and name, preferably aligned depth.
    """
    color_info: str | None = None
    """Topic of the colour camera's calibration; unset: the topic next to the colour images."""
    depth_info: str | None = None
    """Topic of the depth camera's calibration; unset: the topic next to the depth images."""
    tf: bool = True
    """Use the transforms of the log (extrinsics, floor, poses)."""
    odom: str | None = None
    """Topic of the robot's pose (Odometry, PoseStamped, PoseInFrame); unset: TF, else the only
    Odometry or PoseInFrame topic."""
    pair_tolerance_s: float = 0.15
    """Maximum difference between the header timestamps of a depth image and its colour image, the
    nearest one [s]. 0.15 s allows for long exposures in dim rooms (0.10 s on a real D435)."""
    color_offset_s: float | None = None
    """Offset of the clock of colour relative to depth [s], positive if colour is ahead; unset:
    measured from the log times if it is more than 0.5 s."""
    pose_offset_s: float | None = None
    """Offset of the clock of transforms or odometry relative to depth [s], positive if they are
    ahead; unset: measured from the log times if it is more than 0.5 s."""
    depth_unit_m: float | None = None
    """Metres per unit of the recorded depth; unset: 0.001 for 16-bit images, 1 for 32FC1 (pass
    0.001 if it is in millimetres). From 0.00001 to 0.1, or 1."""
    color_from_depth: tuple[float, float, float, float, float, float, float] | None = None
    """Transform from depth to colour camera (T_color_depth): tx ty tz qx qy qz qw [m]. It
    overrides the log."""
    color_intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the colour camera [pixel]; overrides the log."""
    depth_intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the depth camera [pixel]; overrides the log."""
    color_distortion: str | None = None
    """Lens model of the colour camera: none, plumb_bob, rational_polynomial, equidistant,
    inverse_brown_conrady. The coefficients are those in the log."""
    depth_distortion: str | None = None
    """Lens model of the depth camera; same names as for the colour camera."""
    depth_aligned: bool | None = None
    """Whether the depth images are aligned to colour; unset: determined by topic name, frame and
    calibration."""
    camera_frame: str | None = None
    """TF frame of the depth camera (optical), or of the colour camera if depth is aligned to it;
    unset: the frame in the header of the images."""
    base_frame: str | None = None
    """TF frame of the robot, whose z = 0 is the floor; unset: base_footprint, else base_link."""
    world_frame: str | None = None
    """TF frame of the world; unset: map, else odom."""
    mask: str | None = field(default=None, metadata={"takes": "FILE"})
    """PNG of the size of the depth images, black where the camera sees the robot's own body, or
    JSON with polygons around it; depth there is ignored. For several cameras:
    CAMERA=FILE,CAMERA=FILE. jaxdet info --suggest-mask FILE makes a PNG. Results contain the
    pixels, not the file name."""
    max_chunk_mib: int = 256
    """Maximum size of a chunk or message [MiB], before and after decompression. Larger ones are
    rejected, which limits memory and stops decompression bombs."""
    max_pixels: int = 1 << 25
    """Maximum size of an image [pixel]; frames with larger images get an error status."""

    scan: bool = False
    """Read the complete log at opening instead of trusting its index."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.mask is not None:
            from jaxdet.io.body_mask import masks_text  # imports NumPy

            object.__setattr__(self, "mask", masks_text(self.mask))
        for name in ("camera_frame", "base_frame", "world_frame"):  # as in the messages
            object.__setattr__(self, name, (getattr(self, name) or "").lstrip("/") or None)
        for name in ("start", "stop"):
            if getattr(self, name) is not None:
                parse_moment(getattr(self, name), f"--{name}")
        if self.every < 1:
            problem = f"--every must be at least 1, got {self.every}"
            raise ConfigError(problem, remedy="see --every in --help")
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
            problem = f"log.depth-aligned and log.{flag} exclude each other"
            raise ConfigError(problem, remedy="pass only one of them")
        rotation = self.color_from_depth[3:] if self.color_from_depth else (0, 0, 0, 1)
        norm = sum(part * part for part in rotation)
        _require(0.98 < norm < 1.02, "color-from-depth", "tx ty tz qx qy qz qw, a unit quaternion")


def _require(condition: bool, flag: str, rule: str) -> None:
    if not condition:
        raise ConfigError(f"log.{flag} must be {rule}", remedy=f"see --log.{flag} in --help-all")
