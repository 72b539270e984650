"""The whole pipeline: against the NumPy reference and two others, and its throughput."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
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
from jaxdet.stages._spread import on_cuda, rows_over
from jaxdet.stages._upload import Uploader
from jaxdet.types import Detections, Frames

SIZE = "640x480"
BATCHES = {SIZE: 1024, "1080p": 256, "lens": 512}
"""Frames of a batch on each GPU."""
VOXEL_M = 0.05
"""Voxels of Open3D: as wide as the step height [m]."""


def cases() -> list[Case | Missing]:
    """Frames in memory: the default and the paper's setting, next to their peers.

    Only the preset ``paper`` and the hand-written pipeline get colour images.
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
    """Depth images on the device."""
    frames = frames_of(point.size, point.batch)
    frames = frames._replace(depth=jax.device_put(frames.depth))
    return Case(
        name=point.name,
        run=lambda: detect(frames, CONFIG),
        frames=point.batch,
        bytes_read=frames.depth.nbytes,
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
    assert frames.color is not None
    work = list(zip(frames.color, frames.depth, strict=True))
    return list(_pool().map(_one_frame, work, chunksize=2))


def open3d(frames: Frames) -> list[np.ndarray]:
    """The same task from depth alone by Open3D, frame by frame, on all cores.

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
    """Processes with a thread of OpenMP each, which reads its setting when they start."""
    with mock.patch.dict(os.environ, {"OMP_NUM_THREADS": "1"}):
        pool = ProcessPoolExecutor(cores(), get_context("spawn"))
        list(pool.map(_import_open3d, range(4 * cores())))
    return pool


def _import_open3d(_: int) -> None:
    """Imports Open3D in this process."""
    import_module("open3d")


def _one_cloud(depth: np.ndarray) -> np.ndarray:
    """Voxels of 5 cm within the default's range, the floor by RANSAC, clusters by DBSCAN.

    Every second pixel of every second row is enough: within the range they are 2 cm apart.
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
    frames = frames_of(size, BATCH, color=config.cluster.points)
    yield "fps", _frames_per_s(partial(detect, frames, config), BATCH, seconds)


def _on_gpus(size: str, config: Config, seconds: float) -> Iterator[tuple[str, float]]:
    """With images on the devices and in pinned memory: depth, and colour for ``paper`` alone."""
    among = jax.local_devices()
    frames = frames_of(size, BATCHES[size] * len(among), color=config.cluster.points)
    images = [frames.depth] if frames.color is None else [frames.depth, frames.color]
    on_device = jax.device_put(images, rows_over(tuple(among)))

    def step(source: Callable[[], list[jax.Array]]) -> Detections:
        depth, *color = source()
        return detect(frames._replace(depth=depth, color=color[0] if color else None), config)

    sources = {"resident": lambda: on_device, "pinned": _uploader(list(map(pin, images)), among)}
    for key, source in sources.items():
        check_equal(key, step(source), step(sources["resident"]))
        yield f"{key}.fps", _frames_per_s(partial(step, source), len(frames.depth), seconds)


def _uploader(pinned: Sequence[np.ndarray], among: Sequence[Any]) -> Callable[[], list[jax.Array]]:
    """Copies page-locked images to all GPUs in equal parts."""
    size = len(pinned[0]) // len(among)
    kinds = [((size, *images.shape[1:]), images.dtype.type) for images in pinned]
    ways = [Uploader(kinds, device) for device in among]
    rows = rows_over(tuple(among))

    def upload() -> list[jax.Array]:
        parts = [
            way.upload([[images[i * size :][:size] for images in pinned]])
            for i, way in enumerate(ways)
        ]
        if len(parts) == 1:
            return parts[0]
        join = jax.make_array_from_single_device_arrays
        every = zip(pinned, zip(*parts, strict=True), strict=True)
        return [join(images.shape, rows, list(part)) for images, part in every]

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
