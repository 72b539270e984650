"""Benchmark of the features of the preset ``paper``, against OpenCV and kornia-rs's Canny."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import jax
import numpy as np

from benchmarks.run import Case, Missing, with_peer
from benchmarks.scene import BATCH, CONFIG, Inputs, inputs, repeated
from benchmarks.sweep import DEFAULT_BATCH, Point, kind
from jaxdet import reference, stages
from jaxdet.types import Calibration, Features

CORNERS = CONFIG.features
Canny = Callable[[np.ndarray], np.ndarray]


def cases() -> list[Case | Missing]:
    """Process colour images from the host; the corners of all peers equal ours, in order."""
    found: list[Case | Missing] = []
    for size in ("640x480", "1280x720"):
        given, case = inputs(size), _case(size)
        name = "vs_cv2" if size == "640x480" else f"{size}.vs_cv2"
        found.append(case._replace(name=name, peer=lambda given=given: opencv(given)))
    given, case = inputs("640x480"), _case("640x480")
    found.append(case._replace(name="vs_cv2_threads", peer=lambda: opencv_threads(given)))
    remedy = "install the extra bench"
    found.append(
        with_peer("vs_kornia", "kornia_rs.imgproc", remedy, lambda module: _kornia(case, module))
    )
    return found


def at(point: Point) -> Case:
    """Process colour images and aligned depth on the device, with ``slots`` corner slots."""
    given, config = inputs(point.size), replace(CORNERS, max_corners=point.slots)
    color, z = jax.device_put(repeated((given.color, _aligned(given)), point.batch))
    return Case(
        name=point.name,
        run=lambda: stages.paper.features(color, z, Calibration(given.calibration.image), config),
        frames=point.batch,
        bytes_read=color.nbytes,
    )


def opencv(given: Inputs) -> list[np.ndarray]:
    """Compute grey image, Canny and Shi-Tomasi frame by frame; OpenCV uses its own threads."""
    return [_one_frame(color, cv2_canny) for color in given.color]


def opencv_threads(given: Inputs) -> list[np.ndarray]:
    """Compute the same with one thread per frame."""
    with ThreadPoolExecutor() as pool:
        return list(pool.map(partial(_one_frame, canny=cv2_canny), given.color))


def cv2_canny(grey: np.ndarray) -> np.ndarray:
    """Return the edges found by OpenCV."""
    return cv2.Canny(grey, CORNERS.canny_low, CORNERS.canny_high)


def corners_of(features: Features) -> list[np.ndarray]:
    """Return column and row of each frame's corners, in raster order."""
    uv = np.stack([features.u, features.v], axis=-1)
    valid = np.asarray(features.valid)
    return [in_raster_order(a[kept]) for a, kept in zip(uv, valid, strict=True)]


def in_raster_order(corners: np.ndarray) -> np.ndarray:
    """Return corners sorted by row and column; OpenCV orders equally strong ones differently."""
    return corners[np.lexsort(corners.T)]


def _aligned(given: Inputs) -> np.ndarray:
    return reference.paper.align(given.depth, given.calibration).z


def _one_frame(color: np.ndarray, canny: Canny) -> np.ndarray:
    corners = cv2.goodFeaturesToTrack(
        canny(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)),
        CORNERS.max_corners,
        CORNERS.quality_level,
        CORNERS.min_distance,
    )
    return np.zeros((0, 2), int) if corners is None else in_raster_order(corners[:, 0].astype(int))


def _case(size: str) -> Case:
    given, batch = inputs(size), DEFAULT_BATCH[kind()]
    color, z = repeated((given.color, _aligned(given)), batch)
    z = jax.device_put(z)
    return Case(
        name=size,
        run=lambda: stages.paper.features(color, z, Calibration(given.calibration.image), CORNERS),
        frames=batch,
        equal=True,
        peer_frames=BATCH,
        compared=lambda result: corners_of(jax.tree.map(lambda a: a[:BATCH], result)),
    )


def _kornia(case: Case, imgproc: Any) -> Case:
    """Use kornia-rs for the edges, its only step; grey image and corners come from OpenCV."""

    def canny(grey: np.ndarray) -> np.ndarray:
        edges = imgproc.canny(grey[..., None], CORNERS.canny_low, CORNERS.canny_high)
        return np.asarray(edges)[..., 0]

    colors = inputs("640x480").color
    return case._replace(
        name="vs_kornia", peer=lambda: [_one_frame(color, canny) for color in colors]
    )
