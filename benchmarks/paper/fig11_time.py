"""Fig. 11: time of the clustering alone."""

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
from benchmarks.paper.systems import OURS, RIVALS
from benchmarks.paper.timing import in_turns
from jaxdet import stages


def run(lab: Lab) -> Section:
    """Fig. 11 (clustering time of the methods) as time and as ratio to ours."""
    section = Section("fig11", "Fig. 11: clustering time")
    specs = [lab.spec(scene, seed, lab.counts.scenes) for seed in lab.seeds for scene in SCENES]
    shots = lab.load(specs[: lab.counts.timed])[: lab.counts.timed]
    frames = [frame for shot in shots for frame in prepare(frames_of([shot]), lab.config)]
    names = [OURS, *(name for name in RIVALS if BASELINES[name].space != "image")]
    functions: dict[str, Callable[[int], Any]] = {
        name: partial(_labels, lab, frames, name, lab.tuned.get(name, {})) for name in names
    }
    functions["stages"] = lambda i: stages.cluster(
        frames[i].features, frames[i].calibration.depth_unit, lab.config
    )
    times = in_turns(functions, len(frames), lab.counts.rounds)
    points = np.median([int(frame.features.kept.sum()) for frame in frames])
    section.say(
        f"Labels of the same kept features (median {points:.0f} a frame) of {len(frames)} "
        "simulated frames in normal light, one frame at a time, best of "
        f"{lab.counts.rounds} in turns on this machine. Ours is the NumPy reference here, the "
        "baselines are scikit-learn, SciPy, chameleon-cluster and our own code in NumPy and JAX, "
        "of which CURE, ROCK, CHAMELEON, DDC and DCC cluster a random sample; the jitted stage on "
        "the CPU pays about the same for any small frame, being made for batches. The paper: ours "
        "at least twice as fast as RSC and 4 to 5 times as fast as scikit-learn's hierarchical "
        "clustering."
    )
    rows: list[list[str]] = []
    ratios: dict[str, float] = {}
    for name, ms in times.items():
        title = "Ours (JAX stage, CPU)" if name == "stages" else BASELINES[name].title
        ratio = ms / times[OURS]
        ends = bootstrap(ratio, 0.5)
        paper = paper_figures.RATIO.get(name)
        value = float(np.median(ms))
        section.add(f"{name}.time", value, "ms", "lower", bootstrap(ms, 0.5))
        section.add(f"{name}.ratio", float(np.median(ratio)), "x", "info", ends, paper)
        ratios[title] = float(np.median(ratio))
        text = f"{np.median(ratio):.1f} [{ends.low:.1f}, {ends.high:.1f}]"
        rows.append([title, f"{value:.2f}", text, paper or ""])
    section.table(["Method", "Time [ms]", "Ratio to ours", "the paper's ratio"], rows)
    figure, axes = plots.canvas(1, 9, 4.4)
    order = sorted(ratios, key=lambda title: ratios[title])
    axes[0].barh(order, [ratios[title] for title in order], color=plots.OURS)
    axes[0].set_xlabel("clustering time over ours")
    axes[0].grid(visible=False, axis="y")
    section.picture("ratio", plots.png(figure), "Clustering time over that of our reference.")
    return section


def _labels(lab: Lab, frames: list, name: str, params: dict, index: int) -> np.ndarray:
    return labels_of(BASELINES[name], frames[index], lab.config, params)
