"""Launches of kernels: on the CPU's cores, each takes frames; on CUDA, a team of threads does."""

from collections.abc import Sequence
from functools import lru_cache, partial
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from jaxdet.runtime import threads
from jaxdet.runtime.layout import LINE

INT32: Any = wp.int32

MULTIPROCESSORS = 132
"""Of an H100 or H200; a launch has as many blocks as fit on so many at once."""

registering = Lock()
"""Warp keeps contexts, streams and kernels of all devices in tables without a lock, and loads a
module twice that two threads ask for, and drops the first."""

_lock = Lock()
"""One kernel at a time runs on all cores, with the memory below."""


def on_cores(kernel: Any, arguments: Sequence[Any], frames: int, scratch: int) -> None:
    """Runs a kernel on the CPU, once per thread: each thread takes frames until none is left.

    Args:
        kernel: Takes ``arguments``, then ``scratch (words,)`` int32, which the process keeps, and
            ``next (1,)`` int32, the first frame that no thread has taken.
        arguments: Arrays of Warp's, numbers.
        frames: ``B``.
        scratch: Words of scratch memory of a thread.
    """
    count = min(threads.threads(), frames)
    with _lock:
        following, value = _next()
        value[0] = 0
        given = ([*arguments, _memory(thread, scratch), following] for thread in range(count))
        threads.on_all_cores([partial(_launch, kernel, values) for values in given])


def _launch(kernel: Any, arguments: list[Any]) -> None:
    wp.launch(kernel, 1, arguments, device="cpu")


@lru_cache(maxsize=1)
def _next() -> tuple[Any, np.ndarray]:
    value = np.zeros(1, np.int32)
    return wp.array(value, dtype=INT32, device="cpu", copy=False), value


_kept: dict[int, Any] = {}  # of each thread


def _memory(thread: int, words: int) -> Any:
    """The memory of a thread, as large as the largest that was requested, at a cache line."""
    if thread not in _kept or _kept[thread].size < words:
        room = np.empty(words + LINE, np.int32)
        first = -room.ctypes.data % (4 * LINE) // 4
        _kept[thread] = wp.array(room[first : first + words], dtype=INT32, device="cpu", copy=False)
    return _kept[thread]


def by_frame(module: Any, kernel: Any, arguments: Sequence[Any], frames: int, scratch: Any) -> None:
    """Launch a kernel whose threads on the CPU, or teams of threads on CUDA, take frames in turn.

    Args:
        module: Has ``WIDTH``, the threads of a team.
        kernel: Takes ``arguments``, ``scratch`` and ``next``, see :func:`on_cores`.
        arguments: Arrays of Warp's.
        frames: ``B``.
        scratch: ``(teams, words)`` int32; the CPU takes only its width.
    """
    teams, words = scratch.shape
    if scratch.device.is_cpu:
        on_cores(kernel, arguments, frames, words)
        return
    memory = scratch.flatten()
    given, size = [*arguments, memory, memory], teams * module.WIDTH
    wp.launch(kernel, size, given, device=scratch.device, block_dim=module.WIDTH)


class TeamKernel(NamedTuple):
    """A kernel for CUDA whose blocks take the frames of a batch in turn, see ``team.h``.

    Its arguments are arrays, numbers and then ``teams``, how many blocks there are.
    """

    kernel: Any
    width: int
    """Threads of a block."""
    blocks: int
    """How many blocks are on a multiprocessor at once."""

    def launch(self, given: Sequence[Any], frames: int, most: int) -> None:
        """Launches it on the device of the first array, by at most so many teams."""
        teams = min(frames, most, self.blocks * MULTIPROCESSORS)
        size, device = teams * self.width, given[0].device
        wp.launch(self.kernel, size, [*given, teams], device=device, block_dim=self.width)


def reported_words(module: Any, inputs: Sequence[Any], device: Any) -> int:
    """Return the words of scratch memory of a thread or a team, which a module's kernels know.

    Args:
        module: Has ``WIDTH`` and the kernel ``scratch_words``.
        inputs: Arguments of that kernel but the last; NumPy arrays are copied to the device.
        device: Warp's device, for which the module is loaded.
    """
    words = wp.zeros(1, dtype=INT32, device=device)
    given = [
        wp.array(one, dtype=INT32, device=device) if isinstance(one, np.ndarray) else one
        for one in inputs
    ]
    block = module.WIDTH
    wp.launch(module.scratch_words, 1, [*given, words], device=device, block_dim=block)
    return int(words.numpy()[0])
