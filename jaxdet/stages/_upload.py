"""Transfer of batches from page-locked host memory to a CUDA device during computation."""

import ctypes
import mmap
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
import warp as wp

from jaxdet.runtime.launch import registering

INT32: Any = wp.int32
_KINDS: dict[Any, Any] = {np.uint8: wp.uint8, np.uint16: wp.uint16}

_PORTABLE = 1
"""CU_MEMHOSTREGISTER_PORTABLE: page-locked for all devices."""
_BLOCKING_SYNC = 4
"""CU_CTX_SCHED_BLOCKING_SYNC: a thread that waits for the device sleeps."""
_MADV_POPULATE_WRITE = 23
"""Advice of ``madvise`` that allocates pages."""
_POPULATING = 4
"""Number of threads that allocate pages; it is small because the workers, which start at the same
time, need the other cores."""


class Uploader:
    """Ring of device buffers; uploads are on one CUDA stream, downloads on another.

    A buffer is overwritten ``buffers`` uploads later, when the results computed from it must be
    ready: before the upload of batch n, wait for the results of batch n - ``buffers``. One thread
    may upload while another downloads.

    Args:
        arrays: Shape and NumPy type of each array of a batch, ``B`` first: depth images, and colour
            images if the method reads them.
        device: Target device of JAX.
        buffers: Number of buffers of the ring.
    """

    def __init__(
        self, arrays: Sequence[tuple[tuple[int, ...], type]], device: Any, buffers: int = 3
    ) -> None:
        self.kinds = [_KINDS[kind] for _, kind in arrays]
        with registering:
            self.device = wp.device_from_jax(device)
            self.stream, self.back = wp.Stream(self.device), wp.Stream(self.device)
            self.ring = [
                [
                    wp.zeros(shape, dtype=kind, device=self.device)
                    for (shape, _), kind in zip(arrays, self.kinds, strict=True)
                ]
                for _ in range(buffers)
            ]
        wp.synchronize_device(self.device)  # the zeros are written on another stream
        self.uploads = 0

    def upload(self, pieces: Sequence[Sequence[np.ndarray]]) -> list[jax.Array]:
        """Copy pieces of a batch to the device, one after the other.

        The call waits for the copies, not for computations. The rest of the buffer keeps its
        previous contents.

        Args:
            pieces: Arrays of each piece, in the order of ``arrays``.

        Returns:
            The arrays on the device, valid until the buffers are filled again.
        """
        buffers = self.ring[self.uploads % len(self.ring)]
        self.uploads += 1
        for which, (to, kind) in enumerate(zip(buffers, self.kinds, strict=True)):
            start = 0
            for piece in pieces:
                source = _on_host(piece[which], kind)
                wp.copy(to, source, dest_offset=start, count=source.size, stream=self.stream)
                start += source.size
        wp.synchronize_stream(self.stream)
        return [wp.to_jax(buffer) for buffer in buffers]

    def download(self, found: jax.Array, rows: Sequence[np.ndarray]) -> None:
        """Wait for ``found`` ``(B, n)`` int32 and copy its rows to the host, piece by piece."""
        source, start = wp.from_jax(jax.block_until_ready(found)), 0
        for piece in rows:
            to = _on_host(piece, INT32)
            wp.copy(to, source, src_offset=start, count=to.size, stream=self.back)
            start += to.size
        wp.synchronize_stream(self.back)


def _on_host(array: np.ndarray, kind: Any) -> wp.array:
    """Return contiguous memory as a Warp array, without a copy."""
    return wp.array(ptr=array.ctypes.data, dtype=kind, shape=(array.size,), device="cpu")


class PageLock:
    """Page-locked memory: all devices copy from and to it at the full rate of the bus.

    CUDA is blocked for this process while it locks memory, so memory is locked block by block, and
    threads allocate the pages beforehand.

    Args:
        memory: Memory map; unlock it before it is closed.
        device: One of the devices.
        block: Number of bytes that are locked together, a multiple of the page size; a copy must
            not cross blocks.

    Raises:
        OSError: CUDA cannot lock the memory.
    """

    def __init__(self, memory: mmap.mmap, device: Any, block: int) -> None:
        self._device = wp.device_from_jax(device)
        first, size = ctypes.addressof(ctypes.c_char.from_buffer(memory)), len(memory)
        portable = ctypes.c_uint(_PORTABLE)
        blocks = [(first + at, min(block, size - at)) for at in range(0, size, block)]
        self._locked: list[ctypes.c_void_p] = []
        with ThreadPoolExecutor(_POPULATING) as threads:
            there = [threads.submit(_populate, *one) for one in blocks]
            try:
                for populated, (address, length) in zip(there, blocks, strict=True):
                    populated.result()
                    arguments = ctypes.c_void_p(address), ctypes.c_size_t(length), portable
                    _call(self._device, "cuMemHostRegister_v2", *arguments)
                    self._locked.append(arguments[0])
            except OSError:
                self.unlock()
                raise

    def unlock(self) -> None:
        """Unlock the memory."""
        while self._locked:
            _call(self._device, "cuMemHostUnregister", self._locked.pop())


def _populate(address: int, size: int) -> None:
    """Allocate the pages of memory without the GIL, if the system supports it (Linux 5.14)."""
    libc = ctypes.CDLL(None)
    libc.madvise(ctypes.c_void_p(address), ctypes.c_size_t(size), _MADV_POPULATE_WRITE)


def wait_asleep(device: Any) -> None:
    """Let threads that wait for a device sleep; by default each keeps a core busy.

    Raises:
        OSError: CUDA rejects the setting.
    """
    of, number = wp.device_from_jax(device), ctypes.c_int()
    with registering:
        _ = of.context  # created by Warp on first access
    _call(of, "cuCtxGetDevice", ctypes.byref(number))
    _call(of, "cuDevicePrimaryCtxSetFlags_v2", number, ctypes.c_uint(_BLOCKING_SYNC))


def _call(device: wp.Device, name: str, *arguments: Any) -> None:
    """Call a function of the CUDA driver."""
    with device.context_guard:
        code = getattr(ctypes.CDLL("libcuda.so.1"), name)(*arguments)
    if code:
        raise OSError(f"{name} failed with error {code}")
