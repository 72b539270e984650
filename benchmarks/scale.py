"""``python -m benchmarks scale``: simulate the time for a petabyte of logs by nodes and network.

A node fetches a log while it processes the previous one; the largest logs go first; a node that is
lost loses the log in progress and is replaced. Rates and overheads are arguments, measured
elsewhere (``python -m benchmarks feed``); only their combination is simulated.
"""

import heapq
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

REPLACED_S = 180.0
"""Time until a lost node is replaced [s]."""


@dataclass(frozen=True)
class Options:
    """Simulate runs over many logs on many nodes."""

    terabytes: float = 1000.0
    """Total size of all logs [TB]."""
    mean_gb: float = 14.9
    """Mean size of a log [GB]; sizes are log-normal from 1 to 100 GB."""
    frame_mb: float = 1.536
    """Size of a frame with all its data in the log: 640x480 raw depth and colour [MB]."""
    frames_per_s: float = 14_000.0
    """Rate at which a node processes frames of a log on its local disk [frames/s]."""
    overhead_s: float = 1.0
    """Additional time for each log, independent of its size [s]."""
    nodes: tuple[int, ...] = (1, 8, 64, 256)
    network_gb: tuple[float, ...] = (2.5, 10.0)
    """Network bandwidth of a node [GB/s]."""
    bucket_gb: float = math.inf
    """Total bandwidth of the bucket for all nodes [GB/s]."""
    life_h: float = math.inf
    """Mean time until a node is lost [h]."""
    prefetch: bool = True
    """Fetch the next log while the current one is processed."""
    seed: int = 0


class Outcome(NamedTuple):
    """Result of a simulated run."""

    hours: float
    busy: float
    """Share of the nodes' time spent on processing."""
    lost: int
    """Number of logs started on a node that was lost."""


def log_sizes(options: Options) -> np.ndarray:
    """Return the sizes of the logs [GB], the largest first."""
    draw = np.random.default_rng(options.seed)
    count = round(options.terabytes * 1000 / options.mean_gb)
    sizes = np.clip(draw.lognormal(0.0, 1.0, count), 0.1, 10.0)
    sizes = np.clip(sizes * options.mean_gb / sizes.mean(), 1.0, 100.0)
    return np.sort(sizes)[::-1]


def simulate(sizes: np.ndarray, nodes: int, network: float, options: Options) -> Outcome:
    """Simulate a run.

    Args:
        sizes: Sizes of the logs [GB], in the order in which they are processed.
        nodes: Number of nodes.
        network: Network bandwidth of a node [GB/s]; the bucket limits the total.
        options: Rates and overheads.
    """
    draw = np.random.default_rng(options.seed)
    fetch_rate = min(network, options.bucket_gb / nodes)
    compute_rate = options.frames_per_s * options.frame_mb / 1000

    def life() -> float:
        hours = options.life_h
        return math.inf if math.isinf(hours) else float(draw.exponential(hours * 3600))

    waiting, lost, computing, end = deque(sizes.tolist()), 0, 0.0, 0.0
    # For each node: when it takes its next log, when it has finished its logs, when it is lost.
    ready = [(0.0, 0.0, life()) for _ in range(nodes)]
    while waiting:
        now, free, death = heapq.heappop(ready)
        size = waiting.popleft()
        begin = max(now + size / fetch_rate, free)
        seconds = options.overhead_s + size / compute_rate
        if begin + seconds > death:
            waiting.appendleft(size)
            lost, back = lost + 1, max(now, death) + REPLACED_S
            heapq.heappush(ready, (back, back, back + life()))
            continue
        computing, end = computing + seconds, max(end, begin + seconds)
        heapq.heappush(
            ready, (begin if options.prefetch else begin + seconds, begin + seconds, death)
        )
    return Outcome(end / 3600, computing / (end * nodes), lost)


def main(options: Options) -> int:
    """Print the assumptions and the table; return the exit code."""
    sizes = log_sizes(options)
    frames, rate = options.frames_per_s, options.frames_per_s * options.frame_mb / 1000
    total, least, most = sizes.sum() / 1000, sizes.min(), sizes.max()
    print(f"{len(sizes)} logs, {total:.0f} TB, {least:.1f} to {most:.0f} GB, the largest first")
    print(f"a node computes {frames:.0f} frames/s of {options.frame_mb} MB, {rate:.1f} GB/s")
    print(f"a log adds {options.overhead_s:g} s; the next is fetched meanwhile: {options.prefetch}")
    print(f"the bucket gives {options.bucket_gb:g} GB/s; nodes live for {options.life_h:g} h\n")
    print("| nodes | network GB/s | hours | node hours | busy | logs begun again |")
    print("|---:|---:|---:|---:|---:|---:|")
    for network in options.network_gb:
        for nodes in options.nodes:
            found = simulate(sizes, nodes, network, options)
            hours = f"{found.hours:.2f} | {found.hours * nodes:.0f} | {found.busy:.0%}"
            print(f"| {nodes} | {network:g} | {hours} | {found.lost} |")
    return 0
