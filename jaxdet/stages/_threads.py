"""CPU kernels that work on a frame a thread, on all cores of this process.

Warp runs a CPU kernel's threads one after the other, but a launch does not hold Python's lock. So
the frames of a batch are shared out, and each core launches the kernel for its share: the calling
thread for the first, a thread each for the others.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import lru_cache
from inspect import Parameter, Signature, get_annotations
from threading import Lock, get_native_id
from typing import Any

import jax
import warp as wp

from jaxdet.cores import cores


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

    def __init__(self, kernel: Any, num_outputs: int, in_out_argnames: Sequence[str] = ()) -> None:
        form = {"num_outputs": num_outputs, "in_out_argnames": list(in_out_argnames)}
        self._alone = wp.jax_kernel(kernel, **form)
        self._shared = wp.jax_callable(_on_all_cores(kernel), **form)

    def __call__(
        self, *arguments: Any, frames: int, output_dims: Mapping[Any, tuple[int, ...]]
    ) -> Sequence[jax.Array]:
        """The kernel's outputs.

        Args:
            arguments: The kernel's inputs after ``share`` and ``shares``.
            frames: ``B``.
            output_dims: The shape of each output.
        """
        shares = shares_of(frames)
        if shares < 2:
            return self._alone(0, 1, *arguments, launch_dims=(frames,), output_dims=output_dims)
        return self._shared(frames, shares, *arguments, output_dims=output_dims)


def _on_all_cores(kernel: Any) -> Callable[..., None]:
    """A function for ``wp.jax_callable`` with the kernel's arguments but ``share``."""
    launches: list[Any] = []  # recorded: to set arguments anew takes a third of the time
    lock = Lock()

    def ready(share: int, frames: int, arguments: Sequence[Any]) -> wp.Launch:
        given = [share, *arguments]
        if share == len(launches):
            launches.append(wp.launch(kernel, frames, given, device="cpu", record_cmd=True))
        launch = launches[share]
        launch.set_dim(frames)
        for index, value in enumerate(given):
            launch.set_param_at_index(index, value)
        return launch

    def on_all_cores(frames: int, shares: int, *arguments: Any) -> None:
        with lock:
            own, *others = [
                ready(share, -(-(frames - share) // shares), (shares, *arguments)).launch
                for share in range(shares)
            ]
            crew, started = _crew(), []
            try:
                for thread, launch in zip(crew.threads, others, strict=False):
                    started.append(thread.start(launch))
                crew.place_caller()
                own()
            finally:
                wait(started)  # they use the arguments' memory
        for launch in started:
            launch.result()

    return _typed_as(on_all_cores, kernel.func)


def _typed_as(function: Callable[..., None], kernel: Callable[..., Any]) -> Callable[..., None]:
    """Gives a function the names and types that Warp reads off a kernel's own."""
    types = {"frames": int, **get_annotations(kernel, eval_str=True)}
    del types["share"]
    parameters = [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in types]
    function.__signature__ = Signature(parameters)
    function.__annotations__ = types
    function.__module__, function.__qualname__ = kernel.__module__, f"{kernel.__qualname__}_shared"
    return function


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
