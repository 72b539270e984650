"""CPU kernels frame by frame: a thread runs all kernels of a program on a frame, then on another.

Warp runs a CPU kernel's threads one after the other, but a launch does not hold Python's lock. So
each core takes the batch's next frame when it is done with one, in a loop that is a kernel itself:
after a launch Python would wait for its lock, which threads that read the next batch hold. What a
kernel hands to the next is memory of one frame, which the core's cache holds and the process keeps;
only what the program returns is there for the whole batch.
"""

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from threading import Lock
from typing import Any

import jax
import numpy as np
import warp as wp

from jaxdet.stages import _threads, _xla
from jaxdet.stages._launch import split_arguments
from jaxdet_kernels.chain import frame_loop

_LINE = 64  # bytes of a cache line, at which all memory begins


class FrameKernel:
    """A kernel under ``jax.jit`` that works on one frame of a batch a launch, on the CPU."""

    def __init__(self, kernel: Any) -> None:
        """Reads the kernel's signature.

        Args:
            kernel: Of :func:`~jaxdet_kernels.native_source.team_kernel`. Its outputs end in
                ``_out`` and have a row for every frame.
        """
        self.kernel = kernel
        self.types: dict[str, Any] = dict(kernel.func.__annotations__)
        del self.types["share"], self.types["shares"]
        self.inputs = [name for name in self.types if not name.endswith("_out")]
        *self.outputs, self.scratch = (name for name in self.types if name.endswith("_out"))
        self.name = f"{kernel.func.__module__}.{kernel.func.__qualname__}"

    def __call__(
        self, *arguments: Any, batch: int, shapes: Mapping[str, tuple[int, ...]], scratch: int
    ) -> Any:
        """The kernel's outputs; takes what :class:`~jaxdet.stages._teams.TeamKernel` takes.

        Raises:
            TypeError: An array has not the type or the number of axes that the kernel takes.
        """
        chain = _open.get()
        if chain is not None:
            return chain.add(self, arguments, batch, {**shapes, "scratch_out": (1, words(scratch))})
        return frame_by_frame(
            partial(self, *arguments, batch=batch, shapes=shapes, scratch=scratch)
        )

    def row(self, name: str, shape: tuple[int, ...]) -> int:
        """Bytes of a frame of an array."""
        return math.prod(shape[1:]) * wp.types.type_size_in_bytes(self.types[name].dtype)


def words(scratch: int) -> int:
    """32-bit words of scratch memory that a team gets: whole 16 bytes, at which it begins."""
    return 4 * max(-(-scratch // 4), 1)


@dataclass(frozen=True, eq=False)
class _Value:
    """An output of a kernel, while a chain is put together: what is known before it runs."""

    step: int
    name: str
    shape: tuple[int, ...]
    dtype: Any

    @property
    def ndim(self) -> int:
        return len(self.shape)


@dataclass(frozen=True)
class _Step:
    """A kernel of a chain."""

    kernel: FrameKernel
    scalars: dict[str, Any]
    sources: dict[str, int | tuple[int, str]]
    """Of each array that it takes: the number of an operand, or a step and its output."""
    shapes: dict[str, tuple[int, ...]]


class _Chain:
    """Kernels that are put together while JAX traces a program."""

    def __init__(self) -> None:
        self.frames = 0
        self.steps: list[_Step] = []
        self.operands: list[Any] = []

    def add(
        self,
        kernel: FrameKernel,
        arguments: Sequence[Any],
        frames: int,
        output_dims: Mapping[str, tuple[int, ...]],
    ) -> tuple[_Value, ...]:
        given = dict(zip(kernel.inputs, arguments, strict=True))
        arrays, scalars, shapes = split_arguments(given, kernel.types, output_dims)
        sources = {name: self._source(value) for name, value in arrays.items()}
        step, self.frames = len(self.steps), frames
        self.steps.append(_Step(kernel, scalars, sources, shapes))
        return tuple(
            _Value(step, name, shapes[name], wp.dtype_to_jax(kernel.types[name].dtype))
            for name in kernel.outputs
        )

    def _source(self, value: Any) -> int | tuple[int, str]:
        if isinstance(value, _Value):
            return value.step, value.name
        for number, operand in enumerate(self.operands):
            if operand is value:
                return number
        self.operands.append(value)
        return len(self.operands) - 1

    def call(self, found: Any) -> Any:
        """The arrays of a tree of values, all of them outputs of one custom call."""
        values, tree = jax.tree.flatten(found)
        results = {(value.step, value.name): value for value in values}
        program = _Program(self.frames, self.steps, len(self.operands), list(results))
        number = program.number
        _programs.setdefault(number, program)
        shapes = [jax.ShapeDtypeStruct(value.shape, value.dtype) for value in results.values()]
        arrays = _xla.called(_NAME, number, self.operands, shapes)
        of_value = dict(zip(results, arrays, strict=True))
        return tree.unflatten([of_value[value.step, value.name] for value in values])


_open: ContextVar[_Chain | None] = ContextVar("chain", default=None)  # what is being put together


def frame_by_frame(method: Callable[[], Any]) -> Any:
    """Runs the kernels that a method calls one after the other on each frame; under ``jax.jit``.

    Args:
        method: Calls kernels and nothing else: what they return has a shape, but no values yet.
            It returns a tree of such.

    Returns:
        The tree, of arrays.
    """
    chain = _Chain()
    token = _open.set(chain)
    try:
        found = method()
    finally:
        _open.reset(token)
    return chain.call(found)


def by_device(cpu: Callable[[], Any], cuda: Callable[[], Any]) -> Any:
    """What one of them returns: ``cpu``, where kernels are put together frame by frame."""
    if _open.get() is not None:
        return cpu()
    return jax.lax.platform_dependent(cpu=cpu, cuda=cuda)


@dataclass(frozen=True)
class _Program:
    """A chain that XLA calls, with the addresses of its operands and of its results."""

    frames: int
    steps: list[_Step]
    operands: int
    results: list[tuple[int, str]]
    workers: list["_Worker"] = field(default_factory=list)
    """One for each thread, once they are prepared."""
    next: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int32))
    """The first frame of a call that no thread has taken."""

    @property
    def number(self) -> int:
        """Of equal chains alike."""
        steps = [(s.kernel.name, s.scalars, s.sources, s.shapes) for s in self.steps]
        return _xla.number_of((self.frames, steps, self.operands, self.results))

    def place(self, source: int | tuple[int, str]) -> int:
        """Which of XLA's addresses an operand or a result has."""
        if isinstance(source, int):
            return source
        return self.operands + self.results.index(source)

    def run(self, addresses: Sequence[int]) -> None:
        """Works on the frames of a call."""
        count = min(_threads.threads(), self.frames)
        if len(self.workers) < count:
            recorded = self._recorded()
            self.workers.extend(_Worker(self, recorded, i) for i in range(len(self.workers), count))
        self.next[0] = 0
        for worker in self.workers[:count]:
            worker.place(addresses)
        _threads.on_all_cores([worker.run for worker in self.workers[:count]])

    def _recorded(self) -> list[Any]:
        """The launches of all steps, by Warp."""
        launches = []
        for step in self.steps:
            values = {
                name: step.scalars[name]
                if name in step.scalars
                else wp.array(ptr=_LINE, dtype=of.dtype, shape=step.shapes[name], device="cpu")
                for name, of in step.kernel.types.items()
            }
            given = [0, self.frames, *values.values()]
            launches.append(_launch(step.kernel.kernel, given))
        return launches


def _launch(kernel: Any, given: Sequence[Any]) -> Any:
    """A launch of one thread, recorded by Warp."""
    return wp.launch(kernel, 1, given, device="cpu", record_cmd=True)


class _Worker:
    """A thread's launches, with arguments that stay in place.

    The arguments of all launches are words of 64 bits that follow each other: a kernel's first word
    is the number of the frame and of all frames, others are addresses. To these a kernel adds the
    rows of the frames before, so the address of memory that has room for one frame is given as by
    so much less. ``frame_loop.h`` writes both and calls the kernels.
    """

    def __init__(self, program: _Program, recorded: Sequence[Any], thread: int) -> None:
        self._recorded, self._thread = recorded, thread  # which the compiled code belongs to
        layouts = [_layout(launch.params[1:]) for launch in recorded]
        self._words = np.frombuffer(b"".join(map(bytes, layouts)), np.uint64).copy()
        lengths = [ctypes.sizeof(layout) // 8 for layout in layouts]
        starts = np.cumsum([0, *lengths[:-1]]).tolist()
        begin = self._words.ctypes.data
        launches = [
            (_address(launch.hooks.forward), ctypes.addressof(launch.params[0]), begin + 8 * at, at)
            for launch, at in zip(recorded, starts, strict=True)
        ]
        self._room = _Room(program)
        given, kept = [], []
        for number, (step, layout) in enumerate(zip(program.steps, layouts, strict=True)):
            for i, name in enumerate(step.kernel.types):
                if name in step.scalars:
                    continue
                word = starts[number] + getattr(type(layout), f"argument_{i + 2}").offset // 8
                source = step.sources.get(name, (number, name))
                if source in self._room.places:
                    kept.append((word, *self._room.places[source]))
                else:
                    given.append((word, program.place(source)))
        self._given, self._number = np.array(given).T
        self._rooms = np.array(kept, np.uint64)
        self._offset = self._rooms[:, 1].copy()
        self._kernels = np.array(launches, np.uint64)
        tables = self._kernels, self._words, self._rooms, program.next
        self._loop = _launch(frame_loop, [*map(_shared, tables), program.frames])
        self._arguments = _layout(self._loop.params[1:])

    def place(self, addresses: Sequence[int]) -> None:
        """Takes the addresses of a call's arrays."""
        self._words[self._given] = np.array(addresses, np.uint64)[self._number]
        self._rooms[:, 1] = self._offset + np.uint64(_memory(self._thread, self._room.size))

    def run(self) -> None:
        """Takes frames until there are no more."""
        bounds, arguments = ctypes.byref(self._loop.params[0]), ctypes.byref(self._arguments)
        self._loop.hooks.forward(bounds, arguments)


def _shared(table: np.ndarray) -> Any:
    """The same memory for Warp."""
    dtype = wp.dtype_from_numpy(table.dtype)
    return wp.array(ptr=table.ctypes.data, dtype=dtype, shape=table.shape, device="cpu")


def _address(function: Any) -> int:
    """Of compiled code."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0


class _Room:
    """What a thread keeps of a frame: outputs that are not results, and scratch memory."""

    def __init__(self, program: _Program) -> None:
        self.places: dict[tuple[int, str], tuple[int, int]] = {}
        """By output, where it begins, and the bytes of its row."""
        end, scratch = 0, []
        for number, step in enumerate(program.steps):
            rows = {name: step.kernel.row(name, shape) for name, shape in step.shapes.items()}
            for name in step.kernel.outputs:
                if (number, name) not in program.results:
                    self.places[number, name] = end, rows[name]
                    end += -(-rows[name] // _LINE) * _LINE
            scratch.append(rows[step.kernel.scratch])
        # Scratch memory is the same for all, as one kernel is at work.
        for number, (step, row) in enumerate(zip(program.steps, scratch, strict=True)):
            self.places[number, step.kernel.scratch] = end, row
        self.size = end + max(scratch)


def _layout(values: Sequence[Any]) -> Any:
    """Arguments as the compiled kernel takes them: whole words, as some are addresses."""
    fields = [(f"argument_{i}", type(value)) for i, value in enumerate(values)]
    return type("_Arguments", (ctypes.Structure,), {"_fields_": fields})(*values)


_kept: dict[int, np.ndarray] = {}  # of each thread, its memory


def _memory(thread: int, size: int) -> int:
    """The address of a thread's memory, as much as was ever asked for."""
    if thread not in _kept or len(_kept[thread]) < size + _LINE:
        _kept[thread] = np.empty(size + _LINE, np.uint8)
    start = _kept[thread].ctypes.data
    return start + -start % _LINE


_NAME = "jaxdet.frames"
_programs: dict[int, _Program] = {}  # by number
_lock = Lock()  # one program runs at a time, on all cores


def _run(number: int, addresses: Sequence[int]) -> None:
    with _lock:
        _programs[number].run(addresses)


_xla.register(_NAME, _run)
