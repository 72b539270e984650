"""Kernels that CUDA launches under ``jax.jit``, each on a whole batch.

:func:`warp.jax_kernel` makes out shapes, strides and types at every call: 0.1 ms of Python, more
than many a kernel takes. Here Warp records a launch when a program runs first, and a call writes
the addresses of its buffers into it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import jax
import numpy as np
import warp as wp

from jaxdet.stages import _xla

_ADDRESS = 64
"""Of arrays while a launch is recorded."""
registering = Lock()
"""Warp keeps contexts, streams and kernels of all devices in tables without a lock, and loads a
module twice that two threads ask for, and drops the first."""


class BatchKernel:
    """A kernel under ``jax.jit``, on CUDA.

    Args:
        kernel: Its arguments are inputs, and then outputs, whose names end in ``_out``.
        block_dim: Threads of a block.
    """

    def __init__(self, kernel: Any, block_dim: int) -> None:
        self.kernel, self.block_dim = kernel, block_dim
        self.types: dict[str, Any] = dict(kernel.func.__annotations__)
        self.outputs = [name for name in self.types if name.endswith("_out")]
        self.name = f"{kernel.func.__module__}.{kernel.func.__qualname__}"

    def __call__(
        self,
        *arguments: Any,
        launch_dims: tuple[int, ...],
        output_dims: Mapping[str, tuple[int, ...]] | None = None,
    ) -> tuple[jax.Array, ...]:
        """The kernel's outputs.

        Args:
            arguments: The inputs, and the first outputs where the kernel goes on from what they
                are.
            launch_dims: How many threads.
            output_dims: The shapes of the other outputs.

        Raises:
            TypeError: An array has not the type or the number of axes that the kernel takes.
        """
        given = dict(zip(self.types, arguments, strict=False))
        arrays, scalars, shapes = split_arguments(given, self.types, output_dims or {})
        # Where an output is given, both have one address.
        places = {name: place for place, name in enumerate([*arrays, *self.outputs])}
        launch = _Launch(self, launch_dims, scalars, shapes, places)
        number = launch.number
        _launches.setdefault(number, launch)
        results = [
            jax.ShapeDtypeStruct(shapes[name], wp.dtype_to_jax(self.types[name].dtype))
            for name in self.outputs
        ]
        changed = {
            place: self.outputs.index(name)
            for place, name in enumerate(arrays)
            if name in self.outputs
        }
        return _xla.called(_NAME, number, list(arrays.values()), results, changed)


@dataclass(frozen=True)
class _Launch:
    """A launch that XLA calls with the addresses of its arrays."""

    kernel: BatchKernel
    dims: tuple[int, ...]
    scalars: dict[str, Any]
    shapes: dict[str, tuple[int, ...]]
    places: dict[str, int]
    """Which address each array has."""
    recorded: dict[int, "_Recorded"] = field(default_factory=dict)
    """For each device."""
    lock: Lock = field(default_factory=Lock)

    @property
    def number(self) -> int:
        """Of equal launches alike."""
        parts = self.kernel.name, self.kernel.block_dim, self.dims, self.scalars, self.shapes
        return _xla.number_of((*parts, self.places))

    def run(self, addresses: Sequence[int], device: int, stream: int) -> None:
        """Launches the kernel."""
        with self.lock:
            if device not in self.recorded:
                with registering:
                    self.recorded[device] = self._record(device)
            launch, pointers, streams = self.recorded[device]
            for array, place in pointers:
                array.data = addresses[place]
            if stream not in streams:
                with registering:
                    streams[stream] = wp.Stream(launch.device, cuda_stream=stream)
            launch.launch(streams[stream])

    def _record(self, number: int) -> "_Recorded":
        """The launch on a device, by Warp."""
        device, types = f"cuda:{number}", self.kernel.types
        values = [
            self.scalars[name]
            if name in self.scalars
            else wp.array(ptr=_ADDRESS, dtype=of.dtype, shape=self.shapes[name], device=device)
            for name, of in types.items()
        ]
        launch: Any = wp.launch(
            self.kernel.kernel,
            self.dims,
            values,
            device=device,
            block_dim=self.kernel.block_dim,
            record_cmd=True,
        )
        arrays = zip(types, launch.params[1:], strict=True)  # after how many threads there are
        pointers = [(array, self.places[name]) for name, array in arrays if name in self.places]
        return launch, pointers, {}


_Recorded = tuple[Any, list[tuple[Any, int]], dict[int, wp.Stream]]
"""A launch, its arrays as the kernel gets them with the number of their address, and XLA's
streams."""


def split_arguments(
    given: Mapping[str, Any], types: Mapping[str, Any], output_dims: Mapping[str, tuple[int, ...]]
) -> tuple[dict[str, Any], dict[str, Any], dict[str, tuple[int, ...]]]:
    """The arrays and the scalars among a kernel's arguments, and the shapes of all arrays.

    Raises:
        TypeError: An array has not the type or the number of axes that the kernel takes.
    """
    arrays = {name: value for name, value in given.items() if np.ndim(value)}
    for name, value in arrays.items():
        wanted = jax.numpy.dtype(wp.dtype_to_jax(types[name].dtype)), types[name].ndim
        if (jax.numpy.dtype(value.dtype), value.ndim) != wanted:
            raise TypeError(f"{name} is {value.dtype} of {value.ndim} axes, not {wanted}")
    scalars = {name: value for name, value in given.items() if name not in arrays}
    return arrays, scalars, {**{k: np.shape(v) for k, v in arrays.items()}, **output_dims}


_NAME = "jaxdet.launch"
_launches: dict[int, _Launch] = {}
"""By number."""


def _run(number: int, addresses: Sequence[int], device: int, stream: int) -> None:
    _launches[number].run(addresses, device, stream)


_xla.register_cuda(_NAME, _run)
