"""Where the simulator's depth camera is mounted; its configuration states the colour camera's."""

from jaxdet.floor.plane import plane_from_transform
from jaxdet.sim import SimConfig
from jaxdet.sim.config import calibration_of
from jaxdet.sim.robot import mount
from jaxdet.types import GroundPlane


def depth_plane(config: SimConfig) -> GroundPlane:
    """The floor seen from the depth camera as the log's TF has it, ``B = 1``."""
    T = mount(config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad)
    motion = calibration_of(config).color_from_depth
    return plane_from_transform(T if motion is None else T @ motion.T)
