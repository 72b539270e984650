"""Calls of Warp kernels by jitted JAX programs, on the CPU and on CUDA."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from hashlib import blake2b
from inspect import Parameter, Signature, signature
from types import FunctionType, ModuleType
from typing import Any

import jax
import warp as wp

from jaxdet.runtime.compiled import load_for_cpu
from jaxdet.runtime.launch import MULTIPROCESSORS, on_cores, reported_words
from jaxdet.signals import stops_held_back
from jaxdet_kernels.build import BLOCKS, WIDTH

SCRATCH_SHARE = 8
"""Divisor of a CUDA device's memory that gives the maximum scratch memory of all teams together. If
this is too little for all teams, fewer teams are launched."""


def jax_callable(
    kernels: ModuleType, types: Sequence[Any], outputs: int
) -> Callable[[FunctionType], Any]:
    """Return a decorator that lets ``jax.jit`` programs call a function that launches kernels.

    The function's arguments are Warp arrays, the last of which are outputs; a call passes their
    shapes as ``output_dims``. Scalars are not supported: Warp numbers their values without a lock,
    so two threads that trace at the same time could receive each other's values.

    :func:`warp.jax_callable` is experimental. It runs one function at a time per process. No CUDA
    graph is recorded, because arrays have other addresses in each batch, so that the graph would
    have to be recorded again.

    Warp numbers the calls of a function in the order in which programs are traced, and JAX's
    compilation cache only finds a program with equal numbers. So each set of shapes gets its own
    copy of the function, with a hash of the shapes in its name; its first call has number 0.

    Args:
        kernels: Module whose kernels the function launches; they are loaded before a call.
        types: Warp types of the arguments.
        outputs: Number of arguments that are outputs.
    """

    def decorate(function: FunctionType) -> Any:
        function.__module__ = kernels.__name__
        function.__annotations__ = dict(zip(signature(function).parameters, types, strict=True))

        @cache
        def made(shapes: str) -> Any:
            digest = blake2b(shapes.encode(), digest_size=8).hexdigest()
            return wp.jax_callable(
                _copy(function, f"{function.__qualname__}_{digest}"),
                num_outputs=outputs,
                graph_mode=wp.JaxCallableGraphMode.NONE,
                vmap_method=None,
                module_preload_mode=wp.JaxModulePreloadMode.NONE,
            )

        def call(*arrays: Any, output_dims: Mapping[str, tuple[int, ...]]) -> Any:
            prepare(kernels)
            dims = dict(output_dims)
            shapes = f"{[array.shape for array in arrays]} {dims}"
            return made(shapes)(*arrays, output_dims=dims)

        return call

    return decorate


def _copy(function: FunctionType, name: str) -> FunctionType:
    """Return a copy of a function, with ``name`` as the qualified name that Warp reads."""
    parts = function.__code__, function.__globals__, function.__name__, None, function.__closure__
    made = FunctionType(*parts)
    made.__qualname__, made.__module__ = name, function.__module__
    made.__annotations__ = function.__annotations__
    made.__dict__.update(function.__dict__)
    return made


def frame_kernel(
    kernels: ModuleType, kernel: Any, words: Any, outputs: int
) -> Callable[..., Sequence[jax.Array]]:
    """Return a function that runs a kernel on a batch and can be called under ``jax.jit``.

    The function's arguments are the inputs of the kernel; ``size``, the arguments of ``words``; and
    ``output_dims``, the shapes of the outputs by name. It returns the outputs. The frames are
    divided among threads on the CPU, and among teams of threads on CUDA.

    Args:
        kernels: Module of the kernel.
        kernel: Kernel whose parameters are arrays, the first with ``B`` rows and the last the
            outputs, then ``scratch`` and ``next`` as for :func:`on_cores`.
        words: Kernel that reports the size of scratch memory, see :func:`reported_words`.
        outputs: Number of outputs.
    """

    def launch(*arrays: Any) -> None:
        *batch, scratch = arrays
        if scratch.device.is_cpu:
            on_cores(kernel, batch, len(batch[0]), scratch.shape[1])
            return
        memory, threads = scratch.flatten(), len(scratch) * WIDTH
        inputs = [*batch, memory, memory]  # ``next`` is only used on the CPU
        wp.launch(kernel, threads, inputs, device=scratch.device, block_dim=WIDTH)

    types = {**kernel.func.__annotations__, "scratch": wp.array2d[wp.int32]}
    del types["next"]
    launch.__qualname__ = kernel.key
    launch.__signature__ = Signature([Parameter(s, Parameter.POSITIONAL_OR_KEYWORD) for s in types])
    program = jax_callable(kernels, list(types.values()), outputs + 1)(launch)

    def call(*inputs: jax.Array, size: Sequence[int], output_dims: Mapping[str, Any]) -> Any:
        room = reported_words(words, size, device_of_jax(kernels))

        def on(teams: int) -> Any:
            return program(*inputs, output_dims={**output_dims, "scratch": (teams, room)})[:-1]

        most = most_teams(len(inputs[0]), room)
        return jax.lax.platform_dependent(cpu=lambda: on(1), cuda=lambda: on(most))

    return call


def prepare(module: Any) -> None:
    """Load a module's kernels for the device that JAX computes on."""
    if jax.default_backend() == "cpu":
        load_for_cpu(module)


def device_of_jax(module: Any) -> Any:
    """Return the Warp device that JAX computes on, after a module's kernels are loaded for it."""
    prepare(module)
    return wp.device_from_jax(jax.local_devices()[0])


def most_teams(frames: int, words: int) -> int:
    """Return the number of teams to launch, limited by frames, processors and scratch memory."""
    stats = jax.local_devices()[0].memory_stats() or {}
    room = min(stats.get("bytes_limit", SCRATCH_SHARE << 30) // SCRATCH_SHARE // 4, 2**31 - 1)
    return min(frames, BLOCKS * MULTIPROCESSORS, max(room // max(words, 1), 1))


def uninterrupted(program: Callable[..., Any], *arguments: Any) -> Any:
    """Call a jitted program; Ctrl-C is delayed until it returns.

    XLA calls Python functions in the caller's thread, where Python raises KeyboardInterrupt. Warp
    treats that as success, and the results would be uninitialized memory.
    """
    with stops_held_back():
        return program(*arguments)
