"""Regression tests of bugs found by users and with real recordings."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import jaxdet
from jaxdet.cli import main
from jaxdet.errors import CalibrationError, InputError
from jaxdet.io import open_log
from jaxdet.sim import SimConfig, write_log
from jaxdet.types import Extrinsics
from tests.io_helpers import LogFile, make_scene, write_images
from tests.scenes import frames, level, small

ROOT = Path(__file__).resolve().parent.parent
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reproductions") / "s.mcap"
    write_log(path, SimConfig(frames=2, width=160, height=120))
    return path


def test_the_package_is_typed_and_imports_what_it_declares() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (ROOT / "jaxdet" / "py.typed").is_file()
    assert "Typing :: Typed" in project["classifiers"]
    declared = {name.split(">")[0].split("[")[0] for name in project["dependencies"]}
    code = (
        "import sys, jaxdet.cli.run, jaxdet.engine, jaxdet.io, jaxdet.export.foxglove\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"tyro", "typeguard", "pandas", "scipy.stats"} & set(done.stdout.split())
    assert "tyro" not in declared and "foxglove-schemas-protobuf" in declared


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_commands_show_progress(log: Path) -> None:
    import pty

    parent, child = pty.openpty()
    run = [sys.executable, "-m", "jaxdet", "info", str(log)]
    subprocess.run(run, stdout=subprocess.DEVNULL, stderr=child, check=True, timeout=300)
    os.close(child)
    printed = os.read(parent, 1 << 16).decode()
    os.close(parent)
    assert "reading s" in printed


def test_the_error_for_a_truncated_log_without_a_calibration_names_both(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with LogFile(path) as file:
        write_images(file, make_scene(3))
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(CalibrationError, match=r"calibration.*; x\.mcap is recovered: .*no end"):
        open_log(path)


def test_an_overflow_warning_names_its_page(log: Path, tmp_path: Path, capsys: Captured) -> None:
    run = ["run", str(log), "--output", str(tmp_path / "out"), "--backend", "reference"]
    few = ["--preset", "paper", "--features.max-corners", "8"]
    assert main([*run, "--pictures", "0", *few]) == 0
    assert "than slots, see jaxdet help tuning" in capsys.readouterr().out
    main(["help", "tuning"])
    assert "`overflow`" in capsys.readouterr().out


def test_number_of_failed_logs_is_reported(log: Path, tmp_path: Path, capsys: Captured) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"x")
    run = ["run", str(bad), str(log), "--output", str(tmp_path / "out"), "--backend", "reference"]
    assert main([*run, "--pictures", "0"]) == 1
    assert "; 1 of 2 logs failed" in capsys.readouterr().out
    assert main(["run", str(bad), "--output", str(tmp_path / "none")]) == 1
    printed = capsys.readouterr()  # for a single log only its error is printed
    assert printed.out == "no results\n" and printed.err.count("\n") == 1


@pytest.mark.parametrize("name, value", [("z", -5), ("x", 400_000)])
def test_points_outside_of_any_camera_are_clustered_alike_by_both_backends(
    name: str, value: int
) -> None:
    """Both backends agree; such points once caused a crash."""
    config = jaxdet.preset("paper")
    depth = np.full((1, 60, 80), 1500, np.uint16)
    color = np.random.default_rng(0).integers(0, 255, (1, 60, 80, 3), np.uint8)
    whole = jaxdet.detect(
        frames(small(80, 60), color, depth, plane=level(1)), config, backend="reference"
    )
    assert whole.points is not None
    found = whole.points.features
    given = found._replace(**{name: np.full_like(getattr(found, name), value)})
    from jaxdet import reference, stages

    for module in (reference, stages):
        labels = module.paper.cluster(given, 0.001, config)
        assert np.asarray(labels.num_obstacles).max() < given.x.shape[1]
    assert np.array_equal(
        np.asarray(stages.paper.cluster(given, 0.001, config).labels),
        reference.paper.cluster(given, 0.001, config).labels,
    )


def test_low_level_functions_refuse_arguments_that_are_not_batches() -> None:
    given = frames(
        small(80, 60), np.zeros((1, 60, 80, 3), np.uint8), np.zeros((1, 60, 80), np.uint16)
    )
    arrays = given.calibration._replace(color_from_depth=Extrinsics(np.eye(3), [0, 0, 0]))
    none = given._replace(color=given.color[:0], depth=given.depth[:0], valid=given.valid[:0])
    for wrong, message in (
        ([given, given], "frames: expected Frames, got list"),
        (
            given._replace(calibration=arrays),
            "rotation of color_from_depth: expected tuple, got ndarray",
        ),
        (none, "the batch is empty"),
    ):
        for backend in ("reference", "jax"):
            with pytest.raises((InputError, CalibrationError), match=message):
                jaxdet.detect(wrong, backend=backend)
