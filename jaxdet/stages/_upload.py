"""Batches from page-locked host memory to CUDA devices, while the last batch is computed."""

from itertools import cycle
from typing import Any, NamedTuple

import jax
import numpy as np
import warp as wp

from jaxdet.stages import _spread

UINT8: Any = wp.uint8
UINT16: Any = wp.uint16


class PinnedImages(NamedTuple):
    """Colour and depth images of a batch in page-locked host memory."""

    color: wp.array
    """``(B, H, W, 3)`` uint8."""
    depth: wp.array
    """``(B, Hd, Wd)`` uint16."""


def pin(color: np.ndarray, depth: np.ndarray) -> PinnedImages:
    """Copies a batch's images into page-locked memory, which the bus reads at its full rate.

    Args:
        color: ``(B, H, W, 3)`` uint8.
        depth: ``(B, Hd, Wd)`` uint16.
    """
    images = _pinned(color.shape, depth.shape)
    images.color.numpy()[...] = color
    images.depth.numpy()[...] = depth
    return images


class PinnedRing:
    """Page-locked images that a reader writes to, in turns.

    Args:
        color_shape: ``(B, H, W, 3)``.
        depth_shape: ``(B, Hd, Wd)``.
        count: Batches in use at a time; the next one takes the place of the oldest.
    """

    def __init__(
        self, color_shape: tuple[int, ...], depth_shape: tuple[int, ...], count: int
    ) -> None:
        images = [_pinned(color_shape, depth_shape) for _ in range(count)]
        self._by_address = {each.color.ptr: each for each in images}
        self._turns = cycle(images)

    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """The next colour and depth images."""
        images = next(self._turns)
        return images.color.numpy(), images.depth.numpy()

    def pinned(self, color: np.ndarray) -> PinnedImages:
        """The images that :meth:`images` gave, by the colour ones."""
        return self._by_address[color.ctypes.data]


class Uploader:
    """Rings of device buffers, filled on streams of their own.

    The rows go to the devices in equal parts. A buffer is filled again ``depth`` uploads later; by
    then the results computed from it must be ready, so wait for the batch before the last before
    uploading the next.

    Args:
        color_shape: ``(B, H, W, 3)``; ``B`` makes equal parts.
        depth_shape: ``(B, Hd, Wd)``.
        depth: Number of buffers.
        devices: Where to; by default the devices that share a batch.
    """

    def __init__(
        self,
        color_shape: tuple[int, ...],
        depth_shape: tuple[int, ...],
        depth: int = 3,
        devices: _spread.Devices | None = None,
    ) -> None:
        self.devices = devices or _spread.devices_for(None)
        self.shapes = color_shape, depth_shape
        parts = [(shape[0] // len(self.devices), *shape[1:]) for shape in self.shapes]
        self.streams, self.rings = [], []
        for device in map(wp.device_from_jax, self.devices):
            self.streams.append(wp.Stream(device))
            self.rings.append([_empty(*parts, device=device) for _ in range(depth)])
        self.uploads = 0

    def upload(self, images: PinnedImages) -> tuple[jax.Array, jax.Array]:
        """Copies a batch to the devices and waits for the copies, not for what is being computed.

        Returns:
            Colour and depth on the devices, valid until the buffers are filled again.
        """
        turn = self.uploads % len(self.rings[0])
        self.uploads += 1
        buffers = [ring[turn] for ring in self.rings]
        for number, (stream, part) in enumerate(zip(self.streams, buffers, strict=True)):
            for to, source in zip(part, images, strict=True):
                wp.copy(to, source, src_offset=number * to.size, count=to.size, stream=stream)
        for stream in self.streams:
            wp.synchronize_stream(stream)
        color, depth = (self._joined([part[i] for part in buffers], i) for i in range(2))
        return color, depth

    def _joined(self, parts: list[wp.array], which: int) -> jax.Array:
        """One array whose rows are on the devices."""
        arrays = [wp.to_jax(part) for part in parts]
        if len(arrays) == 1:
            return arrays[0]
        sharding = _spread.rows_over(self.devices)
        return jax.make_array_from_single_device_arrays(self.shapes[which], sharding, arrays)


def _pinned(color_shape: tuple[int, ...], depth_shape: tuple[int, ...]) -> PinnedImages:
    return PinnedImages(*_empty(color_shape, depth_shape, device="cpu", pinned=True))


def _empty(
    color_shape: tuple[int, ...], depth_shape: tuple[int, ...], **where: Any
) -> tuple[wp.array, wp.array]:
    return wp.empty(color_shape, dtype=UINT8, **where), wp.empty(depth_shape, dtype=UINT16, **where)
