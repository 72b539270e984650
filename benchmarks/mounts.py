"""Mount of the simulator's depth camera; its configuration contains that of the colour camera."""

from jaxdet.floor.plane import plane_from_transform
from jaxdet.sim import SimConfig
from jaxdet.sim.config import calibration_of
from jaxdet.sim.robot import mount
from jaxdet.types import GroundPlane


def depth_plane(config: SimConfig) -> GroundPlane:
    """Return the floor relative to the depth camera according to the log's TF, ``B = 1``."""
    T = mount(config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad)
    motion = calibration_of(config).color_from_depth
    return plane_from_transform(T if motion is None else T @ motion.T)
