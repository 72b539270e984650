"""The whole pipeline: against the NumPy reference and a hand-written one, and its throughput."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from multiprocessing import get_context
from typing import Any

import cv2
import jax
import numpy as np
from sklearn.cluster import DBSCAN

from benchmarks.run import Case, Metric, check_equal
from benchmarks.scene import BATCH, CALIBRATIONS, CONFIG, frames_of, pin
from benchmarks.sweep import Point
from jaxdet.config import Config
from jaxdet.floor.plane import flat_plane, floor_limits
from jaxdet.pipeline import detect
from jaxdet.presets import preset
from jaxdet.stages._spread import on_cuda, rows_over
from jaxdet.stages._upload import Uploader
from jaxdet.types import Detections, Frames

SIZE = "640x480"
BATCHES = {SIZE: 1024, "1080p": 256, "lens": 512}
"""Frames of a batch on each GPU."""


def cases() -> list[Case]:
    """Frames in memory: the default and the paper's setting, beside both peers."""
    frames = frames_of(SIZE, 4 * BATCH)
    found = []
    for name, config in (("default", CONFIG), ("paper", preset("paper"))):
        case = Case(
            name=f"{name}.reference",
            run=lambda config=config: detect(frames, config),
            frames=4 * BATCH,
            peer=lambda config=config: detect(frames, config, backend="reference"),
            equal=True,
        )
        found.append(case)
    found += [_at_size(size) for size in ("1080p", "lens")]
    many = frames_of(SIZE, 16 * BATCH)
    peer = partial(handwritten, many)
    found.append(Case("vs_handwritten", lambda: detect(many, CONFIG), 16 * BATCH, peer))
    return found


def at(point: Point) -> Case:
    """Images on the device."""
    frames = frames_of(point.size, point.batch)
    color, depth = jax.device_put((frames.color, frames.depth))
    frames = frames._replace(color=color, depth=depth)
    config = replace(CONFIG, features=replace(CONFIG.features, max_corners=point.slots))
    return Case(
        name=point.name,
        run=lambda: detect(frames, config),
        frames=point.batch,
        bytes_read=color.nbytes + depth.nbytes,
    )


def _at_size(size: str) -> Case:
    """The default on a larger image or a lens; the reference takes two of the frames."""
    frames = frames_of(size, BATCH)
    few = frames_of(size, 2)
    return Case(
        name=f"{size}.reference",
        run=lambda: detect(frames, CONFIG),
        frames=BATCH,
        peer=lambda: detect(few, CONFIG, backend="reference"),
        peer_frames=2,
        equal=True,
        compared=lambda found: jax.tree.map(lambda values: values[:2], found),
    )


def handwritten(frames: Frames) -> list[np.ndarray]:
    """What a good engineer would write: OpenCV and scikit-learn, frame by frame, on all cores."""
    work = list(zip(frames.color, frames.depth, strict=True))
    return list(_pool().map(_one_frame, work, chunksize=2))


@cache
def _pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(
        mp_context=get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    )


@cache
def _limit() -> np.ndarray:
    calibration = CALIBRATIONS[SIZE]
    plane = flat_plane(*(np.array([a]) for a in (0.35, 0.15, 0.0)))
    return floor_limits(calibration.color, plane, CONFIG.ground, 0.001)[0][0]


def _one_frame(images: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    color, depth = images
    calibration = CALIBRATIONS[SIZE]
    assert calibration.depth is not None and calibration.color_from_depth is not None
    camera = calibration.color
    motion = calibration.color_from_depth.T
    size, none = (camera.width, camera.height), np.zeros(4)
    aligned = cv2.registerDepth(
        calibration.depth.K, camera.K, none, motion, depth, size, depthDilation=True
    )
    keep = (aligned >= 150) & (aligned <= 4000) & (aligned <= _limit())
    edges = cv2.Canny(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), 100, 200)
    corners = cv2.goodFeaturesToTrack(edges, 1000, 0.01, 5, mask=keep.astype(np.uint8))
    if corners is None:
        return np.zeros(0, int)
    u, v = corners[:, 0].astype(int).T
    z = aligned[v, u] * 0.001
    points = np.column_stack([(u - camera.cx) * z / camera.fx, z])
    return DBSCAN(eps=0.1, min_samples=5).fit_predict(points)


def throughput(seconds: float) -> list[Metric]:
    """Frames per second of the default and the paper's setting, of 1080p and of a lens.

    On GPUs all of them are used, and frames lie on them or come from pinned host memory.
    """
    runs = {
        "pipeline": (SIZE, CONFIG),
        "pipeline.paper": (SIZE, preset("paper")),
        "pipeline.1080p": ("1080p", CONFIG),
        "pipeline.lens": ("lens", CONFIG),
    }
    of_run = _on_gpus if on_cuda() else _on_cpu
    return [
        Metric(f"{start}.{key}", rate, "frames/s", "higher", 0.15)
        for start, run in runs.items()
        for key, rate in of_run(*run, seconds)
    ]


def _on_cpu(size: str, config: Config, seconds: float) -> Iterator[tuple[str, float]]:
    frames = frames_of(size, BATCH)
    yield "fps", _frames_per_s(partial(detect, frames, config), BATCH, seconds)


def _on_gpus(size: str, config: Config, seconds: float) -> Iterator[tuple[str, float]]:
    among = jax.local_devices()
    frames = frames_of(size, BATCHES[size] * len(among))
    on_device = jax.device_put((frames.color, frames.depth), rows_over(tuple(among)))
    pinned = pin(frames.color, frames.depth)
    upload = _uploader(pinned, among)

    def step(source: Callable[[], tuple[jax.Array, jax.Array]]) -> Detections:
        color, depth = source()
        return detect(frames._replace(color=color, depth=depth), config)

    sources = {"resident": lambda: on_device, "pinned": upload}
    for key, source in sources.items():
        check_equal(key, step(source), step(sources["resident"]))
        yield f"{key}.fps", _frames_per_s(partial(step, source), len(frames.color), seconds)


def _uploader(
    pinned: tuple[np.ndarray, np.ndarray], among: Sequence[Any]
) -> Callable[[], tuple[jax.Array, jax.Array]]:
    """Copies page-locked images to all GPUs in equal parts."""
    size = len(pinned[0]) // len(among)
    shapes = [(size, *images.shape[1:]) for images in pinned]
    ways = [Uploader(shapes[0], shapes[1], device) for device in among]
    rows = rows_over(tuple(among))

    def upload() -> tuple[jax.Array, jax.Array]:
        parts = [
            way.upload([(pinned[0][i * size :][:size], pinned[1][i * size :][:size])])
            for i, way in enumerate(ways)
        ]
        if len(parts) == 1:
            return parts[0]
        join = jax.make_array_from_single_device_arrays
        color, depth = (
            join(images.shape, rows, list(part))
            for images, part in zip(pinned, zip(*parts, strict=True), strict=True)
        )
        return color, depth

    return upload


def _frames_per_s(
    step: Callable[[], Detections], batch: int, seconds: float, ahead: int = 1
) -> float:
    """Steady rate with a batch in flight while the next is uploaded, as a long run has them."""
    jax.block_until_ready([step() for _ in range(2)])
    flying, done, start = [], 0, time.perf_counter()
    while time.perf_counter() - start < seconds or done < 5:
        flying.append(step())
        if len(flying) > ahead:
            jax.block_until_ready(flying.pop(0))
            done += 1
    jax.block_until_ready(flying)
    return (done + len(flying)) * batch / (time.perf_counter() - start)
