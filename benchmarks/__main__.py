"""``python -m benchmarks cpu --json FILE``: time the stages on a device, write the metrics."""

import importlib
import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import jax
import tyro
import warp as wp

from benchmarks.run import Case, Metric, copy_rate, metrics_of, regressions
from jaxdet.config import STAGES


def cases_of(stage: str) -> list[Case]:
    """The cases that ``bench_<stage>.py`` declares."""
    return importlib.import_module(f"benchmarks.bench_{stage}").cases()


def main(
    device: tyro.conf.Positional[Literal["cpu", "gpu"]],
    only: tuple[str, ...] = (*STAGES, "pipeline"),
    seconds: float = 2.0,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    gate: Path | None = None,
) -> int:
    """Times each stage on a device beside its peer, in one run.

    Args:
        device: Where the stages run.
        only: The stages to time, and the whole pipeline.
        seconds: How long each case is repeated.
        json_file: Where to write the metrics, a list of key, value, unit, direction, tolerance.
        gate: A file written earlier on the same device; metrics worse than its tolerance fail.

    Returns:
        The exit code: 1 where the gate failed.
    """
    wp.config.log_level = wp.LOG_WARNING
    metrics: list[Metric] = []
    with jax.default_device(jax.devices(device)[0]):
        rate = copy_rate(seconds)
        print(f"{jax.devices(device)[0].device_kind}: copies {rate / 1e9:.1f} GB/s")
        for stage in only:
            for case in cases_of(stage):
                found = metrics_of(f"{stage}.{case.name}", case, seconds, rate)
                metrics += found
                print("\n".join(str(metric) for metric in found))
            if stage == "pipeline" and device == "gpu":
                found = importlib.import_module("benchmarks.bench_pipeline").throughput(seconds)
                metrics += found
                print("\n".join(str(metric) for metric in found))
    if json_file:
        rows = [metric._asdict() for metric in metrics]
        json_file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if gate is None:
        return 0
    baseline = [Metric(**row) for row in json.loads(gate.read_text("utf-8"))]
    worse = regressions(metrics, [old for old in baseline if old.key.split(".")[0] in only])
    print("\n".join(worse) or "gate: passed")
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(tyro.cli(main, prog="python -m benchmarks"))
