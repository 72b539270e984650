"""Fig. 11: time and memory of the clustering."""

import tracemalloc
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.baselines import BASELINES, labels_of, prepare
from benchmarks.paper import paper_figures, plots
from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import SCENES
from benchmarks.paper.section import Section, bootstrap
from benchmarks.paper.shots import frames_of
from benchmarks.paper.systems import RULE, of_points
from benchmarks.paper.timing import in_turns
from jaxdet import stages
from jaxdet.config import Config
from jaxdet.presets import preset


def run(lab: Lab) -> Section:
    """Fig. 11 (clustering time of the methods) as time and as ratio to the paper's rule."""
    section = Section("fig11", "Fig. 11: clustering time")
    config = of_points(lab.config)
    specs = [lab.spec(scene, seed, lab.counts.scenes) for seed in lab.seeds for scene in SCENES]
    shots = lab.load(specs[: lab.counts.timed])[: lab.counts.timed]
    frames = [frame for shot in shots for frame in prepare(frames_of([shot]), config)]
    names = [RULE, *(name for name in lab.rivals if BASELINES[name].space != "image")]
    functions: dict[str, Callable[[int], Any]] = {
        name: partial(_labels, config, frames, name, lab.tuned.get(name, {})) for name in names
    }
    functions["stages"] = lambda i: stages.paper.cluster(
        frames[i].features, frames[i].calibration.depth_unit, preset("paper")
    )
    times = in_turns(functions, len(frames), lab.counts.rounds)
    points = np.median([int(frame.features.kept.sum()) for frame in frames])
    section.say(
        f"Time to cluster the same points (median {points:.0f} per frame) of {len(frames)} "
        f"simulated frames in normal light, one frame at a time, best of {lab.counts.rounds} in "
        "turns on this machine. The paper's rule is run by the NumPy reference and as a compiled "
        "JAX program, which is made for batches and takes about the same time for any small "
        "frame. The other methods are those of scikit-learn, SciPy and chameleon-cluster, and our "
        "own code in NumPy and JAX; CURE, ROCK, CHAMELEON, DDC and DCC cluster a random sample. "
        "The default clusters no points; Fig. 12 has the time of its complete detection. According "
        "to the paper, its rule is at least twice as fast as RSC and 4 to 5 times as fast as "
        "scikit-learn's hierarchical clustering."
    )
    rows: list[list[str]] = []
    ratios: dict[str, float] = {}
    for name, ms in times.items():
        title = "The paper's rule (JAX stage, CPU)" if name == "stages" else BASELINES[name].title
        ratio = ms / times[RULE]
        ends = bootstrap(ratio, 0.5)
        paper = paper_figures.RATIO.get(name)
        value = float(np.median(ms))
        section.add(f"{name}.time", value, "ms", "lower", bootstrap(ms, 0.5))
        section.add(f"{name}.ratio", float(np.median(ratio)), "x", "info", ends, paper)
        ratios[title] = float(np.median(ratio))
        text = f"{np.median(ratio):.1f} [{ends.low:.1f}, {ends.high:.1f}]"
        peak = _peak_mb(functions[name])
        memory = ""
        if name != "stages":  # JAX's memory is not Python's
            memory = f"{peak:.2f}"
            section.add(f"{name}.peak", peak, "MB", "lower")
        rows.append([title, f"{value:.2f}", text, paper or "", memory])
    header = ["Method", "Time [ms]", "Ratio to the rule", "the paper's ratio"]
    section.table([*header, "Peak memory [MB]"], rows)
    figure, axes = plots.canvas(1, 9, 4.4)
    order = sorted(ratios, key=lambda title: ratios[title])
    axes[0].barh(order, [ratios[title] for title in order], color=plots.OURS)
    axes[0].set_xlabel("clustering time / that of the paper's rule")
    axes[0].grid(visible=False, axis="y")
    caption = "Clustering time divided by that of the paper's rule (NumPy reference)."
    section.picture("ratio", plots.png(figure), caption)
    return section


def _peak_mb(function: Callable[[int], Any]) -> float:
    """Return the peak memory of Python and NumPy during a call on the first frame [MB]."""
    tracemalloc.start()
    function(0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def _labels(config: Config, frames: list, name: str, params: dict, index: int) -> np.ndarray:
    return labels_of(BASELINES[name], frames[index], config, params)
