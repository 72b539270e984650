"""Writer of simulated logs, with the topic and frame names of ``realsense2_camera`` 4.x."""

from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxdet.io.writer import Ros2LogWriter, Transform
from jaxdet.sim.config import SimConfig, calibration_of
from jaxdet.sim.frames import SimFrame, simulate
from jaxdet.sim.robot import OPTICAL, WHEEL_RADIUS_M, drifted, mount, pose_at, velocity_at
from jaxdet.sim.scene import Scene
from jaxdet.sim.scenes import scene_of
from jaxdet.sim.truth import Truth, TruthWriter, truth_path
from jaxdet.types import Calibration, Intrinsics
from jaxdet.warp_start import start_warp

NAMESPACE = "/camera/camera"
COLOR_FRAME = "camera_color_optical_frame"
DEPTH_FRAME = "camera_depth_optical_frame"


def write_log(
    path: str | Path,
    config: SimConfig | None = None,
    progress: Callable[[int], None] | None = None,
) -> Truth:
    """Simulate a log and write it as a ROS 2 MCAP file, with its ground truth next to it.

    Args:
        path: Log; the ground truth goes to ``<path>.truth.npz`` (:mod:`jaxdet.sim.truth`).
        config: Parameters of the simulation.
        progress: Called with the number of written frames after each frame.

    Returns:
        The ground truth.

    Raises:
        ConfigError: The scene is unknown.
        InputError: The scene's file can't be read.
    """
    config = config or SimConfig()
    start_warp()  # keep standard output clean for the caller
    scene, calibration = scene_of(config), calibration_of(config)
    with (
        TruthWriter(truth_path(path), config, scene) as truth,
        Ros2LogWriter(path, config.compression) as writer,
    ):
        _write_static(writer, config, calibration)
        odometry = _odometry_times(config)
        for frame in simulate(config):
            while odometry and odometry[0] <= frame.time_s:
                _write_odometry(writer, config, scene, odometry.popleft())
            _write_frame(writer, config, calibration, frame)
            truth.add(frame)
            if progress:
                progress(frame.number + 1)
        for time_s in odometry:
            _write_odometry(writer, config, scene, time_s)
        return truth.finish()


def _odometry_times(config: SimConfig) -> deque[float]:
    """Return the times of odometry messages [s]: from before the first frame to after the last."""
    if config.odometry_hz == 0:
        return deque()
    step = 1 / config.odometry_hz
    end = (config.frames - 1) / config.rate_hz + max(config.depth_delay_s, 0.0) + step
    return deque(np.arange(-0.3 * step, end, step).tolist())


def _write_odometry(writer: Ros2LogWriter, config: SimConfig, scene: Scene, time_s: float) -> None:
    stamp_ns = config.start_ns + round(time_s * 1e9)
    pose = drifted(pose_at(scene.path, time_s), config.odometry_drift)
    transform = Transform("odom", "base_footprint", pose.T)
    writer.write_odometry("/odom", stamp_ns, transform, velocity_at(scene.path, time_s))
    writer.write_transforms(stamp_ns, [transform])


def static_transforms(config: SimConfig, calibration: Calibration) -> list[Transform]:
    """Return the static transforms in TF: the camera driver's and, if ``mount_tf``, the mount."""
    optical = np.eye(4)
    optical[:3, :3] = OPTICAL
    assert calibration.color_from_depth is not None
    T_depth_color = np.linalg.inv(calibration.color_from_depth.T)
    tree = [Transform("camera_link", "camera_depth_frame", np.eye(4))]
    tree += [Transform("camera_depth_frame", DEPTH_FRAME, optical)]
    tree += [Transform("camera_color_frame", COLOR_FRAME, optical)]
    if config.extrinsics in ("tf", "both"):
        T_link_color = optical @ T_depth_color @ np.linalg.inv(optical)
        tree.append(Transform("camera_link", "camera_color_frame", T_link_color))
    if config.mount_tf:
        height, pitch, roll = (
            config.camera_height_m, config.camera_pitch_rad, config.camera_roll_rad,
        )  # fmt: skip
        base = np.eye(4)
        base[2, 3] = WHEEL_RADIUS_M
        T_foot_color = mount(height, pitch, roll)
        T_foot_link = T_foot_color @ np.linalg.inv(optical @ T_depth_color)
        tree.append(Transform("base_footprint", "base_link", base))
        tree.append(Transform("base_link", "camera_link", np.linalg.inv(base) @ T_foot_link))
    return tree


def _write_static(writer: Ros2LogWriter, config: SimConfig, calibration: Calibration) -> None:
    writer.write_transforms(config.start_ns, static_transforms(config, calibration), static=True)
    if config.extrinsics in ("topic", "both") and calibration.color_from_depth is not None:
        topic = f"{NAMESPACE}/extrinsics/depth_to_color"
        writer.write_extrinsics(topic, config.start_ns, calibration.color_from_depth)


def _write_frame(
    writer: Ros2LogWriter, config: SimConfig, calibration: Calibration, frame: SimFrame
) -> None:
    def put(
        name: str, stamp_ns: int, frame_id: str, camera: Intrinsics, image: np.ndarray, form: str
    ) -> None:
        topic = f"{NAMESPACE}/{name}"
        info = f"{topic.rpartition('/')[0]}/camera_info"
        writer.write_image(topic, stamp_ns, frame_id, image, form)
        writer.write_camera_info(info, stamp_ns, frame_id, camera)

    stamp, delayed = frame.stamp_ns, frame.depth_stamp_ns
    put("color/image_raw", stamp, COLOR_FRAME, calibration.image, frame.color, "rgb8")
    if frame.depth is not None:
        metres = config.depth_form == "metres"
        image = frame.depth * np.float32(0.001) if metres else frame.depth
        form = "32FC1" if metres else "16UC1"
        put("depth/image_rect_raw", delayed, DEPTH_FRAME, calibration.depth, image, form)
    if frame.aligned is not None:
        name = "aligned_depth_to_color/image_raw"
        put(name, delayed, COLOR_FRAME, calibration.image, frame.aligned, "16UC1")
