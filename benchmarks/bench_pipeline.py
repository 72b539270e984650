"""Benchmark of the complete pipeline: throughput, and comparison with three others."""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from importlib import import_module
from multiprocessing import get_context
from typing import Any
from unittest import mock

import cv2
import jax
import numpy as np
from sklearn.cluster import DBSCAN

from benchmarks.run import Case, Metric, Missing, check_equal, with_peer
from benchmarks.scene import BATCH, CALIBRATIONS, CONFIG, frames_of, pin
from benchmarks.sweep import Point
from jaxdet.config import Config
from jaxdet.cores import cores
from jaxdet.floor.plane import flat_plane, floor_limits
from jaxdet.pipeline import detect
from jaxdet.presets import preset
from jaxdet.stages._batches import on_cuda
from jaxdet.stages._upload import Uploader
from jaxdet.types import Detections, Frames

SIZE = "640x480"
BATCHES = {SIZE: 1024, "1080p": 256, "lens": 512}
"""Frames per batch on a GPU."""
VOXEL_M = 0.05
"""Voxel size for Open3D, equal to the step height [m]."""


def cases() -> list[Case | Missing]:
    """Detect obstacles in frames in memory with the default preset, ``paper`` and other programs.

    Only the preset ``paper`` and the hand-written pipeline use colour images.
    """
    found: list[Case | Missing] = []
    for name, config in (("default", CONFIG), ("paper", preset("paper"))):
        frames = frames_of(SIZE, 4 * BATCH, color=config.cluster.points)
        case = Case(
            name=f"{name}.reference",
            run=partial(detect, frames, config),
            frames=4 * BATCH,
            peer=partial(detect, frames, config, backend="reference"),
            equal=True,
        )
        found.append(case)
    found += [_at_size(size) for size in ("1080p", "lens")]
    ours, colored = frames_of(SIZE, 16 * BATCH), frames_of(SIZE, 16 * BATCH, color=True)
    case = Case("vs_handwritten", partial(detect, ours, CONFIG), 16 * BATCH)
    found.append(case._replace(peer=partial(handwritten, colored)))
    remedy = "install the extra bench; the system needs libgomp1 and libx11-6"
    from_depth = case._replace(name="vs_open3d", peer=partial(open3d, ours))
    found.append(with_peer("vs_open3d", "open3d", remedy, lambda _: from_depth))
    return found


def at(point: Point) -> Case:
    """Detect obstacles in depth images on the device."""
    frames = frames_of(point.size, point.batch)
    frames = frames._replace(depth=jax.device_put(frames.depth))
    return Case(
        name=point.name,
        run=lambda: detect(frames, CONFIG),
        frames=point.batch,
        bytes_read=frames.depth.nbytes,
    )


def _at_size(size: str) -> Case:
    """Run the default on larger or distorted images; the reference processes two frames."""
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
    """Run a straightforward pipeline of OpenCV and scikit-learn, frame by frame, on all cores."""
    assert frames.color is not None
    work = list(zip(frames.color, frames.depth, strict=True))
    return list(_pool().map(_one_frame, work, chunksize=2))


def open3d(frames: Frames) -> list[np.ndarray]:
    """Detect obstacles from only depth by Open3D, frame by frame, on all cores.

    Returns:
        For each frame the cluster of each voxel above the floor, -1 = none.
    """
    return list(_open3d_pool().map(_one_cloud, frames.depth, chunksize=2))


@cache
def _pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(
        mp_context=get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    )


@cache
def _open3d_pool() -> ProcessPoolExecutor:
    """Return a pool of processes with one OpenMP thread each, which is set at their start."""
    with mock.patch.dict(os.environ, {"OMP_NUM_THREADS": "1"}):
        pool = ProcessPoolExecutor(cores(), get_context("spawn"))
        list(pool.map(_import_open3d, range(4 * cores())))
    return pool


def _import_open3d(_: int) -> None:
    """Import Open3D in this process."""
    import_module("open3d")


def _one_cloud(depth: np.ndarray) -> np.ndarray:
    """Cluster a depth image: voxels of 5 cm within the default range, RANSAC for the floor, DBSCAN.

    Every second pixel of every second row is sufficient: within the range they are 2 cm apart.
    """
    o3d: Any = import_module("open3d")
    camera, ground = CALIBRATIONS[SIZE].depth, CONFIG.ground
    lens = o3d.camera.PinholeCameraIntrinsic(camera.width, camera.height, camera.K)
    image = o3d.geometry.Image(np.ascontiguousarray(depth))
    reach = {"depth_scale": 1000.0, "depth_trunc": ground.max_depth_m}
    cloud = o3d.geometry.PointCloud.create_from_depth_image(image, lens, **reach, stride=2)
    cloud = cloud.voxel_down_sample(VOXEL_M)
    if len(cloud.points) < 3:
        return np.zeros(0, int)
    _, floor = cloud.segment_plane(ground.step_height_m, ransac_n=3, num_iterations=100)
    rest = cloud.select_by_index(floor, invert=True)
    return np.asarray(rest.cluster_dbscan(eps=2 * VOXEL_M, min_points=5))


@cache
def _limit() -> np.ndarray:
    calibration = CALIBRATIONS[SIZE]
    plane = flat_plane(*(np.array([a]) for a in (0.35, 0.15, 0.0)))
    return floor_limits(calibration.image, plane, CONFIG.ground, 0.001)[0][0]


def _one_frame(images: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    color, depth = images
    calibration = CALIBRATIONS[SIZE]
    assert calibration.color_from_depth is not None
    camera = calibration.image
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
    """Return rates of the default, ``paper``, 1080p images and lens distortion [frames/s].

    On a GPU, frames are either in its memory or come from page-locked host memory.
    """
    runs = {
        "pipeline": (SIZE, CONFIG),
        "pipeline.paper": (SIZE, preset("paper")),
        "pipeline.1080p": ("1080p", CONFIG),
        "pipeline.lens": ("lens", CONFIG),
    }
    of_run = _on_gpu if on_cuda() else _on_cpu
    return [
        Metric(f"{start}.{key}", rate, "frames/s", "higher", 0.15)
        for start, run in runs.items()
        for key, rate in of_run(*run, seconds)
    ]


def _on_cpu(size: str, config: Config, seconds: float) -> Iterator[tuple[str, float]]:
    frames = frames_of(size, BATCH, color=config.cluster.points)
    yield "fps", _frames_per_s(partial(detect, frames, config), BATCH, seconds)


def _on_gpu(size: str, config: Config, seconds: float) -> Iterator[tuple[str, float]]:
    """Yield rates with images in GPU memory and in page-locked memory; colour for ``paper``."""
    device = jax.local_devices()[0]
    frames = frames_of(size, BATCHES[size], color=config.cluster.points)
    images = [frames.depth] if frames.color is None else [frames.depth, frames.color]
    on_device, pinned = jax.device_put(images, device), list(map(pin, images))
    uploader = Uploader([(array.shape, array.dtype.type) for array in pinned], device)

    def step(source: Callable[[], list[jax.Array]]) -> Detections:
        depth, *color = source()
        return detect(frames._replace(depth=depth, color=color[0] if color else None), config)

    sources = {"resident": lambda: on_device, "pinned": lambda: uploader.upload([pinned])}
    for key, source in sources.items():
        check_equal(key, step(source), step(sources["resident"]))
        yield f"{key}.fps", _frames_per_s(partial(step, source), len(frames.depth), seconds)


def _frames_per_s(
    step: Callable[[], Detections], batch: int, seconds: float, ahead: int = 1
) -> float:
    """Return the steady rate with one batch in flight while the next is uploaded [frames/s]."""
    jax.block_until_ready([step() for _ in range(2)])
    flying, done, start = [], 0, time.perf_counter()
    while time.perf_counter() - start < seconds or done < 5:
        flying.append(step())
        if len(flying) > ahead:
            jax.block_until_ready(flying.pop(0))
            done += 1
    jax.block_until_ready(flying)
    return (done + len(flying)) * batch / (time.perf_counter() - start)
