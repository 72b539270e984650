"""Command line of the report: experiments, their size and the output."""

import multiprocessing
import os
import platform
import shlex
import shutil
import sys
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
    findings,
    floor,
    hard,
    missed,
    mounts,
    own,
    realdata,
    realframes,
    section6,
    sunrgbd,
    table1_indices,
    table2_detection,
    table3_detectors,
    table4_distance,
    table5_canny,
)  # fmt: skip
from benchmarks.paper.files import fingerprint
from benchmarks.paper.lab import Lab
from benchmarks.paper.labelled import SHARED_DATA
from benchmarks.paper.plan import FULL, QUICK, TUNING_SEEDS
from benchmarks.paper.report import write, write_json
from benchmarks.paper.section import Section
from benchmarks.paper.systems import LEARNT, QUICK_RIVALS, RIVALS
from jaxdet.presets import PRESETS
from jaxdet.results.versions import versions

OF_THE_PAPER: dict[str, Callable[[Lab], Section]] = {
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
    "section6": section6.run,
}
"""Experiments of the paper, in the order in which they run."""
BEYOND: dict[str, Callable[[Lab], Section]] = {
    "sunrgbd": sunrgbd.run,
    "realframes": realframes.run,
    "own": own.run,
    "floor": floor.run,
    "coverage": coverage.run,
    "hard": hard.run,
    "missed": missed.run,
    "mounts": mounts.run,
    "cases": cases.run,
    "failures": failures.run,
}
"""Experiments with other data, and with the default on harder scenes."""
EXPERIMENTS = {**OF_THE_PAPER, **BEYOND, "findings": findings.run}
"""All experiments; the findings are judged last and come first in the report."""
RECORDINGS = "recordings"
UNFINISHED = "unfinished"
"""Folder in the output folder, with the results of a stopped run; the same command continues it."""
BENCH_PACKAGES = ("scikit-learn", "scipy", "chameleon-cluster", "matplotlib")


@dataclass(frozen=True)
class Options:
    """Run the paper's experiments on simulated scenes and write a report.

    A run that was stopped continues if the same command is given again.
    """

    full: bool = False
    """All experiments, all baselines and larger counts, which takes hours; by default those of the
    paper, about 10 minutes on two cores."""
    rehearsal: bool = False
    """Use other seeds than the test seeds, for work on the method: nothing may be tuned on the
    test seeds."""
    output: Path = Path("out/paper")
    """Folder of report.md, report.html and figures/."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """File of all figures; by default figures.json in the output folder."""
    only: tuple[str, ...] = ()
    """Names of experiments. ``recordings``: only the pictures of those."""
    rivals: tuple[str, ...] = ()
    """Names of the baselines that are tuned and compared."""
    seeds: int = 0
    """Number of test seeds; 0: 5, or all 20 with --full."""
    recordings: tuple[Path, ...] = ()
    """Folders of real recordings. Pictures of them are drawn; the experiment ``realframes`` also
    searches them, and folders next to them, for labelled recordings (default: ../shared/data)."""
    sunrgbd: Path | None = None
    """Folder of SUN RGB-D, or of some of its scenes, for the experiment ``sunrgbd``."""
    scenes: int = 0
    """Number of scenes of SUN RGB-D that are scored, evenly spaced; 0: all."""
    detector: Path | None = None
    """Folder of centernet.json and centernet.bin, for the experiment ``table3`` (TensorFlow)."""
    labelled: tuple[str, ...] = ()
    """Labelled recordings that ``realframes`` scores, by the beginning of their names or groups,
    such as ``mosd`` or ``public.learn``; default: all."""
    log: Path | None = None
    """Your own log, for the experiment ``own``."""
    truth: Path | None = None
    """Labels of your log: a JSON file as for ``jaxdet run --truth``, or a simulated log."""
    frames: Path | None = None
    """Folder in which simulated frames are stored for later runs of the same simulator."""
    workers: int = 0
    """Number of processes; 0: one per core."""


def main(options: Options) -> int:
    """Run the experiments and write the report; return the exit code."""
    unknown = [name for name in options.only if name not in (*EXPERIMENTS, RECORDINGS)]
    if unknown:
        names = ", ".join(EXPERIMENTS)
        print(f"unknown experiment {', '.join(unknown)}; choose from {names}", file=sys.stderr)
        return 2
    if absent := [name for name in options.rivals if name not in RIVALS]:
        names = ", ".join(RIVALS)
        print(f"unknown baseline {', '.join(absent)}; choose from {names}", file=sys.stderr)
        return 2
    start = time.perf_counter()
    frames, results = _folders(options)
    with _pool(options.workers or os.cpu_count() or 1) as pool:
        counts, rehearsal = FULL if options.full else QUICK, options.rehearsal
        names = options.only or tuple(EXPERIMENTS if options.full else (*OF_THE_PAPER, "findings"))
        if options.seeds:
            counts = replace(counts, test_seeds=options.seeds)
        rivals = options.rivals or (RIVALS if options.full else QUICK_RIVALS)
        lab = Lab(counts, frames, pool, rehearsal=rehearsal, rivals=rivals, results=results)
        lab.recordings, lab.labelled = options.recordings or (SHARED_DATA,), options.labelled
        lab.sunrgbd, lab.scenes = options.sunrgbd, options.scenes
        lab.detector = options.detector
        lab.log_file, lab.truth = options.log, options.truth
        sections = run(lab, names)
        for number, place in enumerate(options.recordings):
            lab.log(f"pictures of {place.name}")
            sections.append(realdata.run(lab, place, number))
        facts = _facts(lab, "full" if options.full else "quick", time.perf_counter() - start)
    write(options.output, "The experiments of the paper on simulated scenes", sections, facts)
    write_json(options.json_file or options.output / "figures.json", sections, facts)
    shutil.rmtree(options.output / UNFINISHED)
    lab.log(f"report: {options.output / 'report.html'}")
    return 0


def run(lab: Lab, names: tuple[str, ...]) -> list[Section]:
    """Return the sections of some experiments, the findings first."""
    for name in (name for name in EXPERIMENTS if name in names):
        lab.log(name)
        lab.sections[name] = EXPERIMENTS[name](lab)
    return sorted(lab.sections.values(), key=lambda section: section.name != "findings")


def _folders(options: Options) -> tuple[Path, Path]:
    """Return the folders of frames and of results, each named by a checksum of the code.

    Both are in ``unfinished`` of the output folder, where the files of other code are removed.
    """
    root = Path(__file__).parents[2]
    every = root / "jaxdet", root / "kernels", root / "benchmarks"
    drawing = root / "jaxdet/sim", root / "jaxdet/eval/truth.py", Path(__file__).parent / "shots.py"
    unfinished = options.output / UNFINISHED
    results = unfinished / fingerprint(*every)
    if unfinished.exists():
        for other in unfinished.iterdir():
            if other != results:
                shutil.rmtree(other)
    frames = options.frames / fingerprint(*drawing) if options.frames else results
    return frames, results


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
    """Limit a process to one thread, without messages."""
    cv2.setNumThreads(1)
    wp.config.log_level = wp.LOG_ERROR


def _facts(lab: Lab, size: str, seconds: float) -> dict[str, str]:
    """Return the facts at the head of the report: page, data, command, seeds, machine, versions."""
    command = shlex.join(["python", "-m", "benchmarks.paper", *sys.argv[1:]])
    found = {**versions(), **{name: _version(name) for name in BENCH_PACKAGES}}
    tuned = TUNING_SEEDS[: lab.counts.tuning_seeds]
    name = next((name for name, one in PRESETS.items() if one == lab.config), repr(lab.config))
    return {
        "Page": "jaxdet/help/paper.md (jaxdet help paper) judges each statement of the paper",
        "Data": "simulated scenes (jaxdet.sim), since the robot data of the paper are not public; "
        "its figures are shown for orientation",
        "Command": command,
        "Size": f"{size} (benchmarks/paper/plan.py): {lab.counts.scenes} scenes per test seed, "
        f"family and light, {lab.counts.approach} per test seed and cell of Table 4",
        "Tuning seeds": f"{_seeds(tuned)} (to choose the parameters of the baselines)",
        f"{'Rehearsal' if lab.rehearsal else 'Test'} seeds": f"{_seeds(lab.seeds)} (all figures)",
        "The default of jaxdet": f"preset {name}, not tuned here. {LEARNT}",
        "Frames simulated": str(lab.store.drawn),
        "Intervals": "95 %, percentile bootstrap over scenes; success rates: Wilson score interval",
        "Machine": f"{os.cpu_count()} cores, {platform.machine()}",
        "Run time": f"{seconds / 60:.1f} min",
        "Versions": ", ".join(f"{k} {v or 'not installed'}" for k, v in found.items()),
    }


def _seeds(seeds: tuple[int, ...]) -> str:
    return " to ".join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
