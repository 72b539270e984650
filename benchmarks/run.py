"""The runner: warm up, block until ready, compile time apart, ratio to the peer of the same run."""

import statistics
import time
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np


class Case(NamedTuple):
    """One thing to time."""

    name: str
    """Last part of the metric keys, for instance ``640x480.b8``."""
    run: Callable[[], Any]
    """Ours; may return JAX arrays, which are waited for."""
    frames: int
    """Frames that one call works on."""
    peer: Callable[[], Any] | None = None
    """Somebody else's code, or the reference, on the same frames."""
    equal: bool = False
    """The peer must return equal arrays; checked before anything is timed."""
    bytes_moved: int = 0
    """Bytes that one call has to read and write at least; 0: not of interest."""


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
    """Seconds of one function."""

    first: float
    """The first call, compilation included."""
    median: float
    spread: float
    """Half the distance of the quartiles."""


def call(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds until the result is ready, and the result."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def timed(functions: list[Callable[[], Any]], seconds: float) -> list[Timing]:
    """Times functions in turns, so that a busy machine treats them alike; at least 5 rounds."""
    first = [call(function)[0] for function in functions]
    rounds: list[list[float]] = []
    end = time.perf_counter() + seconds
    while len(rounds) < 5 or time.perf_counter() < end:
        rounds.append([call(function)[0] for function in functions])
    timings = []
    for start, samples in zip(first, zip(*rounds, strict=True), strict=True):
        low, median, high = statistics.quantiles(samples, n=4)
        timings.append(Timing(start, median, (high - low) / 2))
    return timings


def copy_rate(seconds: float, size: int = 1 << 28) -> float:
    """Bytes per second, read and written, of a plain pass over memory of the default device."""
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
    """The metrics of a case: time a frame, spread, compile time, peer's time, ratio, bandwidth.

    Args:
        key: Start of the metric keys, ``<stage>.<case>``.
        case: What to time.
        seconds: How long to repeat it.
        rate: The device's copy rate [byte/s].

    Returns:
        The metrics, most important first.
    """
    if case.equal and case.peer:
        check_equal(key, case.run(), case.peer())
        jax.clear_caches()  # so that the first timed call compiles again
    timings = timed([case.run, *([case.peer] if case.peer else [])], seconds)
    ours = timings[0]
    per_frame = 1e3 / case.frames
    metrics = [
        Metric(f"{key}.time", ours.median * per_frame, "ms/frame", "lower", 0.3),
        Metric(f"{key}.spread", ours.spread * per_frame, "ms/frame", "info", 0.0),
        Metric(f"{key}.compile", max(0.0, ours.first - ours.median), "s", "info", 0.0),
    ]
    if case.peer:
        peer = timings[1]
        metrics.append(Metric(f"{key}.peer", peer.median * per_frame, "ms/frame", "info", 0.0))
        metrics.append(Metric(f"{key}.ratio", peer.median / ours.median, "x", "higher", 0.2))
    if case.bytes_moved:
        moved = case.bytes_moved / ours.median
        metrics.append(Metric(f"{key}.rate", moved / 1e9, "GB/s", "info", 0.0))
        metrics.append(Metric(f"{key}.copy_share", moved / rate, "", "higher", 0.3))
    return metrics


def regressions(metrics: list[Metric], baseline: list[Metric]) -> list[str]:
    """A line for each gated metric that is worse than the baseline allows, or is gone."""
    now = {metric.key: metric for metric in metrics}
    lines = []
    for old in baseline:
        if old.direction == "info":
            continue
        if (new := now.get(old.key)) is None:
            lines.append(f"gate: {old.key} was not measured")
            continue
        worse = new.value / old.value if old.direction == "lower" else old.value / new.value
        if worse > 1 + old.tolerance:
            lines.append(f"gate: {old.key} {old.value:.4g} -> {new.value:.4g} {old.unit}")
    return lines
