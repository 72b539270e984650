"""The simulation itself: one frame after the other, each from the seed and its number alone."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxdet.sim.config import SimConfig, calibration_of
from jaxdet.sim.raycast import cast
from jaxdet.sim.render import Rendering, render
from jaxdet.sim.robot import mount, pose_at
from jaxdet.sim.scene import Scene
from jaxdet.sim.scenes import load_scene
from jaxdet.sim.sensor import expose_color, measure_depth


class SimFrame(NamedTuple):
    """What the cameras deliver at one time, and the truth about it."""

    number: int
    """0-based number in the log."""
    stamp_ns: int
    """Of the colour image [ns]."""
    depth_stamp_ns: int
    color: np.ndarray
    """``(H, W, 3)`` uint8, RGB."""
    depth: np.ndarray | None
    """``(H, W)`` uint16 [mm] on the depth camera's rays; None in the form ``aligned``."""
    aligned: np.ndarray | None
    """``(H, W)`` uint16 [mm] on the colour camera's rays, in the forms ``aligned``, ``both``."""
    T_world_color: np.ndarray
    """``(4, 4)`` float64, colour optical frame to world, exact."""
    truth: Rendering
    """The ideal picture of the colour camera."""


def simulate(config: SimConfig) -> Iterator[SimFrame]:
    """Simulate a log.

    Args:
        config: The scene and the recording.

    Yields:
        Its frames in order. Frame i is the same however many are asked for.

    Raises:
        ConfigError: The scene is not known.
        InputError: The scene's file can't be read.
    """
    scene = load_scene(config.scene)
    for index in range(config.frames):
        yield simulate_frame(config, scene, index)


def simulate_frame(config: SimConfig, scene: Scene, index: int) -> SimFrame:
    """Frame ``index`` of a log; its noise depends on the seed and the index only."""
    calibration = calibration_of(config)
    time_s = index / config.rate_hz
    T_world_color = color_pose(config, scene, time_s)
    truth = render(scene, calibration.color, T_world_color, config.seed)
    color = expose_color(truth.color, _rng(config, index, 0), config.color_noise)
    depth = aligned = None
    if config.depth_form != "aligned":
        assert calibration.depth is not None and calibration.color_from_depth is not None
        T = color_pose(config, scene, time_s + config.depth_delay_s)
        z = cast(scene, calibration.depth, T @ calibration.color_from_depth.T).depth
        depth = measure_depth(z, calibration.depth, config.sensor, _rng(config, index, 1))
    if config.depth_form in ("aligned", "both"):
        rng = _rng(config, index, 2)
        aligned = measure_depth(truth.depth, calibration.color, config.sensor, rng)
    stamp_ns = config.start_ns + round(time_s * 1e9)
    delay_ns = round(config.depth_delay_s * 1e9)
    return SimFrame(
        index, stamp_ns, stamp_ns + delay_ns, color, depth, aligned, T_world_color, truth
    )


def color_pose(config: SimConfig, scene: Scene, time_s: float) -> np.ndarray:
    """``T_world_color`` ``(4, 4)`` float64 at a time since the first frame."""
    height, pitch, roll = config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad
    return pose_at(scene.path, time_s).T @ mount(height, pitch, roll)


def _rng(config: SimConfig, index: int, stream: int) -> np.random.Generator:
    return np.random.default_rng([config.seed, index, stream])
