"""The command: which experiments, how large, where to."""

import hashlib
import multiprocessing
import os
import platform
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated

import cv2
import tyro
import warp as wp

from benchmarks.paper import (
    cases,
    coverage,
    failures,
    fig2_edges,
    fig11_time,
    fig12_light,
    fig14_cylinder,
    fig15_pedestrian,
    floor,
    goals,
    hard,
    missed,
    mounts,
    realdata,
    realframes,
    sunrgbd,
    table1_indices,
    table2_detection,
    table3_detectors,
    table4_distance,
    table5_canny,
)  # fmt: skip
from benchmarks.paper.lab import Lab
from benchmarks.paper.labelled import BESIDE
from benchmarks.paper.plan import FULL, QUICK, TUNING_SEEDS
from benchmarks.paper.report import write, write_json
from benchmarks.paper.section import Section
from benchmarks.paper.systems import LEARNT, RIVALS
from jaxdet.presets import PRESETS
from jaxdet.results.versions import versions

EXPERIMENTS: dict[str, Callable[[Lab], Section]] = {
    "table1": table1_indices.run,
    "fig11": fig11_time.run,
    "table2": table2_detection.run,
    "fig12": fig12_light.run,
    "table3": table3_detectors.run,
    "table4": table4_distance.run,
    "fig14": fig14_cylinder.run,
    "fig15": fig15_pedestrian.run,
    "table5": table5_canny.run,
    "fig2": fig2_edges.run,
    "floor": floor.run,
    "coverage": coverage.run,
    "hard": hard.run,
    "missed": missed.run,
    "mounts": mounts.run,
    "cases": cases.run,
    "failures": failures.run,
    "realframes": realframes.run,
    "sunrgbd": sunrgbd.run,
    "goals": goals.run,
}
"""In the order in which they run; the goals are judged last and stand first."""
RECORDINGS = "recordings"
BENCH_PACKAGES = ("scikit-learn", "scipy", "chameleon-cluster", "matplotlib")


@dataclass(frozen=True)
class Options:
    """The paper's experiments on simulated scenes, beside its figures."""

    full: bool = False
    """Larger counts, for narrower intervals; else it takes half an hour on two quiet cores."""
    rehearsal: bool = False
    """Draws by other seeds than the test's, for work on the method: nothing may be tuned on the
    test seeds."""
    output: Path = Path("out/paper")
    """Folder of report.md, report.html and figures/."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """Where to write all figures; by default figures.json in the output folder."""
    only: tuple[str, ...] = ()
    """Names of experiments; by default all. ``recordings`` alone: only the pictures of those."""
    rivals: tuple[str, ...] = ()
    """Names of the baselines that are tuned and compared; by default all."""
    seeds: int = 0
    """Seeds used; 0: those of the size."""
    recordings: tuple[Path, ...] = ()
    """Folders of real recordings, to be pictured; labelled ones are also looked for in and beside
    them, by default in ../shared/data, for the experiment ``realframes``."""
    sunrgbd: Path | None = None
    """Folder of SUN RGB-D, or of some of its scenes, for the experiment ``sunrgbd``."""
    scenes: int = 0
    """How many scenes of it are scored, evenly over all; 0: all."""
    detector: Path | None = None
    """Folder of centernet.json and centernet.bin, for the experiment ``table3`` (TensorFlow)."""
    labelled: tuple[str, ...] = ()
    """Which labelled recordings ``realframes`` scores, by how their names or groups begin, such as
    ``mosd`` or ``public.learn``; by default all."""
    frames: Path | None = None
    """Keeps the simulated frames here for the next run of the same code; by default they go."""
    workers: int = 0
    """Processes; 0: one for each core."""


def main(options: Options) -> int:
    """Runs what is asked for and writes the report; returns the exit code."""
    unknown = [name for name in options.only if name not in (*EXPERIMENTS, RECORDINGS)]
    if unknown:
        names = ", ".join(EXPERIMENTS)
        print(f"no experiment {', '.join(unknown)}; there are {names}", file=sys.stderr)
        return 2
    if absent := [name for name in options.rivals if name not in RIVALS]:
        print(f"no baseline {', '.join(absent)}; there are {', '.join(RIVALS)}", file=sys.stderr)
        return 2
    start = time.perf_counter()
    with _folder(options.frames) as folder, _pool(options.workers or os.cpu_count() or 1) as pool:
        counts, rehearsal = FULL if options.full else QUICK, options.rehearsal
        if options.seeds:
            counts = replace(counts, test_seeds=options.seeds)
        lab = Lab(counts, folder, pool, rehearsal=rehearsal, rivals=options.rivals or RIVALS)
        lab.recordings, lab.labelled = options.recordings or (BESIDE,), options.labelled
        lab.sunrgbd, lab.scenes = options.sunrgbd, options.scenes
        lab.detector = options.detector
        sections = run(lab, options.only or tuple(EXPERIMENTS))
        for number, place in enumerate(options.recordings):
            lab.log(f"pictures of {place.name}")
            sections.append(realdata.run(lab, place, number))
        facts = _facts(lab, "full" if options.full else "quick", time.perf_counter() - start)
    write(options.output, "The paper's experiments on simulated scenes", sections, facts)
    write_json(options.json_file or options.output / "figures.json", sections, facts)
    lab.log(f"report: {options.output / 'report.html'}")
    return 0


def run(lab: Lab, names: tuple[str, ...]) -> list[Section]:
    """The sections of some experiments, the goals first."""
    for name in (name for name in EXPERIMENTS if name in names):
        lab.log(name)
        lab.sections[name] = EXPERIMENTS[name](lab)
    return sorted(lab.sections.values(), key=lambda section: section.name != "goals")


@contextmanager
def _folder(kept: Path | None) -> Iterator[Path]:
    if kept:
        yield kept / _fingerprint()
        return
    with tempfile.TemporaryDirectory(prefix="jaxdet-paper-") as folder:
        yield Path(folder)


def _fingerprint() -> str:
    """Names the simulator's code, so that kept frames of other code are not used."""
    root = Path(__file__).parents[2]
    files = [*(root / "jaxdet/sim").glob("*.py"), root / "kernels/jaxdet_kernels/raycast.py"]
    files += [Path(__file__).with_name("shots.py"), root / "jaxdet/eval/truth.py"]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files)))
    return digest.hexdigest()[:12]


@contextmanager
def _pool(workers: int) -> Iterator[Executor | None]:
    start_worker()
    if workers == 1:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=start_worker) as pool:
        yield pool


def start_worker() -> None:
    """Keeps a process to one thread and quiet."""
    cv2.setNumThreads(1)
    wp.config.log_level = wp.LOG_ERROR


def _facts(lab: Lab, size: str, seconds: float) -> dict[str, str]:
    """How the report came about."""
    command = shlex.join(["python", "-m", "benchmarks.paper", *sys.argv[1:]])
    found = {**versions(), **{name: _version(name) for name in BENCH_PACKAGES}}
    tuned = TUNING_SEEDS[: lab.counts.tuning_seeds]
    name = next((name for name, one in PRESETS.items() if one == lab.config), "changed")
    return {
        "Findings": "each claim, equation, figure and table of the paper with a verdict is in "
        "jaxdet/help/paper.md (jaxdet help paper)",
        "Data": "simulated scenes (jaxdet.sim); the paper's robot data is not public, so its "
        "figures are for orientation only",
        "Command": command,
        "Size": f"{size}: {lab.counts}",
        "Tuning seeds": f"{_seeds(tuned)} (baselines' parameters only)",
        f"{'Rehearsal' if lab.rehearsal else 'Test'} seeds": f"{_seeds(lab.seeds)} (all figures)",
        "Ours": f"preset {name}, not tuned here. {LEARNT} {lab.config}",
        "Frames drawn": str(lab.store.drawn),
        "Intervals": "95 %, percentile bootstrap over scenes; shares of successes by Wilson",
        "Machine": f"{os.cpu_count()} cores, {platform.machine()}",
        "Run time": f"{seconds / 60:.1f} min",
        "Versions": ", ".join(f"{k} {v or 'not installed'}" for k, v in found.items()),
    }


def _seeds(seeds: tuple[int, ...]) -> str:
    return f"{seeds[0]} to {seeds[-1]}"


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
