"""Launches of kernels on all cores of the CPU, and the sizes of the scratch memory of kernels."""

from collections.abc import Sequence
from functools import partial
from threading import Lock
from typing import Any

import numpy as np
import warp as wp

from jaxdet.runtime import threads
from jaxdet.runtime.layout import LINE
from jaxdet_kernels.build import WIDTH

INT32: Any = wp.int32

MULTIPROCESSORS = 132
"""Number of multiprocessors of an H100 or H200; a launch has as many blocks as fit on them."""

registering = Lock()
"""Lock for Warp's tables of contexts, streams and kernels, which are not thread-safe: if two
threads request a module at once, Warp loads it twice and drops the first copy."""

_lock = Lock()
"""Lock of a kernel that runs on the CPU: it uses all cores and the scratch memory in ``_kept``."""


def on_cores(kernel: Any, arguments: Sequence[Any], frames: int, scratch: int) -> None:
    """Run a kernel on the CPU, once per thread: each thread takes frames until none is left.

    Args:
        kernel: Kernel with parameters ``arguments``, then ``scratch (words,)`` int32, which is
            reused by later calls, and ``next (1,)`` int32, the index of the first frame that no
            thread has taken.
        arguments: Warp arrays, structs and numbers.
        frames: Number of frames, ``B``.
        scratch: Number of words of scratch memory per thread.
    """
    count = min(threads.threads(), frames)
    with _lock:
        following = wp.zeros(1, dtype=INT32, device="cpu")
        calls = ([*arguments, _memory(thread, scratch), following] for thread in range(count))
        launch = partial(wp.launch, kernel, 1, device="cpu")
        threads.on_all_cores([partial(launch, inputs=inputs) for inputs in calls])


_kept: dict[int, Any] = {}  # scratch memory by thread


def _memory(thread: int, words: int) -> Any:
    """Return a thread's scratch memory, at least ``words`` words, aligned to a cache line."""
    if thread not in _kept or _kept[thread].size < words:
        room = np.empty(words + LINE, np.int32)
        first = -room.ctypes.data % (4 * LINE) // 4
        _kept[thread] = wp.array(room[first : first + words], dtype=INT32, device="cpu", copy=False)
    return _kept[thread]


def reported_words(kernel: Any, inputs: Sequence[Any], device: Any) -> int:
    """Return the number of words of scratch memory per thread or team, as a kernel reports it.

    Args:
        kernel: Kernel that writes the number to the last of its arguments.
        inputs: The other arguments; NumPy arrays are copied to the device.
        device: Warp device for which the kernel is loaded.
    """
    words = wp.zeros(1, dtype=INT32, device=device)
    arguments = [
        wp.array(one, dtype=INT32, device=device) if isinstance(one, np.ndarray) else one
        for one in inputs
    ]
    wp.launch(kernel, 1, [*arguments, words], device=device, block_dim=WIDTH)
    return int(words.numpy()[0])
