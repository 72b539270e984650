"""What the simulator can be asked for."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.sim.exposure import ColorSensor, LightName
from jaxdet.sim.stereo import DepthSensor
from jaxdet.types import Calibration, Extrinsics, Intrinsics

DEPTH_F, DEPTH_CX, DEPTH_CY = 384.5, 321.7, 236.8
"""A RealSense's depth camera at 640 x 480 [pixel]: 848 x 480 factory values of the aims-slam
recording, scaled to the same field of view."""
COLOR_FX, COLOR_FY, COLOR_CX, COLOR_CY = 617.25, 617.549, 317.392, 245.980
"""A D435's colour camera at 640 x 480 [pixel]: the ros_detect_planes_from_depth_img data."""
DEPTH_TO_COLOR_M = (0.0148, 0.0002, 0.0003)
"""Depth to colour camera [m]: 15 mm by the D400 series data sheet, off by parts of a mm as
factory calibrations are."""
DEPTH_TO_COLOR_RAD = (0.003, -0.004, 0.002)
"""Rotation about x, y, z between the two [rad], of the size of factory calibrations."""


@dataclass(frozen=True)
class SimConfig:
    """A simulated log: what is in it and how it is recorded."""

    scene: str = "demo"
    """Scene: demo, empty, single_box, row, posts; drawn by the seed: people_and_vehicle,
    roadblocks, bucket, tree_trunk, mixed, cylinder, approach, queue, low_things, pedestrian, and
    the harder corridor, wall_in_range, room, low_clutter, drops, ramps, tables; moving, where
    people walk and carts cross; or a TOML or JSON file."""
    frames: int = 60
    """Number of colour frames."""
    seed: int = 0
    """Seed of textures and noise; the same seed gives the same bytes."""
    rate_hz: float = 30.0
    """Frames a second."""
    width: int = 640
    """Width of both images [pixel]."""
    height: int = 480
    """Height of both images [pixel]."""
    depth_form: Literal["raw", "aligned", "both", "metres"] = "raw"
    """raw: uint16 mm on the depth camera's rays, to be aligned; aligned: on the colour camera's
    rays; both; metres: as raw, but float32 metres."""
    mount_tf: bool = True
    """Whether the log's TF says how the camera is mounted; off: the floor must be estimated."""
    extrinsics: Literal["tf", "topic", "both", "none"] = "both"
    """Where the log says how colour and depth camera lie to each other."""
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    """Compression of the file's chunks."""
    camera_height_m: float = 0.30
    """Optical centre of the colour camera above the floor [m]."""
    camera_pitch_rad: float = 0.1745
    """Its downward tilt [rad]."""
    camera_roll_rad: float = 0.0175
    """Its roll, clockwise seen from behind [rad]."""
    mount_pitch_error_rad: float = 0.0
    """How much more the camera truly looks down than ``camera_pitch_rad``, which the log's TF has
    [rad]."""
    mount_roll_error_rad: float = 0.0
    """How much more it is truly rolled than the TF says [rad]."""
    mount_height_error_m: float = 0.0
    """How much higher it truly is than the TF says [m]."""
    rock_rad: float = 0.0
    """Standard deviation of the true pitch and roll from frame to frame, which the TF doesn't have
    [rad]."""
    sensor: DepthSensor = field(default_factory=DepthSensor)
    """Errors of the depth camera."""
    depth_error: float = 0.0
    """How much of a real camera's errors on real floors is added to ``sensor``
    (:meth:`DepthSensor.with_errors`): 0 nothing, 1 as a D435."""
    exposure: ColorSensor = field(default_factory=ColorSensor)
    """The colour camera's chip, lens and processor."""
    light: LightName = "normal"
    """How bright it is: strong 30 000 lx, normal 500, weaker 120, dim 50."""
    slope_rad: float | None = None
    """Rise of a ramp ahead [rad]; unset: as the scene has it."""
    distance_m: float = 2.0
    """How far the obstacle of the scenes cylinder and approach stands [m]."""
    device: str = "cpu"
    """Where the rays are cast: cpu or cuda; the bytes may differ in single pixels."""
    depth_delay_s: float = 0.0
    """How much later than colour the depth image is taken [s]."""
    odometry_hz: float = 50.0
    """Odometry messages a second; 0: none, so no world coordinates."""
    odometry_drift: float = 0.0
    """Error of the odometry: share of the way, and radians per metre."""
    start_ns: int = 1_700_000_000_000_000_000
    """Stamp of the first colour frame [ns]; at latest a day before ROS 2's seconds end in 2038."""

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
        for name, kept in rules.items():
            if not kept:
                raise ConfigError(f"{name} is out of its range", remedy="see jaxdet sim --help")


def calibration_of(config: SimConfig) -> Calibration:
    """Both cameras at the configured size (the width sets the scale) and how they lie."""
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
