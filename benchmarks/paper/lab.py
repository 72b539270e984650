"""What the experiments share: frames, tuned baselines, scores of the test scenes."""

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
    """One run of the report.

    Args:
        counts: How much is drawn.
        folder: Where frames are kept.
        pool: Worker processes; None: everything runs here.
        config: Ours.
        rehearsal: Draw by other seeds than the test's.
        rivals: Names of the baselines.
        results: Folder that keeps the results of tasks, of one state of the code; by default that
            of the frames.
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
        """The test seeds of this run; in a rehearsal, others."""
        every = REHEARSAL_SEEDS if self.rehearsal else TEST_SEEDS
        return every[: self.counts.test_seeds]

    def log(self, text: str) -> None:
        """Tells how far the run is."""
        if not self.quiet:
            print(f"{time.perf_counter() - self.start:6.0f} s  {text}", flush=True)

    def spec(
        self, family: str, seed: int, count: int, light: str = "normal", **changes: Any
    ) -> Spec:
        """What to draw, at the run's image size."""
        flags = {name: bool(changes.pop(name, False)) for name in ("log", "heights")}
        width = self.counts.width
        if width != Counts().width:
            changes |= {"width": width, "height": width * 3 // 4}
        return Spec(family, seed, count, light, tuple(sorted(changes.items())), **flags)

    def run(self, task: Any, items: Iterable[Any]) -> list[Any]:
        """Run a task on each item, by the workers if there are any; results that are there count.

        Args:
            task: Function of an item, in a module.
            items: Arguments; the text of each (``repr``) says all of it.
        """
        tasks = [KeptTask(self.results, task, item) for item in items]
        return list((self.pool.map if self.pool else map)(run_kept, tasks))

    def load(self, specs: Sequence[Spec]) -> list[Shot]:
        """Frames of some specs."""
        return self.store.load(specs)

    def judge(
        self, specs: Sequence[Spec], chosen: Sequence[System]
    ) -> list[dict[str, list[Tally]]]:
        """All systems on all frames: for each spec a tally a frame by the system's name."""
        self.store.ensure(specs)
        return self.run(judge, [(self.store.path(spec), tuple(chosen)) for spec in specs])

    def test_specs(self, scene: str, light: str) -> list[Spec]:
        """The test scenes of a family in a light."""
        return [self.spec(scene, seed, self.counts.scenes, light) for seed in self.seeds]

    @cached_property
    def tuned(self) -> dict[str, dict[str, Any]]:
        """The baselines' parameters, chosen on the tuning seeds for the same preprocessing."""
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
        """All that are compared."""
        return systems(self.config, self.tuned, self.rivals)

    @cached_property
    def scores(self) -> Scores:
        """Tallies of all systems on the test scenes, by scene and light, in the seeds' order."""
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
        """A system's tallies, one for each scene: the same scene in several lights is one unit."""
        return units(self.scores, system, scenes or SCENES, lights or LIGHTS)


def units(scores: Scores, system: str, scenes: Sequence[str], lights: Sequence[str]) -> list[Tally]:
    """One tally for each scene, its lights together."""
    found: list[Tally] = []
    for scene in scenes:
        every = [scores[scene, light][system] for light in lights]
        found += [total(one) for one in zip(*every, strict=True)]
    return found
