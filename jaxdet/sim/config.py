"""Parameters of the simulator."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.sim.exposure import ColorSensor, LightName
from jaxdet.sim.stereo import DepthSensor
from jaxdet.types import Calibration, Extrinsics, Intrinsics

DEPTH_F, DEPTH_CX, DEPTH_CY = 384.5, 321.7, 236.8
"""Focal length and optical centre of a RealSense depth camera at 640 x 480 [pixel]: the factory
calibration in the aims-slam recording, for 848 x 480, scaled to the same field of view."""
COLOR_FX, COLOR_FY, COLOR_CX, COLOR_CY = 617.25, 617.549, 317.392, 245.980
"""Focal lengths and optical centre of a D435's colour camera at 640 x 480 [pixel], from the data
set ros_detect_planes_from_depth_img."""
DEPTH_TO_COLOR_M = (0.0148, 0.0002, 0.0003)
"""Translation from depth to colour camera [m]: 15 mm by the D400 series data sheet, plus fractions
of a mm as in factory calibrations."""
DEPTH_TO_COLOR_RAD = (0.003, -0.004, 0.002)
"""Rotation about x, y, z from depth to colour camera [rad], as large as in factory calibrations."""


@dataclass(frozen=True)
class SimConfig:
    """Scene and recording of a simulated log."""

    scene: str = "demo"
    """Scene: demo, drive, empty, single_box, row, posts; randomised by the seed:
    people_and_vehicle, roadblocks, bucket, tree_trunk, mixed, cylinder, approach, queue,
    low_things, pedestrian, and the harder corridor, wall_in_range, room, low_clutter, drops, ramps,
    tables, crowded; moving, with walking people and crossing carts; or a TOML or JSON file."""
    frames: int = 60
    """Number of colour frames."""
    seed: int = 0
    """Random seed; the same seed gives the same bytes."""
    rate_hz: float = 30.0
    """Frames per second."""
    width: int = 640
    """Width of both images [pixel]."""
    height: int = 480
    """Height of both images [pixel]."""
    depth_form: Literal["raw", "aligned", "both", "metres"] = "raw"
    """Form of depth images: raw, uint16 mm in the depth camera; aligned, in the colour camera;
    both; metres, like raw but in float32 [m]."""
    mount_tf: bool = True
    """Write the mount of the camera to TF; if off, the floor must be estimated."""
    extrinsics: Literal["tf", "topic", "both", "none"] = "both"
    """Messages in which the extrinsics from depth to colour camera are recorded."""
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    """Compression of the file's chunks."""
    camera_height_m: float = 0.30
    """Mounting height of the colour camera above the floor [m]."""
    camera_pitch_rad: float = 0.1745
    """Downward tilt of the camera [rad]."""
    camera_roll_rad: float = 0.0175
    """Roll of the camera, clockwise seen from behind [rad]."""
    mount_pitch_error_rad: float = 0.0
    """True pitch minus ``camera_pitch_rad``, which is in TF [rad]."""
    mount_roll_error_rad: float = 0.0
    """True roll minus the roll in TF [rad]."""
    mount_height_error_m: float = 0.0
    """True mounting height minus the height in TF [m]."""
    rock_rad: float = 0.0
    """Standard deviation of random changes of pitch and roll in each frame [rad], which are not in
    TF."""
    sensor: DepthSensor = field(default_factory=DepthSensor)
    """Errors of the depth camera."""
    depth_error: float = 0.0
    """Scale of the additional errors of a D435 on real floors (:meth:`DepthSensor.with_errors`);
    0: only the errors of ``sensor``."""
    exposure: ColorSensor = field(default_factory=ColorSensor)
    """Exposure model of the colour camera: sensor, lens and image processor."""
    light: LightName = "normal"
    """Light: strong 30 000 lx, normal 500, weaker 120, dim 50."""
    slope_rad: float | None = None
    """Slope of the ramp ahead [rad]; default: the slope in the scene."""
    distance_m: float = 2.0
    """Distance of the obstacle in the scenes cylinder and approach [m]."""
    device: str = "cpu"
    """Device of the ray caster, cpu or cuda; results may differ in single pixels."""
    depth_delay_s: float = 0.0
    """Delay of the depth image relative to colour [s]."""
    odometry_hz: float = 50.0
    """Odometry messages per second; 0: no odometry, so no world coordinates."""
    odometry_drift: float = 0.0
    """Odometry drift: relative error of the distance, and rotation in radians per metre."""
    start_ns: int = 1_700_000_000_000_000_000
    """Timestamp of the first colour frame [ns]; at latest a day before ROS 2 times end in 2038."""

    def __post_init__(self) -> None:
        rules = {
            "frames": self.frames >= 0,
            "seed": self.seed >= 0,
            "rate-hz": self.rate_hz > 0,
            "width": self.width >= 16,
            "height": self.height >= 16,
            "camera-height-m": self.camera_height_m > 0,
            "camera-pitch-rad": abs(self.camera_pitch_rad) < 1.5,
            "mount-pitch-error-rad": abs(self.camera_pitch_rad + self.mount_pitch_error_rad) < 1.5,
            "mount-height-error-m": self.camera_height_m + self.mount_height_error_m > 0,
            "rock-rad": 0 <= self.rock_rad < 0.3,
            "depth-error": 0 <= self.depth_error <= 10,
            "distance-m": self.distance_m > 0,
            "slope-rad": abs(self.slope_rad or 0.0) < 0.5,
            "odometry-hz": self.odometry_hz >= 0,
            "start-ns": 10**9 <= self.start_ns <= (2**31 - 86_400) * 10**9,
        }
        for name, valid in rules.items():
            if not valid:
                raise ConfigError(f"{name} is out of range", remedy="see jaxdet sim --help")


def calibration_of(config: SimConfig) -> Calibration:
    """Return the calibration for images of the configured size; it is scaled by their width."""
    width, height = config.width, config.height
    scale = width / 640
    shift = (height - 480 * scale) / 2
    color = Intrinsics(
        width, height, COLOR_FX * scale, COLOR_FY * scale, COLOR_CX * scale,
        COLOR_CY * scale + shift,
    )  # fmt: skip
    depth = Intrinsics(
        width, height, DEPTH_F * scale, DEPTH_F * scale, DEPTH_CX * scale, DEPTH_CY * scale + shift
    )
    a, b, c = DEPTH_TO_COLOR_RAD
    Rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    Ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    Rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    rotation = tuple((Rz @ Ry @ Rx).ravel().tolist())
    return Calibration(depth, color, Extrinsics(rotation, DEPTH_TO_COLOR_M))
