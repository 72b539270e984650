"""Functions on Warp's arrays that jitted programs call, on the CPU and on CUDA."""

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from types import ModuleType
from typing import Any

import jax
import warp as wp

from jaxdet.runtime.compiled import load_for_cpu
from jaxdet.runtime.launch import MULTIPROCESSORS
from jaxdet.signals import stops_held_back

SCRATCH_SHARE = 8
"""Of a CUDA device's memory, the scratch memory of all teams is at most one of so many parts; fewer
teams work where theirs is larger."""


def jax_callable(
    kernels: ModuleType, types: Sequence[Any], outputs: int
) -> Callable[[Callable[..., None]], Any]:
    """Makes a function that launches kernels callable under ``jax.jit``.

    Its arguments are arrays of Warp's, the last ones are outputs, whose shapes a call gives as
    ``output_dims``. It has no scalars: Warp numbers the values of scalars without a lock,
    so two threads that trace at the same time could get each other's.

    :func:`warp.jax_callable` is experimental. It runs one function at a time in a process. XLA
    records no CUDA graph of it: from batch to batch the arrays move, and a graph would be made
    anew.

    Args:
        kernels: The module whose kernels it launches; Warp loads it before a call.
        types: Warp's types of the arguments.
        outputs: How many of its arguments are outputs.
    """

    def decorate(function: Callable[..., None]) -> Any:
        function.__module__ = kernels.__name__
        function.__annotations__ = dict(zip(signature(function).parameters, types, strict=True))
        made = wp.jax_callable(
            function,
            num_outputs=outputs,
            graph_mode=wp.JaxCallableGraphMode.NONE,
            vmap_method=None,
            module_preload_mode=wp.JaxModulePreloadMode.NONE,
        )

        def call(*arrays: Any, output_dims: Mapping[str, tuple[int, ...]]) -> Any:
            prepare(kernels)
            return made(*arrays, output_dims=dict(output_dims))

        return call

    return decorate


def by_device(cpu: Callable[[], Any], cuda: Callable[[], Any]) -> Any:
    """What one of two functions returns, by the device that a jitted program runs on."""
    return jax.lax.platform_dependent(cpu=cpu, cuda=cuda)


def prepare(module: Any) -> None:
    """Load a module's kernels for the device that JAX computes on."""
    if jax.default_backend() == "cpu":
        load_for_cpu(module)


def device_of_jax(module: Any) -> Any:
    """Return the device that JAX computes on as Warp's, with a module's kernels loaded."""
    prepare(module)
    return wp.device_from_jax(jax.local_devices()[0])


def most_teams(frames: int, words: int, blocks: int) -> int:
    """How many teams of a launch get so many words of scratch memory on the default device."""
    stats = jax.local_devices()[0].memory_stats() or {}
    room = stats.get("bytes_limit", SCRATCH_SHARE << 30) // SCRATCH_SHARE
    return min(frames, blocks * MULTIPROCESSORS, max(room // (4 * max(words, 1)), 1))


def uninterrupted(program: Callable[..., Any], *arguments: Any) -> Any:
    """Calls a jitted program; a Ctrl-C waits for it.

    XLA calls functions of Python in the caller's thread, where Python raises KeyboardInterrupt.
    Warp takes that for success, and results would be whatever the memory held.
    """
    with stops_held_back():
        return program(*arguments)
