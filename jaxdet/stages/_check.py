"""Self-test of the kernels against a stored answer, once per process."""

from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from typing import Any

import numpy as np
import warp as wp

from jaxdet.config import Config
from jaxdet.errors import JaxdetError
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.stages import _program
from jaxdet.types import Calibration, Detections, Frames, GroundPlane, Intrinsics

CALIBRATION = Calibration(Intrinsics(96, 72, 80.0, 80.0, 47.5, 35.5))
ANSWER = "5aab3f27dafc71ec7b150ff5278e535f"
"""Digest of the reference's results for :func:`check_frames`, see :func:`digest`."""


def check_frames() -> Frames:
    """Return two frames that show floor, a box and a wall; only the first has a prior."""
    camera = CALIBRATION.depth
    v, u = np.mgrid[: camera.height, : camera.width]
    below = v - camera.height // 2
    depth = np.where(below > 0, 400 * 80 // np.maximum(below, 1), 65535)
    depth = np.minimum(depth, 3000 + 2 * (u % 7))
    depth[20:60, 50:70] = np.minimum(depth[20:60, 50:70], 1200)
    both = np.stack([depth, depth[:, ::-1]])
    both[1, ::5, ::3] = 0
    planes = zip(flat_plane(0.4, 0.0, 0.0), unknown_plane(1), strict=True)
    prior, number = GroundPlane(*map(np.concatenate, planes)), np.arange(2)
    return Frames(both.astype(np.uint16), CALIBRATION, number, number, number >= 0, plane=prior)


def digest(found: Detections) -> str:
    """Return a hash of the arrays of detections as int32, without the prior and ``nearest``."""
    assert found.scene is not None
    arrays = {**found.obstacles._asdict(), **found.scene._asdict()}
    total = blake2b(digest_size=16)
    for name in "num_obstacles", "has_depth", *arrays:
        if name not in ("prior", "nearest"):
            array = arrays[name] if name in arrays else getattr(found, name)
            total.update(np.ascontiguousarray(array, np.int32).tobytes())
    return total.hexdigest()


@cache
def check_kernels(device: Any = None) -> None:
    """Check the results of the kernels on two small images.

    Args:
        device: Warp device for which the kernels are loaded; None: the device that JAX computes on.

    Raises:
        JaxdetError: The results differ from those of the reference.
    """
    if device is None:
        from jaxdet.runtime.calls import device_of_jax

        device = device_of_jax(_program.kernels)
    frames = check_frames()
    assert frames.plane is not None
    given = frames, frames.plane, Config(), len(_program.STEPS)
    rows, static = _program.run(device, *given, keep_work=True)
    found = _program.detections(rows, static, False, np)
    if digest(found) != ANSWER:
        versions = f"Warp {wp.__version__}, JAX {version('jax')}"
        raise JaxdetError(
            f"the kernels give wrong results with {versions} on {device}",
            remedy="use the versions that pyproject.toml names, or --backend reference",
        )
