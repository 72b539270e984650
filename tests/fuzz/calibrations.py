"""Runs of small logs with randomly changed, mostly impossible calibrations and poses."""

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np

from jaxdet import preset
from jaxdet.io import LogOptions
from jaxdet.pipeline import BackendName
from jaxdet.types import Distortion
from tests.fuzz.case import Case, Verdict, ended
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_INFO,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_INFO,
    SECOND,
    START,
    LogFile,
    ros_image,
    ros_info,
    ros_odometry,
    ros_tf,
    ros_type,
)
from tests.runs import run_logs
from tests.scenes import blocks, small, smooth_depth

FRAMES = 2
TABLES = "frames.parquet", "obstacles.parquet"
CAMERAS = small(96, 60)
IMAGES = blocks(FRAMES, 60, 96), smooth_depth(FRAMES, CAMERAS.depth)
ODD = (
    math.nan, math.inf, 0.0, -0.0, 5e-324, 1e-45, 1e-39, 1e-7, 1e-3, 1.0, 2.0, 1e2, 1e3, 1e5, 1e6,
    1e9, 1e14, 1e38, 1e39, 1.7e308, 2.0**31, 2.0**32, 2.0**63,
)  # fmt: skip
MODELS = (
    *Distortion,
    "",
    "fisheye",
    "kannala_brandt4",
    "PLUMB BOB",
    "ftheta",
    "x" * 300,
    "\x1b[1m",
)
SIZES = (0, 1, 2, 95, 97, 4096, 4097, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
PRESETS = "wheeled", "wheeled", "tabletop", "paper"


class Camera(NamedTuple):
    """Contents of a CameraInfo message."""

    width: int
    height: int
    K: tuple[float, ...]
    model: str
    D: tuple[float, ...]
    P: tuple[float, ...]


class Made(NamedTuple):
    """Calibration and poses of a log, from its messages or from flags."""

    color: Camera
    depth: Camera
    t: tuple[float, ...]
    """Translation of ``T_color_depth`` [m]."""
    R: tuple[float, ...]
    """Rotation of ``T_color_depth``, 9 numbers, row-major."""
    q: tuple[float, ...]
    """Rotation of ``T_color_depth`` as a quaternion, for TF and flags."""
    mount: tuple[float, ...]
    """Position and quaternion of the depth camera on the robot."""
    pose: tuple[float, ...]
    """Position and quaternion of the robot in the world."""
    unit: float
    """Depth unit [m]."""


def _camera(camera: Any) -> Camera:
    k = (camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0)
    return Camera(
        camera.width, camera.height, k, "plumb_bob", (0.0,) * 5, (*k[:3], 0, *k[3:6], 0, *k[6:], 0)
    )


PLAIN = Made(
    _camera(CAMERAS.color),
    _camera(CAMERAS.depth),
    CAMERAS.color_from_depth.translation,
    CAMERAS.color_from_depth.rotation,
    (0.0, 0.0, 0.0, 1.0),
    (0.1, 0.0, 0.4, -0.5, 0.5, -0.5, 0.5),
    (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    0.001,
)


def _number(value: float, random: Random) -> float:
    """Return another number: an extreme one from ``ODD``, or one near the value."""
    how = random.random()
    if how < 0.6:
        return random.choice(ODD) * random.choice((1, 1, -1))
    return value * 10 ** random.uniform(-2, 2) if how < 0.8 else value + random.gauss(0, 1)


def _numbers(values: tuple[float, ...], random: Random) -> tuple[float, ...]:
    """Return the values with one or more of them changed, or without the last ones."""
    if not values or random.random() < 0.1:
        return values[: random.randrange(len(values) + 1)]
    found = list(values)
    for _ in range(random.choice((1, 1, 2, len(found)))):
        place = random.randrange(len(found))
        found[place] = _number(found[place], random)
    return tuple(found)


def _unit(random: Random) -> tuple[float, ...]:
    """Return a random quaternion of unit length."""
    q = np.array([random.gauss(0, 1) for _ in range(4)])
    return tuple((q / np.linalg.norm(q)).tolist())


def _changed_camera(camera: Camera, random: Random) -> tuple[Camera, str]:
    part = random.choice(("K", "K", "K", "D", "D", "D", "P", "size"))
    if part == "D":
        scale = 10 ** random.uniform(-4, 3)
        count = random.choice((0, 1, 4, 4, 5, 5, 5, 8, 8, 9, 12, 14, 1000))
        D = tuple(random.gauss(0, scale) for _ in range(count))
        D = _numbers(D, random) if D and random.random() < 0.4 else D
        return camera._replace(model=random.choice(MODELS), D=D), "lens"
    if part == "size":
        size = {name: random.choice(SIZES) for name in ("width", "height") if random.random() < 0.6}
        return camera._replace(**size), "size"
    return camera._replace(**{part: _numbers(getattr(camera, part), random)}), part


def changed(way: str, random: Random) -> tuple[Made, str]:
    """Return a calibration with one to three changed parts, and their names; ``way`` uses them."""
    made, names = PLAIN, []
    for _ in range(random.choice((1, 1, 2, 3))):
        part = random.choice(USED[way])
        if part in ("color", "depth"):
            value, name = _changed_camera(getattr(made, part), random)
            name = f"{part}.{name}"
        elif part == "unit":
            value, name = _number(made.unit, random), part
        elif part == "q" and random.random() < 0.4:
            value, name = _unit(random), "turned"
        else:
            value, name = _numbers(getattr(made, part), random), part
        names.append(name)
        made = made._replace(**{part: value})
    return made, "+".join(names)


def _seven(values: tuple[float, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    whole = (*values, *(0.0,) * 7)
    return whole[:3], whole[3:7]


def _info(camera: Camera, at: int, frame: str) -> Any:
    """Return a CameraInfo; K and P are padded with zeros or truncated to their fixed lengths."""
    size = camera.width, camera.height
    message = ros_info(size, (1.0, 1.0, 0.0, 0.0), at, frame, camera.model, camera.D)
    K, P = (np.zeros(count) for count in (9, 12))
    for array, values in ((K, camera.K), (P, camera.P)):
        array[: len(values)] = values[: len(array)]
    return replace(message, k=K, p=P)


def _by_tf(log: LogFile, made: Made) -> None:
    _infos(log, made)
    t, q = _seven((*made.t, *made.q) if len(made.t) == 3 else made.t)
    log.ros("/tf_static", ros_tf((COLOR_FRAME, DEPTH_FRAME, t, q)), START)


def _by_topic(log: LogFile, made: Made) -> None:
    _infos(log, made)
    kind = ros_type("realsense2_camera_msgs/msg/Extrinsics")
    R, t = np.zeros(9), np.zeros(3)
    R[: len(made.R)], t[: len(made.t)] = made.R, made.t
    log.ros("/cam/extrinsics/depth_to_color", kind(R, t), START)
    log.ros("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, (0, 0, 0), (0, 0, 0, 1))), START)


def _infos(log: LogFile, made: Made) -> None:
    log.ros(COLOR_INFO, _info(made.color, START, COLOR_FRAME), START)
    log.ros(DEPTH_INFO, _info(made.depth, START, DEPTH_FRAME), START)
    unit = ros_type("std_msgs/msg/Float32")
    with np.errstate(over="ignore"):
        log.ros("/cam/depth/option/Depth Units/value", unit(float(np.float32(made.unit))), START)


def _by_flags(log: LogFile, made: Made) -> None:
    _infos(log, PLAIN)


def _aligned(log: LogFile, made: Made) -> None:
    log.ros(COLOR_INFO, _info(made.color, START, COLOR_FRAME), START)


WAYS: dict[str, Callable[[LogFile, Made], None]] = {
    "tf": _by_tf,
    "topic": _by_topic,
    "flags": _by_flags,
    "aligned": _aligned,
}


_CAMERAS = "color", "color", "depth", "depth", "unit", "t"
USED = {
    "tf": (*_CAMERAS, "t", "q", "q", "mount", "pose"),
    "topic": (*_CAMERAS, "t", "R", "R", "mount", "pose"),
    "flags": (*_CAMERAS, "q"),
    "aligned": ("color", "color", "color", "unit", "mount", "pose"),
}


def _options(way: str, made: Made, random: Random) -> LogOptions:
    """Return options of the log; raises ConfigError for options that are refused."""
    if way == "aligned":
        return LogOptions(depth_aligned=True, depth_unit_m=made.unit)
    if way != "flags":
        return LogOptions(scan=random.random() < 0.5)
    matrices = [
        (*camera.K, *(0.0,) * 9)[:5:4] + (*camera.K, *(0.0,) * 9)[2:6:3]
        for camera in (made.color, made.depth)
    ]
    known = [camera.model if camera.model in tuple(Distortion) else None for camera in made[:2]]
    t, q = _seven((*made.t[:3], *(0.0,) * (3 - len(made.t[:3])), *made.q[:4]))
    return LogOptions(
        color_intrinsics=matrices[0],
        depth_intrinsics=matrices[1],
        color_distortion=known[0],
        depth_distortion=known[1],
        color_from_depth=(*t, *q),
        depth_unit_m=made.unit,
    )


class Calibrations:
    """Run logs with mutated calibrations.

    Args:
        folder: Folder for logs and results.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for way in ("tf", "aligned"):  # so that verdicts do not include compilation
            for name in dict.fromkeys(PRESETS):
                options = _options(way, PLAIN, Random(0))
                verdict, _ = self._results(self.write(PLAIN, way), options, name, "jax")
                assert verdict.kind == "clean", verdict

    def one(self, seed: int) -> Case:
        """Run the log of a seed; compare some logs with the reference."""
        random = Random(seed)
        way = random.choice(list(WAYS))
        made, what = changed(way, random)
        path = self.write(made, way)
        title = f"{way} {what} seed {seed}"
        verdict = ended(lambda: self._run(path, made, way, random))
        return Case(title, verdict, {path.name: path.read_bytes()})

    def write(self, made: Made, way: str) -> Path:
        """Write a log of two frames; return its path."""
        path = self._folder / "x.mcap"
        with LogFile(path, compression="none") as log:
            WAYS[way](log, made)
            log.ros("/tf_static", ros_tf(("base_link", DEPTH_FRAME, *_seven(made.mount))), START)
            depth_topic = "/cam/aligned_depth_to_color/image_raw" if way == "aligned" else DEPTH
            depth_frame = COLOR_FRAME if way == "aligned" else DEPTH_FRAME
            for number in range(FRAMES):
                at = START + number * SECOND // 10
                pose = ("odom", "base_link", *_seven(made.pose), at)
                log.ros("/odom", ros_odometry(*pose), at)
                log.ros(depth_topic, ros_image(IMAGES[1][number], "16UC1", at, depth_frame), at)
                log.ros(COLOR, ros_image(IMAGES[0][number], "rgb8", at, COLOR_FRAME), at)
        return path

    def _run(self, path: Path, made: Made, way: str, random: Random) -> Verdict:
        options, name = _options(way, made, random), random.choice(PRESETS)
        verdict, tables = self._results(path, options, name, "jax", random.randrange(4) // 3)
        if tables and random.random() < 0.15:
            _, again = self._results(path, options, name, "reference")
            if again != tables:
                return Verdict("wrong results", f"{name}: the reference finds something else")
        return verdict

    def _results(
        self,
        path: Path,
        options: LogOptions,
        name: str,
        backend: BackendName,
        pictures: int = 0,
    ) -> tuple[Verdict, list[bytes]]:
        output = self._folder / "out"
        try:
            how = {"backend": backend, "batch_size": FRAMES, "pictures": pictures, "workers": 1}
            summary = run_logs(path, output, preset(name), log=options, **how)
            [log] = summary.logs
            if log.error:
                ours = "a fault of jaxdet" in log.error or not log.error.isprintable()
                reports = [file.read_text("utf-8") for file in output.glob("*/report*")]
                kind = "crash" if ours else "error"
                return Verdict(kind, "\n".join([log.error, *reports])), []
            if sum(log.status.values()) != FRAMES:
                return Verdict("silently lost", str(log.status)), []
            kind = "clean" if set(log.status) == {"ok"} else "frames"
            tables = [next(output.glob(f"*/{one}")).read_bytes() for one in TABLES]
            return Verdict(kind, str(log.status)), tables
        finally:
            shutil.rmtree(output, ignore_errors=True)
