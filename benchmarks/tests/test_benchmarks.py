"""Parts of the benchmarks: the gate, the report and the cases."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from benchmarks import gate, report, scale
from benchmarks.baselines.sortgap import sort_and_gap
from benchmarks.points import points, settings
from benchmarks.run import Case, Metric, Missing, check_equal, metrics_of, with_peer
from benchmarks.scene import BATCH, on_cells
from jaxdet import reference
from jaxdet.presets import preset

FOLDER = Path(__file__).parents[1]
REQUIRED_KEYS = {
    "pipeline.vs_handwritten",
    "align.vs_rs_align",
    "align.vs_registerDepth",
    "features.vs_cv2",
    "features.vs_kornia",
    "cluster.vs_ward",
    "cluster.vs_dbscan",
    "cluster.vs_hdbscan",
    "cluster.vs_scipy",
    "cluster.vs_rsc",
    "cluster.vs_numpy",
}
BASELINE = [
    Metric("align.vs_rs_align", 4.0, "x", "higher", 0.3),
    Metric("pipeline.seconds", 2.0, "s", "lower", 0.3),
    Metric("align.vs_rs_align.time", 1.0, "ms/frame", "info", 0.0),
]


def with_value(key: str, value: float) -> list[Metric]:
    return [m._replace(value=value) if m.key == key else m for m in BASELINE]


# the gate


def test_the_gate_passes_on_equal_and_better_figures() -> None:
    assert gate.regressions(BASELINE, BASELINE) == []
    assert gate.regressions(with_value("align.vs_rs_align", 40.0), BASELINE) == []
    assert gate.regressions(with_value("pipeline.seconds", 0.2), BASELINE) == []


@pytest.mark.parametrize(
    ("key", "inside", "outside"),
    [("align.vs_rs_align", 4.0 / 1.29, 4.0 / 1.31), ("pipeline.seconds", 2.58, 2.62)],
)
def test_the_gate_fails_beyond_the_tolerance(key: str, inside: float, outside: float) -> None:
    assert gate.regressions(with_value(key, inside), BASELINE) == []
    for bad in (outside, float("nan")):
        (line,) = gate.regressions(with_value(key, bad), BASELINE)
        assert line.startswith(f"gate: {key} ")


def test_the_gate_fails_on_a_missing_figure_and_says_why() -> None:
    gone = BASELINE[1:]
    assert gate.regressions(gone, BASELINE) == ["gate: align.vs_rs_align was not measured"]
    missing = {"align.vs_rs_align": Missing("vs_rs_align", "no module", "install it")}
    (line,) = gate.regressions(gone, BASELINE, missing)
    assert line.endswith("was not measured: no module; install it")
    assert gate.regressions(BASELINE[:2], BASELINE) == []  # for information only


def test_a_baseline_is_the_median_and_twice_the_worst_loss(tmp_path: Path) -> None:
    runs = [with_value("align.vs_rs_align", value) for value in (5.0, 2.5, 4.0)]
    found = gate.baseline_of(runs)
    assert [(m.key, m.value, m.tolerance) for m in found] == [
        ("align.vs_rs_align", 4.0, 1.2),
        ("pipeline.seconds", 2.0, 0.3),
    ]
    files = [tmp_path / f"{i}.json" for i in range(3)]
    for file, run in zip(files, runs, strict=True):
        gate.write(file, run)
    assert gate.main(tmp_path / "out" / "baseline.json", tuple(files)) == 0
    assert gate.read(tmp_path / "out" / "baseline.json") == found


def test_the_committed_baseline_gates_the_required_metrics() -> None:
    baseline = gate.read(FOLDER / "baseline_cpu.json")
    gated = {m.key for m in baseline if m.direction == "higher" and m.value > 0}
    assert gated >= REQUIRED_KEYS
    assert gate.regressions(baseline, baseline) == []
    halved = [m._replace(value=m.value / (1.01 + m.tolerance)) for m in baseline]
    assert len(gate.regressions(halved, baseline)) == len(baseline)


# cases


def tiny(peer: np.ndarray) -> Case:
    return Case("tiny", lambda: np.arange(4), 2, lambda: peer, equal=True, bytes_read=8)


def test_a_case_is_timed_and_its_ratio_has_its_own_key() -> None:
    found = metrics_of("align.tiny", tiny(np.arange(4))._replace(peer_frames=1), 0.0, 1e9)
    values = {m.key: m.value for m in found}
    assert values["align.tiny"] == pytest.approx(
        values["align.tiny.peer"] / values["align.tiny.time"]
    )
    assert values["align.tiny.bytes"] == (8 + np.arange(4).nbytes) / 2
    json.dumps([m._asdict() for m in found])


def test_unequal_results_are_not_timed() -> None:
    with pytest.raises(AssertionError, match=r"align\.tiny: array 0"):
        metrics_of("align.tiny", tiny(np.arange(4) + 1), 0.0, 1e9)


def test_a_peer_that_is_not_installed_is_listed() -> None:
    case = with_peer("vs_none", "no_such_module", "install it", lambda module: tiny(module))
    assert isinstance(case, Missing)
    (line,) = report.absent({"align.vs_none": case})
    assert "align.vs_none" in line and "no_such_module" in line and line.endswith("install it")


@pytest.mark.parametrize("n", [1, 16, 40, 700])
def test_the_numpy_loop_equals_the_reference(n: int) -> None:
    found, config = points(6, n, seed=n), settings(preset("paper"), n)
    some = found._replace(kept=np.arange(6 * n).reshape(6, n) % 7 > 0)
    none = found._replace(kept=np.zeros((6, n), bool))
    for features in (found, some, none):
        want = reference.paper.cluster(features, 0.001, config).labels
        np.testing.assert_array_equal(sort_and_gap(features, 0.001, config), want)
    assert n < 700 or want.max() < reference.paper.cluster(found, 0.001, config).labels.max()


@pytest.mark.parametrize("stage", ["cells", "floor", "surfaces", "obstacles", "outlines", "free"])
def test_stages_on_cells_equal_the_reference(stage: str) -> None:
    (case,) = import_module(f"benchmarks.bench_{stage}").cases()
    assert case.equal and case.frames == BATCH
    check_equal(stage, case.compared(case.run()), case.peer())


def test_the_scene_has_obstacles() -> None:
    seen = on_cells("640x480")
    assert seen.fit.own.all()
    assert (seen.of("label", seen.obstacles).max(axis=(1, 2)) >= 2).all()


# the report


def test_a_simulated_run_equals_the_example_by_hand() -> None:
    """Two logs of 10 GB are read at 10 GB/s and computed at 1 GB/s, plus 1 s each."""
    options = scale.Options(frame_mb=1.0, frames_per_s=1000.0)
    sizes = np.array([10.0, 10.0])
    assert scale.simulate(sizes, 1, 10.0, options).hours * 3600 == pytest.approx(1 + 11 + 11)
    alone = replace(options, prefetch=False)
    assert scale.simulate(sizes, 1, 10.0, alone).hours * 3600 == pytest.approx(2 * (1 + 11))
    both = scale.simulate(sizes, 2, 10.0, replace(options, bucket_gb=1.0))
    assert both.hours * 3600 == pytest.approx(20 + 11) and both.busy == pytest.approx(11 / 31)
    spot = scale.simulate(sizes, 2, 10.0, replace(options, life_h=10 / 3600))
    assert spot.lost > 0 and spot.hours * 3600 > 180


def test_simulated_logs_have_the_given_size() -> None:
    sizes = scale.log_sizes(scale.Options())
    assert sizes.sum() == pytest.approx(1e6, rel=0.1) and list(sizes) == sorted(sizes)[::-1]
    assert sizes.min() >= 1 and sizes.max() <= 100
