"""Data that experiments share: frames, tuned baselines, scores of the test scenes."""

import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmarks.paper.files import KeptTask, run_kept
from benchmarks.paper.plan import (
    LIGHTS,
    REHEARSAL_SEEDS,
    SCENES,
    TEST_SEEDS,
    TUNING_SEEDS,
    Counts,
)
from benchmarks.paper.section import Section
from benchmarks.paper.shots import Shot, Spec, Store
from benchmarks.paper.systems import (
    RIVALS,
    RULE,
    System,
    TuningTask,
    judge,
    of_points,
    systems,
    tune_one,
)
from jaxdet.config import Config
from jaxdet.eval import Tally, total

Scores = dict[tuple[str, str], dict[str, list[Tally]]]


class Lab:
    """Run of the report.

    Args:
        counts: Numbers of scenes and frames.
        folder: Folder of simulated frames.
        pool: Worker processes; None: everything runs in this process.
        config: Configuration of the default method.
        rehearsal: Whether to use other seeds than the test seeds.
        rivals: Names of the baselines.
        results: Folder of the results of tasks, for one state of the code; by default that of the
            frames.
    """

    def __init__(
        self,
        counts: Counts,
        folder: Path,
        pool: Executor | None = None,
        config: Config | None = None,
        *,
        rehearsal: bool = False,
        rivals: Sequence[str] = RIVALS,
        results: Path | None = None,
    ) -> None:
        self.counts, self.config = counts, config or Config()
        self.store, self.pool = Store(folder, pool), pool
        self.results = results or folder
        self.results.mkdir(parents=True, exist_ok=True)
        self.sections: dict[str, Section] = {}
        self.recordings: tuple[Path, ...] = ()
        self.sunrgbd: Path | None = None
        self.scenes = 0
        self.detector: Path | None = None
        self.log_file: Path | None = None
        self.truth: Path | None = None
        self.labelled: tuple[str, ...] = ()
        self.quiet, self.rehearsal = False, rehearsal
        self.rivals = tuple(rivals)
        self.start = time.perf_counter()

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of this run: test seeds, or other seeds in a rehearsal."""
        every = REHEARSAL_SEEDS if self.rehearsal else TEST_SEEDS
        return every[: self.counts.test_seeds]

    def log(self, text: str) -> None:
        """Print a line of progress."""
        if not self.quiet:
            print(f"{time.perf_counter() - self.start:6.0f} s  {text}", flush=True)

    def spec(
        self, family: str, seed: int, count: int, light: str = "normal", **changes: Any
    ) -> Spec:
        """Return a specification of frames with the image size of this run."""
        flags = {name: bool(changes.pop(name, False)) for name in ("log", "heights")}
        width = self.counts.width
        if width != Counts().width:
            changes |= {"width": width, "height": width * 3 // 4}
        return Spec(family, seed, count, light, tuple(sorted(changes.items())), **flags)

    def run(self, task: Any, items: Iterable[Any]) -> list[Any]:
        """Run a task on each item, in the workers if there are any; stored results are reused.

        Args:
            task: Function of an item, at the top level of a module.
            items: Arguments; items are equal if their ``repr`` is.
        """
        tasks = [KeptTask(self.results, task, item) for item in items]
        return list((self.pool.map if self.pool else map)(run_kept, tasks))

    def load(self, specs: Sequence[Spec]) -> list[Shot]:
        """Return frames; missing ones are made."""
        return self.store.load(specs)

    def judge(
        self, specs: Sequence[Spec], chosen: Sequence[System]
    ) -> list[dict[str, list[Tally]]]:
        """Return for each specification a tally per frame, by the name of the system."""
        self.store.ensure(specs)
        return self.run(judge, [(self.store.path(spec), tuple(chosen)) for spec in specs])

    def test_specs(self, scene: str, light: str) -> list[Spec]:
        """Return the test scenes of a family in a light."""
        return [self.spec(scene, seed, self.counts.scenes, light) for seed in self.seeds]

    @cached_property
    def tuned(self) -> dict[str, dict[str, Any]]:
        """Parameters of the baselines, chosen on the tuning seeds with the same preprocessing."""
        seeds = TUNING_SEEDS[: self.counts.tuning_seeds]
        specs = [
            self.spec(scene, seed, 1, light)
            for scene in SCENES
            for seed in seeds
            for light in LIGHTS
        ]
        names = (RULE, *self.rivals)
        self.log(f"tuning {len(names)} baselines on {len(specs)} frames")
        self.store.ensure(specs)
        paths = tuple(self.store.path(spec) for spec in specs)
        config = of_points(self.config)
        found = self.run(tune_one, [TuningTask(name, paths, config) for name in names])
        self.tuning_values = {name: one[1] for name, one in zip(names, found, strict=True)}
        return {name: one[0] for name, one in zip(names, found, strict=True)}

    @cached_property
    def systems(self) -> list[System]:
        """Systems that are compared."""
        return systems(self.config, self.tuned, self.rivals)

    @cached_property
    def scores(self) -> Scores:
        """Tallies of all systems on the test scenes, by scene and light, in the order of seeds."""
        keys = [(scene, light) for scene in SCENES for light in LIGHTS]
        specs = [spec for scene, light in keys for spec in self.test_specs(scene, light)]
        self.log(
            f"scoring {len(self.systems)} systems on {sum(s.frames for s in specs)} test frames"
        )
        parts = iter(self.judge(specs, self.systems))
        out: Scores = {}
        for key in keys:
            mine = [next(parts) for _ in self.seeds]
            out[key] = {name: [t for part in mine for t in part[name]] for name in mine[0]}
        return out

    def tallies(
        self,
        system: str,
        scenes: Sequence[str] | None = None,
        lights: Sequence[str] | None = None,
    ) -> list[Tally]:
        """Return a tally of a system per scene; a scene in several lights is one unit."""
        return units(self.scores, system, scenes or SCENES, lights or LIGHTS)


def units(scores: Scores, system: str, scenes: Sequence[str], lights: Sequence[str]) -> list[Tally]:
    """Return a tally per scene, summed over lights."""
    found: list[Tally] = []
    for scene in scenes:
        every = [scores[scene, light][system] for light in lights]
        found += [total(one) for one in zip(*every, strict=True)]
    return found
