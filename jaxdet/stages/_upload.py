"""Batches from page-locked host memory to a CUDA device, while the last batch is computed."""

from typing import Any, NamedTuple

import jax
import numpy as np
import warp as wp

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
    images = PinnedImages(
        wp.empty(color.shape, dtype=UINT8, device="cpu", pinned=True),
        wp.empty(depth.shape, dtype=UINT16, device="cpu", pinned=True),
    )
    images.color.numpy()[...] = color
    images.depth.numpy()[...] = depth
    return images


class Uploader:
    """A ring of device buffers, filled on a stream of its own.

    A buffer is filled again ``depth`` uploads later; by then the results computed from it must be
    ready, so wait for the batch before the last before uploading the next.

    Args:
        color_shape: ``(B, H, W, 3)``.
        depth_shape: ``(B, Hd, Wd)``.
        depth: Number of buffers.
    """

    def __init__(
        self, color_shape: tuple[int, ...], depth_shape: tuple[int, ...], depth: int = 3
    ) -> None:
        self.stream = wp.Stream("cuda:0")
        self.buffers = [
            (
                wp.empty(color_shape, dtype=UINT8, device="cuda:0"),
                wp.empty(depth_shape, dtype=UINT16, device="cuda:0"),
            )
            for _ in range(depth)
        ]
        self.uploads = 0

    def upload(self, images: PinnedImages) -> tuple[jax.Array, jax.Array]:
        """Copies a batch to the device and waits for the copy, not for what is being computed.

        Returns:
            Colour and depth on the device, valid until the buffer is filled again.
        """
        buffers = self.buffers[self.uploads % len(self.buffers)]
        self.uploads += 1
        for to, source in zip(buffers, images, strict=True):
            wp.copy(to, source, stream=self.stream)
        wp.synchronize_stream(self.stream)
        return wp.to_jax(buffers[0]), wp.to_jax(buffers[1])
