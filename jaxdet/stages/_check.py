"""Self-test of the kernels against a stored answer, once per process."""

from collections.abc import Mapping
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from typing import Any

import numpy as np
import warp as wp

from jaxdet.config import Config
from jaxdet.errors import JaxdetError
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.runtime.launch import INT32
from jaxdet.stages import _program
from jaxdet.types import (
    MAX_OBSTACLES,
    Calibration,
    Detections,
    GroundPlane,
    Intrinsics,
    Obstacles,
    Scene,
)

CALIBRATION = Calibration(Intrinsics(96, 72, 80.0, 80.0, 47.5, 35.5))
ANSWER = "e76c34648f4635c11c8c13222adcb64c"
"""Digest of the reference's results for :func:`check_frames`, see :func:`digest`."""


def check_frames() -> tuple[np.ndarray, GroundPlane]:
    """Return depth images ``(2, Hd, Wd)`` of a floor, a box and a wall, and the floor priors."""
    camera = CALIBRATION.depth
    v, u = np.mgrid[: camera.height, : camera.width]
    below = v - camera.height // 2
    depth = np.where(below > 0, 400 * 80 // np.maximum(below, 1), 65535)
    depth = np.minimum(depth, 3000 + 2 * (u % 7))
    depth[20:60, 50:70] = np.minimum(depth[20:60, 50:70], 1200)
    both = np.stack([depth, depth[:, ::-1]])
    both[1, ::5, ::3] = 0
    planes = zip(flat_plane(0.4, 0.0, 0.0), unknown_plane(1), strict=True)
    return both.astype(np.uint16), GroundPlane(*map(np.concatenate, planes))


def digest(found: Mapping[str, np.ndarray]) -> str:
    """Return the digest of arrays of detections, by name, as int32."""
    names = "num_obstacles", "has_depth", *Obstacles._fields, *Scene._fields
    total = blake2b(digest_size=16)
    for name in names:
        if name not in ("prior", "nearest"):
            total.update(np.ascontiguousarray(found[name], np.int32).tobytes())
    return total.hexdigest()


def digest_of(found: Detections) -> str:
    """Return the :func:`digest` of detections."""
    assert found.scene is not None
    counts = {"num_obstacles": found.num_obstacles, "has_depth": found.has_depth}
    return digest({**counts, **found.obstacles._asdict(), **found.scene._asdict()})


@cache
def check_kernels(device: Any = None) -> None:
    """Check the results of the kernels on two small images.

    Args:
        device: Warp device for which the kernels are loaded; None: the device that JAX computes on.

    Raises:
        JaxdetError: The results differ from those of the reference.
    """
    depth, planes = check_frames()
    if device is None:
        from jaxdet.runtime.calls import device_of_jax

        device = device_of_jax(_program.kernels)
    config = Config()
    tables = _program.packed(*_program.host_tables(CALIBRATION, config), device)
    floors = _program.floors(planes, config, CALIBRATION.depth_unit)
    static, batch = _program.Static.of(tables), len(depth)
    inputs = [
        wp.array(a, dtype=wp.dtype_from_numpy(a.dtype), device=device)
        for a in (depth, floors, tables)
    ]
    record, contour, work = (
        wp.zeros((batch, words), dtype=INT32, device=device) for words in static.words()
    )
    scratch = wp.empty((batch, static.own_words), dtype=INT32, device=device)
    _program.launch([*inputs, record, contour, work], scratch, 0, len(_program.STEPS), static)
    layout = _program.record_layout()
    found = {name: layout.take(record.numpy(), name) for name in layout.shapes}
    found["contour"] = contour.numpy().reshape(batch, MAX_OBSTACLES, static.columns, 2)
    if digest(found) != ANSWER:
        versions = f"Warp {wp.__version__}, JAX {version('jax')}"
        raise JaxdetError(
            f"the kernels give wrong results with {versions} on {device}",
            remedy="use the versions that pyproject.toml names, or --backend reference",
        )
