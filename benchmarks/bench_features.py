"""Features of the preset ``paper``, against OpenCV one frame at a time, and kornia-rs's Canny."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import jax
import numpy as np

from benchmarks.run import Case, Missing, with_peer
from benchmarks.scene import BATCH, CONFIG, Inputs, inputs, on_cells, repeated
from benchmarks.sweep import DEFAULT_BATCH, Point, kind
from jaxdet import reference, stages
from jaxdet.floor.plane import depth_range
from jaxdet.reference._cells import cover
from jaxdet.stages._corners import corner_settings
from jaxdet.stages._cover import CellFeatures, features_on_cells
from jaxdet.stages._features import rays
from jaxdet.types import Features, Keep

CORNERS = CONFIG.features
Canny = Callable[[np.ndarray], np.ndarray]


def cases() -> list[Case | Missing]:
    """Colour images from the host; every peer's corners are equal to ours, in order.

    The default finds its corners on kept cells: ``on_cells``.
    """
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
    return [*found, _on_cells()]


def at(point: Point) -> Case:
    """Colour images and keep mask on the device, ``slots`` corner slots."""
    given, config = inputs(point.size), replace(CORNERS, max_corners=point.slots)
    color, keep = jax.device_put(repeated((given.color, given.keep), point.batch))
    return Case(
        name=point.name,
        run=lambda: stages.features(color, keep, given.calibration, config),
        frames=point.batch,
        bytes_read=color.nbytes + keep.mask.nbytes,
    )


def opencv(given: Inputs) -> list[np.ndarray]:
    """Grey, Canny, Shi-Tomasi under the mask, frame by frame; OpenCV uses its own threads."""
    return [_one_frame(*frame, cv2_canny) for frame in _frames(given)]


def opencv_threads(given: Inputs) -> list[np.ndarray]:
    """The same with a thread a frame."""
    colors, masks = zip(*_frames(given), strict=True)
    with ThreadPoolExecutor() as pool:
        return list(pool.map(partial(_one_frame, canny=cv2_canny), colors, masks))


def cv2_canny(grey: np.ndarray) -> np.ndarray:
    """OpenCV's edges."""
    return cv2.Canny(grey, CORNERS.canny_low, CORNERS.canny_high)


def corners_of(features: Features) -> list[np.ndarray]:
    """Column and row of each frame's corners, as OpenCV returns them."""
    uv = np.stack([features.u, features.v], axis=-1)
    return [a[valid] for a, valid in zip(uv, np.asarray(features.valid), strict=True)]


def _frames(given: Inputs) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(given.color, given.keep.mask.view(np.uint8), strict=True))


def _one_frame(color: np.ndarray, mask: np.ndarray, canny: Canny) -> np.ndarray:
    corners = cv2.goodFeaturesToTrack(
        canny(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)),
        CORNERS.max_corners,
        CORNERS.quality_level,
        CORNERS.min_distance,
        mask=mask,
    )
    return np.zeros((0, 2), int) if corners is None else corners[:, 0].astype(int)


def _case(size: str) -> Case:
    given, batch = inputs(size), DEFAULT_BATCH[kind()]
    color, keep = repeated((given.color, given.keep), batch)
    keep = jax.device_put(keep)
    return Case(
        name=size,
        run=lambda: stages.features(color, keep, given.calibration, CORNERS),
        frames=batch,
        equal=True,
        peer_frames=BATCH,
        compared=lambda result: corners_of(jax.tree.map(lambda a: a[:BATCH], result)),
    )


def _on_cells() -> Case:
    """Corners on the kept cells, beside the reference."""
    given, seen = inputs("640x480"), on_cells("640x480")
    camera, config = given.calibration, CONFIG.ground
    bounds = depth_range(config.min_depth_m, config.max_depth_m, camera.depth_unit)
    above = seen.of("keep", seen.surfaces)
    keep = above & seen.cells.in_view & (seen.cells.z <= bounds[1])
    label = np.zeros(keep.shape, np.int32)
    settings = corner_settings(CORNERS), np.array(bounds, np.int32)
    arguments = jax.device_put(
        (given.color, seen.cells, above, label, rays(camera.color), *settings)
    )
    program = jax.jit(features_on_cells, static_argnames="slots")

    def peer() -> Features:
        over = cover(seen.cells, keep, camera.color)
        frame, there = np.arange(BATCH)[:, None, None], over >= 0
        z = np.where(there, seen.cells.z.reshape(BATCH, -1)[frame, over], 0).astype(np.uint16)
        kept = Keep(there, z, there.any((1, 2)))
        found = reference.features(given.color, kept, camera, CORNERS)
        return found._replace(overflow=np.zeros(BATCH, bool))

    def corners(found: CellFeatures) -> Features:
        columns = (a[:, : CORNERS.max_corners] for a in found.slots)
        return Features(*columns, overflow=np.zeros(BATCH, bool))  # it is not told of them

    return Case(
        name="on_cells.vs_reference",
        run=lambda: program(*arguments, slots=CORNERS.max_corners),
        frames=BATCH,
        peer=peer,
        equal=True,
        compared=corners,
    )


def _kornia(case: Case, imgproc: Any) -> Case:
    """kornia-rs has the edges only: grey and corners come from OpenCV."""

    def canny(grey: np.ndarray) -> np.ndarray:
        edges = imgproc.canny(grey[..., None], CORNERS.canny_low, CORNERS.canny_high)
        return np.asarray(edges)[..., 0]

    frames = _frames(inputs("640x480"))
    return case._replace(
        name="vs_kornia", peer=lambda: [_one_frame(*frame, canny) for frame in frames]
    )
