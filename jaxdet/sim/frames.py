"""Parallel simulation of frames; a frame does not depend on the frames before it."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np

from jaxdet.cores import cores
from jaxdet.floor.plane import flat_plane
from jaxdet.sim.config import SimConfig, calibration_of
from jaxdet.sim.exposure import LIGHTS, expose, reflectance_of
from jaxdet.sim.ground import standing
from jaxdet.sim.render import Rendering, render
from jaxdet.sim.robot import mount, pose_at, velocity_at
from jaxdet.sim.scene import Scene
from jaxdet.sim.scenes import scene_of
from jaxdet.sim.sensor import Surface, measure_depth
from jaxdet.types import GroundPlane, Intrinsics

_MOST_THREADS = 8
"""Maximum number of frames that are simulated at once; each takes 40 MB."""


class SimFrame(NamedTuple):
    """Images of both cameras at a point in time, and their ground truth."""

    number: int
    """Number in the log, from 0."""
    stamp_ns: int
    """Timestamp of the colour image [ns]."""
    depth_stamp_ns: int
    """Timestamp of the depth image [ns]."""
    color: np.ndarray
    """Colour image ``(H, W, 3)`` uint8, RGB."""
    depth: np.ndarray | None
    """Depth image of the depth camera, ``(H, W)`` uint16 [mm]; None in the form ``aligned``."""
    aligned: np.ndarray | None
    """Depth image aligned to colour, ``(H, W)`` uint16 [mm], in the forms ``aligned``, ``both``."""
    T_world_color: np.ndarray
    """Exact pose of the colour optical frame in the world, ``(4, 4)`` float64."""
    T_world_base: np.ndarray
    """Exact pose of the robot (base_footprint) in the world, ``(4, 4)`` float64."""
    truth: Rendering
    """Image of the colour camera without sensor errors."""
    scene: Scene
    """Scene that the frame shows."""
    config: SimConfig
    """Parameters of the simulation."""
    time_s: float
    """Time since the first frame [s]."""
    mount: tuple[float, float, float]
    """True height [m], pitch and roll [rad] of the colour camera above the base."""

    @property
    def plane(self) -> GroundPlane:
        """Floor computed from the mount in the log's TF, which has errors; ``B`` = 1."""
        config = self.config
        mount = config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad
        return flat_plane(*mount)


def simulate(config: SimConfig) -> Iterator[SimFrame]:
    """Simulate a log, one frame per core at a time.

    Args:
        config: Scene and recording.

    Yields:
        Frames in order. Frame i does not depend on the number of frames.

    Raises:
        ConfigError: The scene is unknown.
        InputError: The scene's file can't be read.
    """
    scene, threads = scene_of(config), min(cores(), _MOST_THREADS)
    waiting: deque[Future[SimFrame]] = deque()
    pool = ThreadPoolExecutor(threads, "jaxdet-sim")
    try:
        for index in range(config.frames):
            waiting.append(pool.submit(simulate_frame, config, scene, index))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        for frame in waiting:
            yield frame.result()
    finally:
        pool.shutdown(cancel_futures=True)


def simulate_frame(config: SimConfig, scene: Scene, index: int) -> SimFrame:
    """Simulate frame ``index`` of a log; its noise depends only on the seed and the index."""
    calibration = calibration_of(config)
    time_s = index / config.rate_hz
    T_world_base = base_pose(scene, time_s)
    mounted = true_mount(config, index)
    T_world_color = T_world_base @ mount(*mounted)
    truth = ideal_view(config, scene, calibration.image, T_world_color, time_s)
    light, cos_floor = LIGHTS[config.light], _cos_floor(scene)
    turn = abs(velocity_at(scene.path, time_s)[1]) if scene.path.length > 0 else 0.0
    smear = turn * calibration.image.fx * config.exposure.max_exposure_s
    color = expose(
        (truth.color, truth.light), calibration.image, light, cos_floor, config.exposure,
        _rng(config, index, 0), smear,
    )  # fmt: skip
    depth = aligned = None
    if config.depth_form != "aligned":
        assert calibration.color_from_depth is not None
        later = time_s + config.depth_delay_s
        T = base_pose(scene, later) @ mount(*mounted) @ calibration.color_from_depth.T
        view = ideal_view(config, scene, calibration.depth, T, later, shadows=False)
        depth = _measure(view, calibration.depth, config, _rng(config, index, 1))
    if config.depth_form in ("aligned", "both"):
        aligned = _measure(truth, calibration.image, config, _rng(config, index, 2))
    stamp_ns = config.start_ns + round(time_s * 1e9)
    delay_ns = round(config.depth_delay_s * 1e9)
    return SimFrame(
        index, stamp_ns, stamp_ns + delay_ns, color, depth, aligned, T_world_color, T_world_base,
        truth, scene, config, time_s, mounted,
    )  # fmt: skip


def ideal_view(
    config: SimConfig,
    scene: Scene,
    camera: Intrinsics,
    T_world_camera: np.ndarray,
    time_s: float,
    *,
    shadows: bool = True,
) -> Rendering:
    """Render the image of a camera without sensor errors, ``time_s`` after the first frame [s]."""
    light = config.light if shadows else None
    return render(
        scene, camera, T_world_camera, seed=config.seed, time_s=time_s, light=light,
        device=config.device,
    )  # fmt: skip


def base_pose(scene: Scene, time_s: float) -> np.ndarray:
    """Return the robot's pose ``T_world_base``, ``(4, 4)`` float64, on the ground at a time [s]."""
    pose = pose_at(scene.path, time_s)
    return standing(scene.ground, pose.x, pose.y) @ pose.T


def _measure(
    view: Rendering, camera: Intrinsics, config: SimConfig, rng: np.random.Generator
) -> np.ndarray:
    """Simulate the depth image of a view; light is uniform for the infrared cameras."""
    sensor = config.sensor.with_errors(config.depth_error) if config.depth_error else config.sensor
    if not sensor.enabled:
        return measure_depth(view.depth, camera, sensor, rng)
    reflectance = cv2.cvtColor(reflectance_of(view.color), cv2.COLOR_RGB2GRAY)
    gloss = view.gloss if view.behind is None else np.where(np.isnan(view.behind), view.gloss, 0)
    lux = LIGHTS[config.light].lux
    surface = Surface(reflectance, gloss, view.light[..., 2], lux, view.mirrored, view.behind)
    return measure_depth(view.depth, camera, sensor, rng, surface, specimen=config.seed)


def true_mount(config: SimConfig, index: int) -> tuple[float, float, float]:
    """Return true height [m], pitch and roll [rad] of the colour camera in a frame.

    They are the configured values, plus the mount's errors and the rocking of the robot.
    """
    pitch, roll = 0.0, 0.0
    if config.rock_rad:
        pitch, roll = (config.rock_rad * _rng(config, index, 3).standard_normal(2)).tolist()
    return (
        config.camera_height_m + config.mount_height_error_m,
        config.camera_pitch_rad + config.mount_pitch_error_rad + pitch,
        config.camera_roll_rad + config.mount_roll_error_rad + roll,
    )


def _cos_floor(scene: Scene) -> float:
    lamp = np.asarray(scene.light.direction)
    return max(float(lamp[2] / np.linalg.norm(lamp)), 0.1)


def _rng(config: SimConfig, index: int, stream: int) -> np.random.Generator:
    return np.random.default_rng([config.seed, index, stream])
