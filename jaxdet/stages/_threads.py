"""CPU kernels that work on a frame a thread, on all cores of this process.

Warp runs a CPU kernel's threads one after the other, but a launch does not hold Python's lock. So
the frames of a batch are shared out, and each core launches the kernel for its share: the calling
thread for the first, a thread each for the others.
"""

import ctypes
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from inspect import get_annotations
from threading import Lock, get_native_id
from typing import Any

import jax
import numpy as np
import warp as wp

from jaxdet.cores import cores
from jaxdet.stages import _xla


def threads() -> int:
    """How many threads a kernel may use: ``PJRT_NPROC``, as XLA, or one a core."""
    chosen = os.environ.get("PJRT_NPROC", "")
    return int(chosen) if chosen.isdecimal() and int(chosen) else cores()


def shares_of(frames: int) -> int:
    """Into how many shares a batch is dealt; scratch memory has a part for each."""
    return min(threads(), frames)


class FrameKernel:
    """A kernel under ``jax.jit`` whose launches on the CPU share the frames out.

    The kernel's first arguments are ``share`` and ``shares``, both int; its thread ``i`` works on
    frame ``share + shares * i``, and writes to nothing that another share uses.
    """

    def __init__(
        self,
        kernel: Any,
        num_outputs: int,
        in_out_argnames: Sequence[str] = (),
        num_kept: int = 0,
    ) -> None:
        """Registers the kernel with XLA.

        Args:
            kernel: Its inputs come first, then its outputs.
            num_outputs: With inputs that are outputs too, and those that are kept.
            in_out_argnames: Inputs that the kernel writes to and returns; the first outputs.
            num_kept: The last so many outputs are scratch memory: the kernel's own, from one call
                to the next, so that no call gets fresh pages of the system. They are not returned.
        """
        types = get_annotations(kernel.func, eval_str=True)
        del types["share"], types["shares"]
        inputs = len(types) + len(in_out_argnames) - num_outputs
        self._kernel, self._types, self._inputs = kernel, types, list(types)[:inputs]
        self._outputs = [*in_out_argnames, *list(types)[inputs : len(types) - num_kept]]
        self._kept = {name: _Memory(0) for name in list(types)[len(types) - num_kept :]}
        self._name = f"{kernel.func.__module__}.{kernel.func.__qualname__}"
        self._calls: dict[int, _Call] = {}
        _xla.register(self._name, self._run)

    def __call__(
        self, *arguments: Any, frames: int, output_dims: Mapping[Any, tuple[int, ...]]
    ) -> Sequence[jax.Array]:
        """The kernel's outputs but for those that are kept.

        Args:
            arguments: The kernel's inputs after ``share`` and ``shares``.
            frames: ``B``.
            output_dims: The shape of each output.

        Raises:
            TypeError: An array has not the type or the number of axes that the kernel takes.
        """
        given = dict(zip(self._inputs, arguments, strict=True))
        arrays = {name: value for name, value in given.items() if np.ndim(value)}
        for name, value in arrays.items():
            _check(name, value, self._types[name])
        shapes = {**{name: np.shape(value) for name, value in arrays.items()}, **output_dims}
        scalars = {name: value for name, value in given.items() if name not in arrays}
        results = [
            jax.ShapeDtypeStruct(shapes[name], wp.dtype_to_jax(self._types[name].dtype))
            for name in self._outputs
        ]
        order = list(arrays)
        aliases = {order.index(k): i for i, k in enumerate(self._outputs) if k in arrays}
        call = _Call(frames, shares_of(frames), scalars, shapes, order + self._outputs)
        number = call.number
        self._calls.setdefault(number, call)
        return _xla.called(self._name, number, list(arrays.values()), results, aliases)

    def _run(self, number: int, addresses: Sequence[int]) -> None:
        call = self._calls[number]
        with _lock:
            if not call.launches:
                self._prepare(call)
            kept = [self._memory(name, call.shapes[name]) for name in self._kept]
            for launch in call.launches:
                for place, address in zip(launch.places, (*addresses, *kept), strict=True):
                    place.value = address
            _on_all_cores([launch.run for launch in call.launches])

    def _prepare(self, call: "_Call") -> None:
        """Records the launches of a call; to set all of their arguments anew takes longer."""
        values = {
            name: call.scalars[name]
            if name in call.scalars
            else wp.array(ptr=64, dtype=of.dtype, shape=call.shapes[name], device="cpu")
            for name, of in self._types.items()
        }
        names = ["share", "shares", *values]
        arrays = [names.index(name) for name in (*call.order, *self._kept)]
        for share in range(call.shares):
            given, frames = [share, call.shares, *values.values()], call.frames - share
            threads = -(-frames // call.shares)
            recorded = wp.launch(self._kernel, threads, given, device="cpu", record_cmd=True)
            call.launches.append(_Launch(recorded, arrays))

    def _memory(self, name: str, shape: tuple[int, ...]) -> int:
        """The address of memory that is kept, as much as was ever asked for; at 64 bytes."""
        size = math.prod(shape) * wp.types.type_size_in_bytes(self._types[name].dtype)
        if self._kept[name].size < size:
            self._kept[name] = _Memory(size)
        return self._kept[name].address


@dataclass(frozen=True)
class _Call:
    """A kernel's call in a program."""

    frames: int
    shares: int
    scalars: dict[str, Any]
    shapes: dict[str, tuple[int, ...]]
    order: list[str]
    """Of the addresses that XLA gives."""
    launches: list["_Launch"] = field(default_factory=list)
    """One for each share, once they are recorded."""

    @property
    def number(self) -> int:
        """Of equal calls alike in all processes: programs are kept on disk with it."""
        what = repr((self.frames, self.shares, self.scalars, self.shapes, self.order))
        return int.from_bytes(blake2b(what.encode(), digest_size=7).digest(), "big")


class _Launch:
    """A recorded launch whose arguments stay in place.

    :meth:`warp.Launch.launch` gathers them anew each time, which takes longer than all else here.
    """

    def __init__(self, recorded: Any, arrays: Sequence[int]) -> None:
        """Lays out the arguments as the compiled kernel takes them.

        Args:
            recorded: By Warp.
            arrays: Numbers of the arguments whose addresses change.
        """
        self._bounds, *values = recorded.params
        fields = [(f"argument_{i}", type(value)) for i, value in enumerate(values)]
        layout = type("_Arguments", (ctypes.Structure,), {"_fields_": fields})
        self._arguments = layout(*values)
        self._recorded = recorded  # which the compiled code belongs to
        self._forward = recorded.hooks.forward
        self.places = [
            ctypes.c_uint64.from_buffer(getattr(self._arguments, f"argument_{i}")) for i in arrays
        ]
        """The arrays' addresses, first in what Warp tells of an array."""

    def run(self) -> None:
        """Runs it."""
        self._forward(ctypes.byref(self._bounds), ctypes.byref(self._arguments))


class _Memory:
    """Bytes that begin with a cache line."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._bytes = np.empty(size + 64, np.uint8)
        start = self._bytes.ctypes.data
        self.address = start + -start % 64


_lock = Lock()
"""One kernel runs at a time, on all cores."""


def _check(name: str, value: Any, of: Any) -> None:
    wanted = jax.numpy.dtype(wp.dtype_to_jax(of.dtype)), of.ndim
    if (value.dtype, value.ndim) != wanted:
        raise TypeError(f"{name} is {value.dtype} of {value.ndim} axes, not {wanted}")


def _on_all_cores(work: Sequence[Callable[[], None]]) -> None:
    """Does the first in this thread and the others in threads of their own, at the same time."""
    own, *others = work
    if not others:
        own()
        return
    crew, started = _crew(), []
    try:
        for thread, other in zip(crew.threads, others, strict=False):
            started.append(thread.start(other))
        crew.place_caller()
        own()
    finally:
        wait(started)  # they use the arguments' memory
    for other in started:
        other.result()


class _Thread:
    """A thread that starts each piece of work on the same core, where all cores are used.

    Left alone, the system puts threads that wake each other on one core for milliseconds. Kept
    there for good, a thread would have to wait where another program has that core.
    """

    def __init__(self, core: int | None, allowed: set[int]) -> None:
        self._pool = ThreadPoolExecutor(1, "jaxdet-kernel")
        self._id = self._pool.submit(get_native_id).result()
        self._core, self._allowed = core, allowed

    def start(self, work: Callable[[], None]) -> Future[None]:
        """Starts it; the thread may be moved once it has been woken."""
        if self._core is None:
            return self._pool.submit(work)
        os.sched_setaffinity(self._id, {self._core})
        try:
            return self._pool.submit(work)
        finally:
            os.sched_setaffinity(self._id, self._allowed)


class _Crew:
    """The threads beside the caller's, :func:`threads` with it."""

    def __init__(self) -> None:
        self._allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        count = threads()
        places = sorted(self._allowed) if len(self._allowed) == count else [None] * count
        self._core = places[0]
        self.threads = [_Thread(place, self._allowed) for place in places[1:]]

    def place_caller(self) -> None:
        """Moves the calling thread to the core that the others leave; it may be moved again."""
        if self._core is not None:
            os.sched_setaffinity(0, {self._core})
            os.sched_setaffinity(0, self._allowed)


@lru_cache(maxsize=1)
def _crew() -> _Crew:
    return _Crew()
