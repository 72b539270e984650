"""Small logs to mutate, one for each form in which images and calibration are written."""

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import numpy as np

from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_INFO,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_INFO,
    DEPTH_K,
    DEPTH_SIZE,
    START,
    T_DEPTH_COLOR,
    LogFile,
    Scene,
    convert_log,
    encode_rvl,
    make_scene,
    ros_compressed,
    ros_image,
    ros_info,
    ros_odometry,
    ros_tf,
    ros_type,
    write_calibration,
)

FRAMES = 8
MOUNT = (0.1, 0.0, 0.3), (-0.5, 0.5, -0.5, 0.5)
"""Position and quaternion of a camera that looks ahead, 0.3 m above the base of the robot."""


class Format(NamedTuple):
    """Form in which a log is written."""

    name: str
    write: Callable[[LogFile, Scene], None]
    options: dict[str, Any]
    suffix: str = ".mcap"
    compress: str | None = None
    """Compression of the chunks of a bag."""

    @property
    def has_crc(self) -> bool:
        """Whether chunks have checksums, so that a changed byte in a chunk must be detected."""
        has = self.options.get("crc", True) and self.options.get("use_chunking", True)
        return has and self.suffix == ".mcap"

    @property
    def is_counted(self) -> bool:
        """Whether the format can record the number of messages."""
        return self.suffix != ""


def _both(log: LogFile, scene: Scene, color: Callable[..., Any], depth: Callable[..., Any]) -> None:
    """Write the calibration, then for each frame poses, a depth image and a colour image."""
    write_calibration(log)
    log.ros("/tf_static", ros_tf(("base_link", DEPTH_FRAME, *MOUNT)), START)
    for number, (c, d, at, depth_at) in enumerate(zip(*scene, strict=True)):
        at, depth_at = int(at), int(depth_at)
        pose = ("odom", "base_link", (0.1 * number, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        log.ros("/odom", ros_odometry(*pose, depth_at), depth_at)
        log.ros("/tf", ros_tf(pose, stamp_ns=depth_at), depth_at)
        depth(log, d, depth_at)
        color(log, c, at)
        log.ros(COLOR_INFO, ros_info(COLOR_SIZE, COLOR_K, at, COLOR_FRAME), at)


def _raw_color(log: LogFile, pixels: np.ndarray, at: int) -> None:
    log.ros(COLOR, ros_image(pixels, "rgb8", at, COLOR_FRAME), at)


def _raw_depth(log: LogFile, pixels: np.ndarray, at: int) -> None:
    log.ros(DEPTH, ros_image(pixels, "16UC1", at, DEPTH_FRAME), at)


def _bgr(log: LogFile, pixels: np.ndarray, at: int) -> None:
    log.ros(COLOR, ros_image(pixels[..., ::-1], "bgr8", at, COLOR_FRAME, padding=3), at)


def _metres(log: LogFile, pixels: np.ndarray, at: int) -> None:
    metres = pixels.astype(np.float32) * np.float32(0.001)
    log.ros(DEPTH, ros_image(metres, "32FC1", at, DEPTH_FRAME, big=True), at)


def _jpeg(log: LogFile, pixels: np.ndarray, at: int) -> None:
    data = cv2.imencode(".jpg", np.ascontiguousarray(pixels[..., ::-1]))[1].tobytes()
    log.ros(COLOR + "/compressed", ros_compressed(data, "jpeg", at, COLOR_FRAME), at)


def _png(log: LogFile, pixels: np.ndarray, at: int) -> None:
    data = struct.pack("<iff", 0, 0, 0) + cv2.imencode(".png", pixels)[1].tobytes()
    message = ros_compressed(data, "16UC1; compressedDepth png", at, DEPTH_FRAME)
    log.ros(DEPTH + "/compressedDepth", message, at)


def _rvl(log: LogFile, pixels: np.ndarray, at: int) -> None:
    data = struct.pack("<iffII", 0, 0, 0, *DEPTH_SIZE) + encode_rvl(pixels)
    message = ros_compressed(data, "16UC1; compressedDepth rvl", at, DEPTH_FRAME)
    log.ros(DEPTH + "/compressedDepth", message, at)


def _ros(color: Callable[..., Any], depth: Callable[..., Any]) -> Callable[..., None]:
    return lambda log, scene: _both(log, scene, color, depth)


def _rgbd(log: LogFile, scene: Scene) -> None:
    log.ros("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, *T_DEPTH_COLOR)), START)
    rgbd = ros_type("realsense2_camera_msgs/msg/RGBD")
    for color, depth, at in zip(scene.color, scene.depth, scene.color_ns.tolist(), strict=True):
        image = ros_image(color, "rgb8", at, COLOR_FRAME)
        message = rgbd(
            image.header,
            ros_info(COLOR_SIZE, COLOR_K, at, COLOR_FRAME),
            ros_info(DEPTH_SIZE, DEPTH_K, at, DEPTH_FRAME),
            image,
            ros_image(depth, "16UC1", at, DEPTH_FRAME),
        )
        log.ros("/cam/rgbd", message, at)


def _json(log: LogFile, scene: Scene) -> None:
    def stamped(at: int, frame: str) -> dict[str, Any]:
        return {"timestamp": {"sec": at // 10**9, "nsec": at % 10**9}, "frame_id": frame}

    def image(pixels: np.ndarray, form: str) -> dict[str, Any]:
        height, width = pixels.shape[:2]
        data = base64.b64encode(pixels.tobytes()).decode()
        step = pixels.nbytes // height
        return {"width": width, "height": height, "encoding": form, "step": step, "data": data}

    def info(size: tuple[int, int], K: tuple[float, ...]) -> dict[str, Any]:
        matrix = [K[0], 0, K[2], 0, K[1], K[3], 0, 0, 1]
        P = [*matrix[:3], 0, *matrix[3:6], 0, *matrix[6:], 0]
        about = {"distortion_model": "plumb_bob", "D": [0.0] * 5, "K": matrix, "P": P}
        return {"width": size[0], "height": size[1], **about, "R": [1, 0, 0, 0, 1, 0, 0, 0, 1]}

    t, q = T_DEPTH_COLOR
    motion = {
        "translation": dict(zip("xyz", t, strict=True)),
        "rotation": dict(zip("xyzw", map(float, q), strict=True)),
        "parent_frame_id": DEPTH_FRAME,
        "child_frame_id": COLOR_FRAME,
    }
    log.json("/tf_static", "foxglove.FrameTransform", stamped(START, "") | motion, START)
    for topic, size, K, frame in (
        (COLOR_INFO, COLOR_SIZE, COLOR_K, COLOR_FRAME),
        (DEPTH_INFO, DEPTH_SIZE, DEPTH_K, DEPTH_FRAME),
    ):
        message = stamped(START, frame) | info(size, K)
        log.json(topic, "foxglove.CameraCalibration", message, START)
    for color, depth, at in zip(scene.color, scene.depth, scene.color_ns.tolist(), strict=True):
        message = stamped(at, DEPTH_FRAME) | image(depth, "16UC1")
        log.json(DEPTH, "foxglove.RawImage", message, at)
        message = stamped(at, COLOR_FRAME) | image(color, "rgb8")
        log.json(COLOR, "foxglove.RawImage", message, at)


_SMALL = {"chunk_size": 9000}
_BARE = {"chunk_size": 9000, "crc": False}
_PLAIN = _ros(_raw_color, _raw_depth)
FORMATS = {
    item.name: item
    for item in (
        Format("raw", _PLAIN, {"compression": "none", **_SMALL}),
        Format("zstd", _PLAIN, {"compression": "zstd", **_SMALL}),
        Format("lz4", _ros(_bgr, _raw_depth), {"compression": "lz4", **_SMALL}),
        Format("metres", _ros(_bgr, _metres), {"compression": "none", **_SMALL}),
        Format("jpeg_png", _ros(_jpeg, _png), {"compression": "none", **_SMALL}),
        Format("jpeg_rvl", _ros(_jpeg, _rvl), {"compression": "zstd", **_SMALL}),
        Format("rgbd", _rgbd, {"compression": "lz4", **_SMALL}),
        Format("json", _json, {"compression": "zstd", **_SMALL}),
        Format("no_crc", _PLAIN, {"compression": "none", **_BARE}),
        Format("no_crc_png", _ros(_jpeg, _png), {"compression": "zstd", **_BARE}),
        Format("no_chunks", _PLAIN, {"use_chunking": False, "crc": False}),
        Format("no_index", _ros(_raw_color, _rvl), {"use_statistics": False, **_SMALL}),
        Format("bag", _PLAIN, {}, ".bag"),
        Format("bag_bz2", _ros(_jpeg, _raw_depth), {}, ".bag", "bz2"),
        Format("bag_lz4", _ros(_bgr, _metres), {}, ".bag", "lz4"),
        Format("db3", _PLAIN, {}, ".db3"),
        Format("db3_jpeg", _ros(_jpeg, _png), {}, ".db3"),
        Format("tum", _PLAIN, {}, ""),
        Format("numbered", _PLAIN, {}, ""),
    )
}


def write_format(name: str, path: Path) -> Path:
    """Write a log of ``FRAMES`` frames to a path with the suffix of the format; return the path."""
    form = FORMATS[name]
    if not form.suffix:
        return _write_images(path, form.name)
    plain = path.with_suffix(".mcap")
    with LogFile(plain, **form.options) as log:
        form.write(log, make_scene(FRAMES))
    if plain == path:
        return path
    with TemporaryDirectory(dir=path.parent) as folder:
        target = Path(folder) / path.name
        file = target.with_suffix("") if form.suffix == ".db3" else target
        converted = convert_log(plain, file, form.compress)
        converted.replace(path)
    plain.unlink()
    return path


def _write_images(folder: Path, name: str) -> Path:
    """Write images and a camera file: in the layout of TUM, or with numbers as file names."""
    scene = make_scene(FRAMES, size=COLOR_SIZE)
    form = ".png" if name == "tum" else ".jpg"
    tables: dict[str, list[str]] = {"rgb.txt": [], "depth.txt": [], "groundtruth.txt": []}
    for part in ("rgb", "depth"):
        (folder / part).mkdir(parents=True)
    for number, (color, depth, at, depth_at) in enumerate(zip(*scene, strict=True)):
        stems = [
            f"{int(ns) / 1e9:.6f}" if name == "tum" else f"{number:04d}" for ns in (at, depth_at)
        ]
        names = f"rgb/{stems[0]}{form}", f"depth/{stems[1]}.png"
        for image, file in zip((np.ascontiguousarray(color[..., ::-1]), depth), names, strict=True):
            assert cv2.imwrite(str(folder / file), image)
        for listed, stem, file in zip(tables, stems, names, strict=False):
            tables[listed].append(f"{stem} {file}\n")
        tables["groundtruth.txt"].append(f"{stems[0]} {number} 0 0.5 0 0 0 1\n")
    for listed, lines in tables.items():
        if name == "tum":
            (folder / listed).write_text("# of a camera\n" + "".join(lines), encoding="utf-8")
    fx, fy, cx, cy = COLOR_K
    camera = {
        "width": COLOR_SIZE[0],
        "height": COLOR_SIZE[1],
        "intrinsic_matrix": [fx, 0, 0, 0, fy, 0, cx, cy, 1],
        "depth_scale": 1000,
    }
    (folder / "camera.json").write_text(json.dumps(camera), encoding="utf-8")
    return folder
