"""Choice of the parameters that the paper does not state, by a grid and a search.

The paper states examples of Canny thresholds, but not N, the distance of corners, d_z and d_x.
``python -m benchmarks.paper.choose`` tries values on the tuning seeds, as for the baselines, and
prints the best, which :mod:`jaxdet.presets` contains.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import tyro

from benchmarks.baselines.tune import search
from benchmarks.paper.main import start_worker
from benchmarks.paper.measure import measured
from benchmarks.paper.plan import LIGHTS, PRESET_SEEDS, SCENES, TUNING_SEEDS
from benchmarks.paper.preset_frames import PresetFrames
from benchmarks.paper.section import percent
from benchmarks.paper.shots import Spec, Store
from benchmarks.paper.systems import tuning_objective
from jaxdet.eval import Score, Tally, score, total
from jaxdet.presets import preset

FIRST = {
    "canny_high": 200.0,
    "min_distance": 5.0,
    "min_points": 10,
    "depth_gap_m": 0.1,
    "lateral_gap_m": 0.4,
}
"""Values of the preset before this choice (commit 297f469), which were guesses."""
JUDGED: dict[str, dict[str, Any]] = {
    "first values": FIRST,
    "first values, N = 3": FIRST | {"min_points": 3},
    "first values, N = 3, Canny at 50 and 100": FIRST | {"min_points": 3, "canny_high": 100.0},
    "preset paper with d_z 0.10, d_x 0.40": {"depth_gap_m": 0.1, "lateral_gap_m": 0.4},
    "preset paper": {},
}
"""Variants that are evaluated on the held-out seeds, on which no parameter is chosen."""
GRID: dict[str, tuple[Any, ...]] = {
    "canny_high": (100.0, 150.0, 200.0, 300.0),
    "min_distance": (2.0, 3.0, 5.0, 7.0),
    "min_points": (3, 5, 10),
    "depth_gap_m": (0.05, 0.1, 0.2, 0.4),
    "lateral_gap_m": (0.2, 0.4, 0.6),
}
"""Values of the grid. The lower Canny threshold is half of the upper one, as in the paper."""
QUANTILES = (0.80, 0.85, 0.90, 0.95)
"""Quantiles of the gradients of a frame, tried as upper Canny threshold on the tuning seeds."""


@dataclass(frozen=True)
class Options:
    """Choose the parameters of the preset paper on the tuning seeds."""

    frames: Path
    """Folder in which simulated frames are stored."""
    seeds: int = len(TUNING_SEEDS)
    """Number of tuning seeds; the full report tunes the baselines on as many."""
    judge: bool = False
    """Choose nothing; compare the preset on the held-out seeds with the values it had at first."""
    laws: bool = False
    """Choose nothing; compare thresholds at quantiles of each frame's gradients."""


def main(options: Options) -> None:
    """Print each trial that is better than all before it, then the best; or compare variants."""
    start_worker()
    start, store = time.perf_counter(), Store(options.frames)
    if options.judge:
        specs = _specs(PRESET_SEEDS)
        frames = PresetFrames(store.load(specs), preset("paper"))
        for name, params in JUDGED.items():
            _print(name, specs, frames.tallies(params))
        return
    specs = _specs(TUNING_SEEDS[: options.seeds])
    frames = PresetFrames(store.load(specs), preset("paper"))
    if options.laws:
        _print("preset paper", specs, frames.tallies({}))
        for share in QUANTILES:
            _print(f"quantile {share:g}", specs, frames.tallies({}, frames.with_bounds(share)))
        return
    best, tried = -math.inf, 0

    def value(params: dict[str, Any]) -> float:
        nonlocal best, tried
        found, tried = score(frames.tallies(params)), tried + 1
        judged = tuning_objective(found)
        if judged > best:
            best = judged
            _report(time.perf_counter() - start, tried, params, found)
        return judged

    trials = [dict(zip(GRID, values, strict=True)) for values in product(*GRID.values())]
    chosen = search(trials, list(GRID), value)
    print(f"{len(specs)} frames, {tried} trials; chosen: {chosen.params}")


def _specs(seeds: Sequence[int]) -> list[Spec]:
    """Return one frame per scene, seed and light."""
    return [Spec(scene, seed, 1, light) for scene, seed, light in product(SCENES, seeds, LIGHTS)]


def _print(name: str, specs: Sequence[Spec], tallies: Sequence[Tally]) -> None:
    """Print figures with intervals over scenes, for all lights together and for each."""
    for light in (None, *LIGHTS):
        units: dict[tuple[str, int], list[Tally]] = {}
        for spec, tally in zip(specs, tallies, strict=True):
            if light in (None, spec.light):
                units.setdefault((spec.family, spec.seed), []).append(tally)
        one = measured([total(unit) for unit in units.values()])
        figures = [percent(one.value(k), one.intervals[k]) for k in ("accuracy", "fmi")]
        shares = f"precision {percent(one.score.precision)} recall {percent(one.score.recall)}"
        print(f"{name}, {light or 'all lights'}: ACC {figures[0]} FMI {figures[1]} {shares}")


def _report(seconds: float, tried: int, params: dict[str, Any], found: Score) -> None:
    figures = f"ACC {found.accuracy:.4f} FMI {found.fmi:.4f} F1 {found.f1:.4f}"
    print(f"{seconds:6.0f} s  trial {tried}: {figures} {params}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
