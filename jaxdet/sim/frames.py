"""The simulation itself: each frame from the seed and its number alone, so several at a time."""

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
"""Frames that are simulated at a time; each takes 40 MB."""


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
    T_world_base: np.ndarray
    """``(4, 4)`` float64, robot (base_footprint) to world, exact."""
    truth: Rendering
    """The ideal picture of the colour camera."""
    scene: Scene
    """What is looked at."""
    config: SimConfig
    """How."""
    time_s: float
    """Since the first frame [s]."""
    mount: tuple[float, float, float]
    """True height [m], pitch and roll [rad] of the colour camera over the base."""

    @property
    def plane(self) -> GroundPlane:
        """The floor, ``B`` = 1, as the log's TF has it: without the mount's errors."""
        config = self.config
        told = config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad
        return flat_plane(*told)


def simulate(config: SimConfig) -> Iterator[SimFrame]:
    """Simulate a log, a frame on each core.

    Args:
        config: The scene and the recording.

    Yields:
        Its frames in order. Frame i is the same however many are asked for.

    Raises:
        ConfigError: The scene is not known.
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
    """Frame ``index`` of a log; its noise depends on the seed and the index only."""
    calibration = calibration_of(config)
    time_s = index / config.rate_hz
    T_world_base = base_pose(scene, time_s)
    mounted = true_mount(config, index)
    T_world_color = T_world_base @ mount(*mounted)
    truth = look(config, scene, calibration.image, T_world_color, time_s)
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
        view = look(config, scene, calibration.depth, T, later, shadows=False)
        depth = _measure(view, calibration.depth, config, _rng(config, index, 1))
    if config.depth_form in ("aligned", "both"):
        aligned = _measure(truth, calibration.image, config, _rng(config, index, 2))
    stamp_ns = config.start_ns + round(time_s * 1e9)
    delay_ns = round(config.depth_delay_s * 1e9)
    return SimFrame(
        index, stamp_ns, stamp_ns + delay_ns, color, depth, aligned, T_world_color, T_world_base,
        truth, scene, config, time_s, mounted,
    )  # fmt: skip


def look(
    config: SimConfig,
    scene: Scene,
    camera: Intrinsics,
    T_world_camera: np.ndarray,
    time_s: float,
    *,
    shadows: bool = True,
) -> Rendering:
    """The ideal picture of one of the cameras at a time."""
    light = config.light if shadows else None
    return render(
        scene, camera, T_world_camera, seed=config.seed, time_s=time_s, light=light,
        device=config.device,
    )  # fmt: skip


def base_pose(scene: Scene, time_s: float) -> np.ndarray:
    """``T_world_base`` ``(4, 4)`` float64 at a time since the first frame: on the ground."""
    pose = pose_at(scene.path, time_s)
    return standing(scene.ground, pose.x, pose.y) @ pose.T


def _measure(
    view: Rendering, camera: Intrinsics, config: SimConfig, rng: np.random.Generator
) -> np.ndarray:
    """The depth image; the infrared cameras see the surfaces in even light."""
    sensor = config.sensor.with_errors(config.depth_error) if config.depth_error else config.sensor
    if not sensor.enabled:
        return measure_depth(view.depth, camera, sensor, rng)
    reflectance = cv2.cvtColor(reflectance_of(view.color), cv2.COLOR_RGB2GRAY)
    gloss = view.gloss if view.behind is None else np.where(np.isnan(view.behind), view.gloss, 0)
    lux = LIGHTS[config.light].lux
    surface = Surface(reflectance, gloss, view.light[..., 2], lux, view.mirrored, view.behind)
    return measure_depth(view.depth, camera, sensor, rng, surface, specimen=config.seed)


def true_mount(config: SimConfig, index: int) -> tuple[float, float, float]:
    """Height [m], pitch and roll [rad] of the colour camera in a frame: what the configuration
    says, its errors, and how the robot rocks."""  # noqa: D205, D209
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
