"""Launches of kernels: on the CPU each core takes frames; on CUDA each team of threads does."""

from collections.abc import Sequence
from functools import lru_cache, partial
from threading import Lock
from typing import Any

import numpy as np
import warp as wp

from jaxdet.runtime import threads
from jaxdet.runtime.layout import LINE

INT32: Any = wp.int32

MULTIPROCESSORS = 132
"""Number of multiprocessors of an H100 or H200; a launch has as many blocks as fit on them."""

registering = Lock()
"""Lock for Warp's tables of contexts, streams and kernels, which are not thread-safe: if two
threads request a module, Warp loads it twice and drops the first copy."""

_lock = Lock()
"""Lock that lets one kernel at a time run on the CPU, on all cores, with the memory ``_kept``."""


def on_cores(kernel: Any, arguments: Sequence[Any], frames: int, scratch: int) -> None:
    """Run a kernel on the CPU, once per thread: each thread takes frames until none is left.

    Args:
        kernel: Kernel with parameters ``arguments``, then ``scratch (words,)`` int32, which is
            reused by later calls, and ``next (1,)`` int32, the first frame that no thread has
            taken.
        arguments: Warp structs and numbers.
        frames: ``B``.
        scratch: Number of words of scratch memory per thread.
    """
    count = min(threads.threads(), frames)
    with _lock:
        following, value = _next()
        value[0] = 0
        calls = ([*arguments, _memory(thread, scratch), following] for thread in range(count))
        threads.on_all_cores([partial(_launch, kernel, values) for values in calls])


def _launch(kernel: Any, arguments: list[Any]) -> None:
    wp.launch(kernel, 1, arguments, device="cpu")


@lru_cache(maxsize=1)
def _next() -> tuple[Any, np.ndarray]:
    value = np.zeros(1, np.int32)
    return wp.array(value, dtype=INT32, device="cpu", copy=False), value


_kept: dict[int, Any] = {}  # scratch memory by thread


def _memory(thread: int, words: int) -> Any:
    """Return a thread's memory, aligned to a cache line, as large as the largest request so far."""
    if thread not in _kept or _kept[thread].size < words:
        room = np.empty(words + LINE, np.int32)
        first = -room.ctypes.data % (4 * LINE) // 4
        _kept[thread] = wp.array(room[first : first + words], dtype=INT32, device="cpu", copy=False)
    return _kept[thread]


def by_frame(module: Any, kernel: Any, batch: Any, frames: int, scratch: Any) -> None:
    """Launch a kernel whose threads on the CPU, or teams of threads on CUDA, take frames in turn.

    Args:
        module: Module with ``WIDTH``, the number of threads per team.
        kernel: Kernel with parameters ``batch``, ``scratch`` and ``next``, see :func:`on_cores`.
        batch: Its arrays, see :func:`filled`.
        frames: ``B``.
        scratch: Memory ``(teams, words)`` int32; on the CPU only its width is used.
    """
    teams, words = scratch.shape
    if scratch.device.is_cpu:
        on_cores(kernel, [batch], frames, words)
        return
    memory = scratch.flatten()
    inputs, size = [batch, memory, memory], teams * module.WIDTH
    wp.launch(kernel, size, inputs, device=scratch.device, block_dim=module.WIDTH)


def filled(struct: Any, **fields: Any) -> Any:
    """Return an instance of a Warp struct with these fields."""
    made = struct()
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def reported_words(module: Any, inputs: Sequence[Any], device: Any) -> int:
    """Return the number of words of scratch memory per thread or team, as the kernels report it.

    Args:
        module: Module with ``WIDTH`` and the kernel ``scratch_words``.
        inputs: Arguments of that kernel without the last; NumPy arrays are copied to the device.
        device: Warp device for which the module is loaded.
    """
    words = wp.zeros(1, dtype=INT32, device=device)
    arguments = [
        wp.array(one, dtype=INT32, device=device) if isinstance(one, np.ndarray) else one
        for one in inputs
    ]
    block = module.WIDTH
    wp.launch(module.scratch_words, 1, [*arguments, words], device=device, block_dim=block)
    return int(words.numpy()[0])
