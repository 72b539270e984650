"""Stage 1, align, at ``POINTS`` pixels of each image, against librealsense and OpenCV.

The peers align whole images.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import cv2
import jax
import numpy as np

from benchmarks.run import Case, Missing, with_peer
from benchmarks.scene import BATCH, CALIBRATIONS, inputs, repeated
from benchmarks.sweep import DEFAULT_BATCH, SIZES, Point, kind
from jaxdet import reference, stages
from jaxdet.types import AlignedDepth, Distortion

POINTS = 1024
ORACLE = "install the extra oracle; the system needs libusb-1.0-0 and libudev1"


def cases() -> list[Case | Missing]:
    """Align depth images from the host to colour; librealsense's results are equal."""
    first = _case("640x480")
    found: list[Case | Missing] = [
        first._replace(
            name="vs_reference",
            peer=lambda: _at_pixels(
                "640x480",
                reference.paper.align(inputs("640x480").depth, inputs("640x480").calibration).depth,
            ),
        ),
        first._replace(
            name="vs_registerDepth", peer=lambda: register_depth("640x480"), equal=False
        ),
    ]
    lens = at(Point("lens", 0, DEFAULT_BATCH[kind()]))
    found.append(lens._replace(name="lens.vs_pinhole", peer=_straightened("lens", lens.frames)))
    for size in SIZES:
        name = "vs_rs_align" if size == "640x480" else f"{size}.vs_rs_align"
        found.append(
            with_peer(
                name,
                "tests.oracles.realsense",
                ORACLE,
                lambda module, size=size, name=name: _with_librealsense(module, size, name),
            )
        )
    return found


def at(point: Point) -> Case:
    """Align depth images that are on the device."""
    given = inputs(point.size)
    depth = jax.device_put(repeated(given.depth, point.batch))
    return Case(
        name=point.name,
        run=lambda: stages.paper.align(depth, *_pixels(point.size, point.batch), given.calibration),
        frames=point.batch,
        bytes_read=depth.nbytes,
    )


def _straightened(size: str, batch: int) -> Callable[[], AlignedDepth]:
    """Return our alignment of the same images with lens distortion disabled."""
    given = inputs(size)
    depth = jax.device_put(repeated(given.depth, batch))
    calibration = given.calibration
    assert calibration.color is not None
    straight = calibration._replace(
        color=calibration.color._replace(distortion=Distortion.NONE, coefficients=()),
        depth=calibration.depth._replace(distortion=Distortion.NONE, coefficients=()),
    )
    return lambda: stages.paper.align(depth, *_pixels(size, batch), straight)


@cache
def _pixels(size: str, batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows ``(B, POINTS)`` int32 of pixels of the colour images."""
    image, rng = CALIBRATIONS[size].image, np.random.default_rng(0)
    u, v = (rng.integers(0, n, (BATCH, POINTS), np.int32) for n in (image.width, image.height))
    return repeated((u, v), batch)


def _at_pixels(size: str, images: Sequence[np.ndarray]) -> np.ndarray:
    u, v = _pixels(size, BATCH)
    return np.stack([image[v[b], u[b]] for b, image in enumerate(images)])


def register_depth(size: str) -> list[np.ndarray]:
    """Align with OpenCV: one point per depth pixel, which leaves holes that librealsense fills."""
    calibration = CALIBRATIONS[size]
    color = calibration.color
    assert color is not None and calibration.color_from_depth is not None
    return [
        cv2.registerDepth(
            calibration.depth.K,
            color.K,
            np.zeros(4),
            calibration.color_from_depth.T,
            depth,
            (color.width, color.height),
            depthDilation=True,
        )
        for depth in inputs(size).depth
    ]


def _case(size: str) -> Case:
    given, batch = inputs(size), DEFAULT_BATCH[kind()]
    depth = repeated(given.depth, batch)
    return Case(
        name=size,
        run=lambda: stages.paper.align(depth, *_pixels(size, batch), given.calibration),
        frames=batch,
        equal=True,
        peer_frames=BATCH,
        compared=lambda result: result.depth[:BATCH],
    )


def _with_librealsense(realsense: Any, size: str, name: str) -> Case:
    given = inputs(size)
    pairs = realsense.framesets(given.depth, given.calibration)
    process = realsense.aligner()
    return _case(size)._replace(
        name=name, peer=lambda: _at_pixels(size, realsense.aligned(process, pairs))
    )
