"""Wall times on this machine, measured in turns, so that other load affects all functions alike."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from jaxdet.types import Frames


def in_turns(functions: Mapping[str, Callable[[int], Any]], frames: int, rounds: int) -> dict:
    """Return the time of each function on each frame [ms].

    Args:
        functions: Functions of a frame's number, by name.
        frames: Number of frames.
        rounds: Number of calls of which the fastest counts, after a first call that does not.

    Returns:
        Times ``(frames,)`` float64, by name.
    """
    best = {name: np.full(frames, np.inf) for name in functions}
    for turn in range(rounds + 1):
        for index in range(frames):
            for name, function in functions.items():
                start = time.perf_counter()
                jax.block_until_ready(function(index))
                ms = 1e3 * (time.perf_counter() - start)
                if turn:
                    best[name][index] = min(best[name][index], ms)
    return best


def split_batch(frames: Frames) -> list[Frames]:
    """Return batches of one frame each."""
    plane = frames.plane
    out: list[Frames] = []
    for b in range(len(frames.depth)):
        one = slice(b, b + 1)
        parts: dict[str, Any] = {
            name: value[one] for name, value in frames._asdict().items() if _is_array(value)
        }
        own = plane._replace(**{k: v[one] for k, v in plane._asdict().items()}) if plane else None
        out.append(frames._replace(**parts, plane=own))
    return out


def _is_array(value: object) -> bool:
    return isinstance(value, np.ndarray)
