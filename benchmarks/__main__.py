"""``python -m benchmarks cpu --json FILE``: time the stages on a device and write the metrics.

Other benchmarks: ``python -m benchmarks feed --json FILE`` times whole logs, see
:mod:`benchmarks.feed`; ``tracks`` scores tracks, see :mod:`benchmarks.tracks`; ``maps`` scores maps
of simulated drives, see :mod:`benchmarks.maps`; ``scale`` simulates runs on many nodes, see
:mod:`benchmarks.scale`; ``same`` compares the obstacles of two commits, see
:mod:`benchmarks.same_obstacles`.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import jax
import tyro
import warp as wp

from benchmarks import gate, report
from benchmarks.run import Metric, Missing, copy_rate, metrics_of, sweep_metrics
from benchmarks.sweep import AXES, points_of


@dataclass(frozen=True)
class Options:
    """Time each stage on a device, next to the implementations it is compared with."""

    device: tyro.conf.Positional[Literal["cpu", "gpu"]]
    """Device on which the stages run."""
    only: tuple[str, ...] = tuple(AXES)
    """Stages to time; ``pipeline`` is all of them together."""
    seconds: float = 1.0
    """Time for the repetitions of each case [s]; each point of the sweep gets half of it."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """File for the metrics: a JSON list of key, value, unit, direction, tolerance."""
    gate: Path | None = None
    """Baseline file of the same kind of device; metrics worse than its tolerances fail."""


class Run:
    """Metrics measured in one run, and the peers that could not be imported."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self.metrics: list[Metric] = []
        self.missing: dict[str, Missing] = {}

    def stage(self, stage: str) -> Iterator[list[Metric]]:
        """Time a stage against its peers, then along its axes; yield the metrics of each case."""
        options, module = self.options, import_module(f"benchmarks.bench_{stage}")
        rate = copy_rate(options.seconds / 2)  # again for each stage: others use the machine too
        yield [Metric(f"{stage}.copy_rate", rate / 1e9, "GB/s", "info", 0.0)]
        for case in module.cases():
            key = f"{stage}.{case.name}"
            if isinstance(case, Missing):
                self.missing[key] = case
            else:
                yield metrics_of(key, case, options.seconds, rate)
        points = points_of(stage, options.device)
        cases = {f"{stage}.{point.name}": module.at(point) for point in points}
        yield from sweep_metrics(cases, options.seconds / 2 * len(cases), rate)
        if stage == "pipeline":
            yield module.throughput(options.seconds)


def main(options: Options) -> int:
    """Run the benchmarks; return the exit code, 1 if the gate fails."""
    wp.config.log_level = wp.LOG_WARNING
    start, device = time.perf_counter(), jax.devices(options.device)[0]
    with jax.default_device(device):
        run = Run(options)
        print(f"{device.device_kind}\n\n{report.HEADER}")
        for stage in options.only:
            for found in run.stage(stage):
                run.metrics += found
                print("\n".join([*report.rows(found), *report.others(found)]), flush=True)
    print("\n".join(["", *report.absent(run.missing), f"{time.perf_counter() - start:.0f} s"]))
    if options.json_file:
        gate.write(options.json_file, run.metrics)
    if options.gate is None:
        return 0
    old = [metric for metric in gate.read(options.gate) if metric.key.split(".")[0] in options.only]
    worse = gate.regressions(run.metrics, old, run.missing)
    print("\n".join(worse) or "gate: passed")
    return int(bool(worse))


if __name__ == "__main__":
    if sys.argv[1:2] == ["feed"]:
        from benchmarks import feed  # its peers are not all needed for the stages

        feed_options = tyro.cli(feed.Options, args=sys.argv[2:], prog="python -m benchmarks feed")
        sys.exit(feed.main(feed_options))
    if sys.argv[1:2] == ["maps"]:
        from benchmarks import maps

        drives = tyro.cli(maps.Options, args=sys.argv[2:], prog="python -m benchmarks maps")
        sys.exit(maps.main(drives))
    if sys.argv[1:2] == ["same"]:
        from benchmarks import same_obstacles

        same = tyro.cli(same_obstacles.Options, args=sys.argv[2:], prog="python -m benchmarks same")
        sys.exit(same_obstacles.main(same))
    if sys.argv[1:2] == ["scale"]:
        from benchmarks import scale

        simulated = tyro.cli(scale.Options, args=sys.argv[2:], prog="python -m benchmarks scale")
        sys.exit(scale.main(simulated))
    if sys.argv[1:2] == ["tracks"]:
        from benchmarks import tracks  # needs motmetrics

        chosen = tyro.cli(tracks.Options, args=sys.argv[2:], prog="python -m benchmarks tracks")
        sys.exit(tracks.main(chosen))
    sys.exit(main(tyro.cli(Options, prog="python -m benchmarks")))
