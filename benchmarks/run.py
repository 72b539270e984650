"""The runner: warm up, block until ready, compile time apart, ratio to the peer of the same run."""

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
"""How long a function is called before another's turn [s]."""


class Case(NamedTuple):
    """One thing to time."""

    name: str
    """Last part of the metric keys, for instance ``640x480.b8`` or ``vs_cv2``."""
    run: Callable[[], Any]
    """Ours; may return JAX arrays, which are waited for."""
    frames: int
    """Frames that one call works on."""
    peer: Callable[[], Any] | None = None
    """Somebody else's code, or the reference, on the same frames."""
    equal: bool = False
    """The peer must return equal arrays; checked before anything is timed."""
    peer_frames: int = 0
    """Frames that one call of the peer works on; 0: as many as ours."""
    compared: Callable[[Any], Any] = lambda result: result
    """The part of our result that must equal the peer's."""
    bytes_read: int = 0
    """Bytes that one call has to read at least; 0: bandwidth is not of interest."""


class Missing(NamedTuple):
    """A case whose peer this machine lacks; it is listed, never dropped silently."""

    name: str
    reason: str
    remedy: str


class Metric(NamedTuple):
    """One number of the report; the gate reads the same list."""

    key: str
    value: float
    unit: str
    direction: Literal["lower", "higher", "info"]
    """Which way is better; ``info`` is not gated."""
    tolerance: float
    """Relative change for the worse that the gate lets pass."""

    def __str__(self) -> str:
        return f"{self.key:<52} {self.value:>12.4g} {self.unit}"


class Timing(NamedTuple):
    """One function's times."""

    first: float
    """The first call, compilation included [s]."""
    median: float
    """[s]"""
    spread: float
    """Half the distance of the quartiles [s]."""
    cpu: float
    """Mean CPU time of a call, all threads and worker processes [s]."""
    result_bytes: int
    """Size of the arrays it returned."""


def with_peer(name: str, module: str, remedy: str, make: Callable[[Any], Case]) -> Case | Missing:
    """The case that ``make`` builds from a module, or a note that the machine lacks it.

    Args:
        name: Of the case.
        module: What the peer imports.
        remedy: What to do where it can't be imported.
        make: Takes the module.
    """
    try:
        found = import_module(module)
    except (ImportError, OSError) as error:
        return Missing(name, str(error), remedy)
    return make(found)


def call(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds until the result is ready, and the result."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def cpu_seconds() -> float:
    """CPU time of all threads so far; worker processes count where the system has ``/proc``."""
    total = time.process_time()
    for child in active_children():
        stat = Path(f"/proc/{child.pid}/stat")
        if stat.exists():
            fields = stat.read_text("utf-8").rpartition(")")[2].split()
            total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def timed(functions: list[Callable[[], Any]], seconds: float) -> list[Timing]:
    """Times functions in turns, so that a busy machine treats them alike; at least 5 rounds.

    A turn is as many calls as take ``TURN_S``: after a turn of another, caches are cold and
    threads asleep, and a single short call would tell of that more than of itself.
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
    """Bytes per second, read and written, of a plain pass over memory of the default device."""
    size = 1 << 28
    increment = jax.jit(lambda a: a + 1, donate_argnums=0)
    array = jnp.zeros(size // 4, jnp.float32)

    def step() -> jax.Array:
        nonlocal array
        array = increment(array)
        return array

    return 2 * size / timed([step], min(seconds, 1.0))[0].median


def check_equal(name: str, ours: object, theirs: object) -> None:
    """Raises AssertionError where two trees of arrays differ in structure or value."""
    mine, peers = jax.tree.leaves(ours), jax.tree.leaves(theirs)
    assert len(mine) == len(peers), f"{name}: {len(mine)} arrays against the peer's {len(peers)}"
    for number, (a, b) in enumerate(zip(mine, peers, strict=True)):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b), f"{name}: array {number}")


def metrics_of(key: str, case: Case, seconds: float, rate: float) -> list[Metric]:
    """The metrics of a case; the ratio's key is the case's own, the others' begin with it.

    Args:
        key: ``<stage>.<case>``.
        case: What to time.
        seconds: How long to repeat it.
        rate: The device's copy rate [byte/s].

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
    """The metrics of cases that take turns, so that a curve through them means something.

    Args:
        cases: By metric key; peers are left out.
        seconds: How long all of them together are repeated.
        rate: The device's copy rate [byte/s].

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
