"""Table 5: time by Canny thresholds."""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.paper import paper_figures
from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import CANNY_BOUNDS, SCENES
from benchmarks.paper.section import Section, bootstrap, percent
from benchmarks.paper.shots import frames_of
from benchmarks.paper.systems import DEFAULT, System
from benchmarks.paper.timing import in_turns, split_batch
from jaxdet import detect, reference, stages
from jaxdet.config import Config
from jaxdet.eval import score
from jaxdet.floor.plane import plane_in_color
from jaxdet.presets import preset


def with_bounds(config: Config, bounds: tuple[int, int]) -> Config:
    """Return a configuration with other Canny thresholds."""
    low, high = map(float, bounds)
    return replace(config, features=replace(config.features, canny_low=low, canny_high=high))


def run(lab: Lab) -> Section:
    """Table 5 (time of features and complete detection by Canny thresholds, normal light)."""
    section = Section("table5", "Table 5: time by Canny thresholds")
    specs = [lab.spec(scene, seed, lab.counts.scenes) for seed in lab.seeds for scene in SCENES]
    shots = lab.load(specs[: lab.counts.timed])[: lab.counts.timed]
    frames = split_batch(frames_of(shots))
    paper = preset("paper")
    configs = {bounds: with_bounds(paper, bounds) for bounds in CANNY_BOUNDS}

    def extract(backend: str, bounds: tuple[int, int], index: int) -> object:
        module = stages if backend == "jax" else reference
        frame, config = frames[index], configs[bounds].features
        assert frame.color is not None and frame.plane is not None
        corners = module.paper.features(frame.color, frame.depth, frame.calibration, config)
        plane = plane_in_color(frame.plane, frame.calibration)
        return module.paper.ground(corners, plane, frame.calibration, paper)

    def whole(bounds: tuple[int, int], index: int) -> object:
        return detect(frames[index], configs[bounds], backend="jax")

    functions = {
        f"{backend}.{bounds[0]}-{bounds[1]}": partial(extract, backend, bounds)
        for backend in ("jax", "reference")
        for bounds in CANNY_BOUNDS
    }
    functions |= {f"whole.{low}-{high}": partial(whole, (low, high)) for low, high in CANNY_BOUNDS}
    times = in_turns(functions, len(frames), min(lab.counts.rounds, 3))
    chosen = [System(str(b), "", DEFAULT, config) for b, config in configs.items()]
    parts = lab.judge([s for scene in SCENES for s in lab.test_specs(scene, "normal")], chosen)
    section.say(
        f"Times of feature extraction and of the complete detection of {len(frames)} simulated "
        "frames in normal light, one at a time on this machine, and ACC and recall on all test "
        "scenes in normal light, all with the preset paper. The default does not use corners. The "
        "times in the paper are those of its complete detection on a TX2, 'without affecting the "
        "detection success rate'."
    )
    rows: list[list[str]] = []
    for bounds in CANNY_BOUNDS:
        name, theirs = f"{bounds[0]}-{bounds[1]}", paper_figures.CANNY_MS[bounds]
        cells = [f"{bounds[0]}, {bounds[1]}"]
        for backend in ("whole", "jax", "reference"):
            ms = times[f"{backend}.{name}"]
            ends, middle = bootstrap(ms, 0.5), float(np.median(ms))
            section.add(f"{name}.{backend}", middle, "ms", "lower", ends, theirs)
            cells.append(f"{middle:.2f} [{ends.low:.2f}, {ends.high:.2f}]")
        figures = score(tally for part in parts for tally in part[str(bounds)])
        points = np.median([_points(extract("reference", bounds, i)) for i in range(len(frames))])
        section.add(f"{name}.accuracy", figures.accuracy, "", "higher")
        section.add(f"{name}.recall", figures.recall, "", "higher")
        rows.append([*cells, f"{points:.0f}", percent(figures.accuracy), percent(figures.recall)])
        rows[-1].append(f"{theirs:.2f}")
    header = ["Thresholds", "Complete, JAX [ms]", "Features, JAX [ms]", "Features, reference [ms]"]
    header += ["Features", "ACC", "Recall"]
    section.table([*header, "the paper, TX2 [ms]"], rows)
    return section


def _points(features: object) -> int:
    return int(np.asarray(getattr(features, "kept")).sum())  # noqa: B009
