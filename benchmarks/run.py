"""Timing of cases: warm-up, separate compile time, ratio to a peer timed in the same run."""

import math
import os
import statistics
import time
from collections.abc import Callable
from importlib import import_module
from multiprocessing import active_children
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

TURN_S = 0.02
"""Duration of the calls of one function before the next function's turn [s]."""


class Case(NamedTuple):
    """A function to time, with an optional peer."""

    name: str
    """Last part of the metric keys, for instance ``640x480.b8`` or ``vs_cv2``."""
    run: Callable[[], Any]
    """Function under test; returned JAX arrays are waited for."""
    frames: int
    """Frames processed by one call."""
    peer: Callable[[], Any] | None = None
    """Another implementation, or the reference, on the same frames."""
    equal: bool = False
    """Whether the peer must return equal arrays; checked before the timing."""
    peer_frames: int = 0
    """Frames processed by one call of the peer; 0: as many as ``frames``."""
    compared: Callable[[Any], Any] = lambda result: result
    """Function that selects the part of our result that must equal the peer's."""
    bytes_read: int = 0
    """Minimum number of bytes that one call reads; 0: bandwidth is not reported."""


class Missing(NamedTuple):
    """A case whose peer can't be imported; it is listed in the report."""

    name: str
    reason: str
    remedy: str


class Metric(NamedTuple):
    """One value of the report, which is also checked by the gate."""

    key: str
    value: float
    unit: str
    direction: Literal["lower", "higher", "info"]
    """Direction of improvement; ``info`` is not gated."""
    tolerance: float
    """Relative deterioration that the gate allows."""

    def __str__(self) -> str:
        return f"{self.key:<52} {self.value:>12.4g} {self.unit}"


class Timing(NamedTuple):
    """Times of one function."""

    first: float
    """Duration of the first call, including compilation [s]."""
    median: float
    """Median duration of a call [s]."""
    spread: float
    """Half of the interquartile range [s]."""
    cpu: float
    """Mean CPU time of a call, with all threads and worker processes [s]."""
    result_bytes: int
    """Size of the returned arrays [byte]."""


def with_peer(name: str, module: str, remedy: str, make: Callable[[Any], Case]) -> Case | Missing:
    """Return the case that ``make`` builds from a module, or a note if it can't be imported.

    Args:
        name: Name of the case.
        module: Module that the peer needs.
        remedy: How to install it.
        make: Function of the imported module that returns the case.
    """
    try:
        found = import_module(module)
    except (ImportError, OSError) as error:
        return Missing(name, str(error), remedy)
    return make(found)


def call(function: Callable[[], Any]) -> tuple[float, Any]:
    """Call a function; return the seconds until the result is ready, and the result."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def cpu_seconds() -> float:
    """Return the CPU time of all threads and, with ``/proc``, of worker processes [s]."""
    total = time.process_time()
    for child in active_children():
        stat = Path(f"/proc/{child.pid}/stat")
        if stat.exists():
            fields = stat.read_text("utf-8").rpartition(")")[2].split()
            total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def timed(functions: list[Callable[[], Any]], seconds: float) -> list[Timing]:
    """Time functions in turns, so that other load affects all of them; at least 5 rounds.

    A turn has as many calls as fit into ``TURN_S``: after another function's turn, caches are cold
    and threads are asleep, which would dominate the time of a single short call.
    """
    first = [call(function) for function in functions]
    sizes = [_nbytes(result) for _, result in first]
    calls = [max(1, math.ceil(TURN_S / call(function)[0])) for function in functions]
    wall: list[list[float]] = [[] for _ in functions]
    busy = [0.0 for _ in functions]
    end = time.perf_counter() + seconds
    while len(wall[0]) < 5 or time.perf_counter() < end:
        for i, function in enumerate(functions):
            before = cpu_seconds()
            wall[i].append(sum(call(function)[0] for _ in range(calls[i])) / calls[i])
            busy[i] += (cpu_seconds() - before) / calls[i]
    timings = []
    for (start, _), size, samples, cpu in zip(first, sizes, wall, busy, strict=True):
        low, median, high = statistics.quantiles(samples, n=4)
        timings.append(Timing(start, median, (high - low) / 2, cpu / len(samples), size))
    return timings


def _nbytes(tree: Any) -> int:
    return sum(getattr(leaf, "nbytes", 0) for leaf in jax.tree.leaves(tree))


def copy_rate(seconds: float) -> float:
    """Return the copy bandwidth of the default device, reads plus writes [byte/s]."""
    size = 1 << 28
    increment = jax.jit(lambda a: a + 1, donate_argnums=0)
    array = jnp.zeros(size // 4, jnp.float32)

    def step() -> jax.Array:
        nonlocal array
        array = increment(array)
        return array

    return 2 * size / timed([step], min(seconds, 1.0))[0].median


def check_equal(name: str, ours: object, theirs: object) -> None:
    """Raise AssertionError if two trees of arrays differ in structure or value."""
    mine, peers = jax.tree.leaves(ours), jax.tree.leaves(theirs)
    assert len(mine) == len(peers), f"{name}: {len(mine)} arrays against the peer's {len(peers)}"
    for number, (a, b) in enumerate(zip(mine, peers, strict=True)):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b), f"{name}: array {number}")


def metrics_of(key: str, case: Case, seconds: float, rate: float) -> list[Metric]:
    """Return the metrics of a case; the key of the ratio is a prefix of the others.

    Args:
        key: ``<stage>.<case>``.
        case: Case to time.
        seconds: Time for its repetitions [s].
        rate: Copy rate of the device [byte/s].

    Returns:
        The metrics, most important first.
    """
    if case.equal and case.peer:
        check_equal(key, case.compared(case.run()), case.peer())
        jax.clear_caches()  # so that the first timed call compiles again
    ours, *peers = timed([case.run, *([case.peer] if case.peer else [])], seconds)
    metrics = _of_ours(key, case, ours, rate)
    own_cpu = ours.cpu * 1e3 / case.frames
    for peer in peers:
        a_frame = 1e3 / (case.peer_frames or case.frames)
        ratio = peer.median * a_frame / metrics[0].value
        metrics.insert(0, Metric(key, ratio, "x", "higher", 0.8))
        metrics += [
            Metric(f"{key}.peer", peer.median * a_frame, "ms/frame", "info", 0.0),
            Metric(f"{key}.peer_spread", peer.spread * a_frame, "ms/frame", "info", 0.0),
            Metric(f"{key}.peer_cpu", peer.cpu * a_frame, "ms/frame", "info", 0.0),
            Metric(f"{key}.cpu_ratio", peer.cpu * a_frame / own_cpu, "x", "higher", 0.4),
        ]
    return metrics


def sweep_metrics(cases: dict[str, Case], seconds: float, rate: float) -> list[list[Metric]]:
    """Return the metrics of cases timed in turns, so that they can be compared with each other.

    Args:
        cases: Cases by metric key; their peers are not timed.
        seconds: Total time for their repetitions [s].
        rate: Copy rate of the device [byte/s].

    Returns:
        The metrics of each case, its time first.
    """
    timings = timed([case.run for case in cases.values()], seconds)
    return [_of_ours(*item, ours, rate) for item, ours in zip(cases.items(), timings, strict=True)]


def _of_ours(key: str, case: Case, ours: Timing, rate: float) -> list[Metric]:
    a_frame = 1e3 / case.frames
    metrics = [
        Metric(f"{key}.time", ours.median * a_frame, "ms/frame", "info", 0.0),
        Metric(f"{key}.spread", ours.spread * a_frame, "ms/frame", "info", 0.0),
        Metric(f"{key}.compile", max(0.0, ours.first - ours.median), "s", "info", 0.0),
        Metric(f"{key}.cpu", ours.cpu * a_frame, "ms/frame", "info", 0.0),
    ]
    if case.bytes_read:
        moved = case.bytes_read + ours.result_bytes
        metrics += [
            Metric(f"{key}.bytes", moved / case.frames, "byte/frame", "info", 0.0),
            Metric(f"{key}.rate", moved / ours.median / 1e9, "GB/s", "info", 0.0),
            Metric(f"{key}.copy_share", moved / ours.median / rate, "", "higher", 0.5),
        ]
    return metrics
