"""Kernels whose frames are worked on by teams of threads: blocks on CUDA, single threads on CPUs.

One source serves both, see ``kernels/jaxdet_kernels/native/team.h``.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxdet.stages._chain import FrameKernel, by_device, words
from jaxdet.stages._launch import BatchKernel
from jaxdet.types import Array

MULTIPROCESSORS = 132
"""Of an H100 or H200; a launch has as many blocks as fit on so many at once."""

SCRATCH_SHARE = 8
"""Of a CUDA device's memory, the scratch memory of all teams is at most one of so many parts; fewer
teams work where theirs is larger."""

LIMIT = 1 << 30  # of a setting or of an entry of a table: no length is longer

Tables = dict[str, Array]
"""The tables and settings of a kernel, by the names of its arguments."""


def kernel_table(values: ArrayLike) -> np.ndarray:
    """A table or settings as kernels take them: int32, nothing above ``LIMIT``."""
    return np.minimum(values, LIMIT).astype(np.int32)


def kernel_tables(**values: ArrayLike) -> Tables:
    """The same of several arguments, by name."""
    return {name: kernel_table(one) for name, one in values.items()}


class TeamKernel:
    """A kernel under ``jax.jit`` whose teams take the frames of a batch in turn."""

    def __init__(self, kernel: Any) -> None:
        """Prepares the launches.

        Args:
            kernel: Of :func:`~jaxdet_kernels.native_source.team_kernel`. On CUDA a team has as
                many threads as a block may have by its ``launch_bounds``.
        """
        self._width, blocks = kernel.options["launch_bounds"]
        self._most_teams = blocks * MULTIPROCESSORS
        self._by_cores = FrameKernel(kernel)
        self.outputs = self._by_cores.outputs
        """Their names, but for the scratch memory."""
        self._by_blocks = BatchKernel(kernel, self._width)

    def __call__(
        self,
        *first: Any,
        batch: int,
        shapes: Mapping[str, tuple[int, ...]],
        scratch: int,
        **others: Any,
    ) -> tuple[jax.Array, ...]:
        """The kernel's outputs but for the scratch memory.

        Args:
            first: The first of the kernel's inputs after ``share`` and ``shares``.
            others: Those after them, by name.
            batch: ``B``.
            shapes: The shape of each output but for the scratch memory.
            scratch: 32-bit words of scratch memory of a team; it begins at 16 bytes.
        """
        arguments = *first, *(others[name] for name in self._by_cores.inputs[len(first) :])

        def by_blocks() -> tuple[jax.Array, ...]:
            fitting = max(_scratch_bytes() // (4 * max(scratch, 1)), 1)
            teams = min(batch, self._most_teams, fitting)
            size = (teams * self._width,)
            dims = {**shapes, "scratch_out": (teams, words(scratch))}
            return self._by_blocks(0, teams, *arguments, launch_dims=size, output_dims=dims)[:-1]

        by_cores = partial(self._by_cores, *arguments, batch=batch, shapes=shapes, scratch=scratch)
        return by_device(by_cores, by_blocks)


def _scratch_bytes() -> int:
    """What all teams of a launch may take on the default device."""
    stats = jax.local_devices()[0].memory_stats() or {}
    return stats.get("bytes_limit", SCRATCH_SHARE << 30) // SCRATCH_SHARE
