"""Execution of batches of any size by programs that are compiled for a small number of sizes."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.types import GroundPlane

PART_BYTES = 96 << 20
"""Maximum size of the images that the CPU computes together [bytes], 128 depth images of 640x480:
the memory for results grows with it, and the fixed cost of a call is small for so many frames."""
STAGED_PART_BYTES = 12 << 20
"""``PART_BYTES`` for a program that runs one stage after the other on all frames: the process
reuses the memory of temporary arrays of this size, but for larger ones it obtains new pages from
the system in every call."""
PAD_BELOW = 8
"""Minimum number of frames of a batch that the CPU computes without padding."""
LEAST_CAPABILITY = 8.0
"""Minimum compute capability of GPUs: from 8.0 on a warp sums integers in one instruction."""


def check_device(images: Any) -> None:
    """Raise an error for images on devices that the kernels do not support.

    Images on a device are processed there, images on the host on the default device.

    Raises:
        ConfigError: The GPU has a compute capability below ``LEAST_CAPABILITY``, or images are
            spread over several devices.
    """
    devices = images.devices() if isinstance(images, jax.Array) else {default_device()}
    if len(devices) > 1:
        problem = f"images are on {len(devices)} devices, expected all on one device"
        raise ConfigError(problem, remedy="call detect for each device's images")
    check_capability(devices)


def check_capability(devices: Iterable[Any]) -> None:
    """Raise an error for GPUs that the kernels do not support.

    Raises:
        ConfigError: A GPU has a compute capability below ``LEAST_CAPABILITY``.
    """
    for device in devices:
        capability = getattr(device, "compute_capability", None)
        if capability and float(capability) < LEAST_CAPABILITY:
            raise ConfigError(
                f"{device.device_kind} has compute capability {capability}, but "
                f"{LEAST_CAPABILITY} (Ampere) or later is needed: choose another GPU by "
                "CUDA_VISIBLE_DEVICES, or JAX_PLATFORMS=cpu"
            )


def default_device() -> Any:
    """Return the default device of JAX."""
    chosen = getattr(jax.config, "jax_default_device", None)
    return chosen if isinstance(chosen, jax.Device) else jax.local_devices()[0]


def on_cuda() -> bool:
    """Return whether JAX's default device is a CUDA device."""
    chosen = getattr(jax.config, "jax_default_device", None)
    platform = getattr(chosen, "platform", chosen) or jax.default_backend()
    return platform in ("gpu", "cuda")


def in_parts(
    run: Callable[[tuple[Any, ...], GroundPlane], Any],
    images: tuple[Any, ...],
    plane: GroundPlane,
    staged: bool = False,
) -> Any:
    """Return the results of a program for a batch of any size.

    CUDA computes a batch at once; the CPU computes parts of at most ``PART_BYTES`` of images, whose
    number of frames is a power of two. Images on the host are padded to a power of two, with frames
    without depth, if there are fewer than ``PAD_BELOW`` frames or CUDA is used; the results of the
    padding are dropped.

    Args:
        run: Function of images and planes that returns a tree of arrays with one row per frame.
        images: Arrays ``(B, ...)``, one per kind of image, ``B`` at least 1.
        plane: Planes of the ``B`` frames.
        staged: Whether the program runs one stage after the other on all frames, see
            ``STAGED_PART_BYTES``.

    Returns:
        The tree for all ``B`` frames: the result of ``run`` for a single part, NumPy arrays for
        several parts.

    Raises:
        ConfigError: See :func:`check_device`.
    """
    check_device(images[0])
    count = len(images[0])
    most = _part_size(images, STAGED_PART_BYTES if staged else PART_BYTES)
    joined: Any = None
    end = 0
    while end < count:
        size = _next_part(count - end, most)
        rows = slice(end, end := end + size)
        some = tuple(image[rows] if size < count else image for image in images)
        planes = GroundPlane(*(np.asarray(values)[rows] for values in plane))
        number = len(some[0])
        missing = 0 if isinstance(some[0], jax.Array) else _bucket(number) - number
        if missing:
            some = tuple(_padded(image, missing, "constant") for image in some)
            planes = GroundPlane(*(_padded(values, missing, "edge") for values in planes))
        part = run(some, planes)
        if missing:
            part = jax.tree.map(lambda values, number=number: values[:number], part)
        if size == count:
            return part
        if joined is None:
            joined = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), part)
        jax.tree.map(partial(_put, rows), joined, part)
        del part  # so that the next part can use its memory
    return joined


def _put(rows: slice, whole: np.ndarray, part: jax.Array) -> None:
    whole[rows] = part


def _part_size(images: tuple[Any, ...], part_bytes: int) -> int:
    """Return the maximum number of frames that are computed together."""
    count = len(images[0])
    if on_cuda():
        return count
    frame = sum(image.nbytes for image in images) // count
    return 1 << max(part_bytes // frame, 1).bit_length() - 1


def _next_part(left: int, most: int) -> int:
    """Return how many of the ``left`` remaining frames the next part has, at most ``most``."""
    if left >= most or left < PAD_BELOW or on_cuda():
        return min(left, most)
    return 1 << left.bit_length() - 1


def _bucket(count: int) -> int:
    """Return the size to which batches of ``count`` frames are padded."""
    return 1 << (count - 1).bit_length()


def _padded(rows: np.ndarray, missing: int, mode: Any) -> np.ndarray:
    return np.pad(rows, [(0, missing)] + [(0, 0)] * (rows.ndim - 1), mode=mode)
