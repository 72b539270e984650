"""What a new user and real recordings showed to fail, and the tests that say how it ends now."""

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
from tests.scenes import frames, small
from tests.test_failure_classes import assert_there

ROOT = Path(__file__).resolve().parent.parent
Captured = pytest.CaptureFixture[str]

REPRODUCTIONS = {
    # Installation
    "types for checkers; what is needed is declared": ("reproductions the_package_is_typed",),
    "an NVIDIA GPU without the extra is not mentioned": ("cli doctor_hints_at_the_extra",),
    "no platform of JAX_PLATFORMS": ("no_traceback platforms_that_are_not_there",),
    "another package brings OpenCV 4": ("render without_the_fonts_of_opencv_5",),
    "import jaxdet, --help load heavy packages": (
        "layout import_jaxdet_loads_nothing_heavy",
        "cli help_and_version_load",
    ),
    "nothing is shown while programs are compiled": ("reproductions commands_show_that",),
    "the first start compiles one kernel after another": ("compile another_process_compiles",),
    # Messages
    "unknown command, page, preset, section, key, range": ("cli errors_are_one_line bad_files",),
    "mistyped flag, wrong type, missing value": ("cli errors_are_one_line nearest",),
    "no extrinsics": ("io_extrinsics missing_extrinsics_name",),
    "no CameraInfo": ("io_intrinsics camera_matrix_that_is_none", "io_real without_depth"),
    "depth only, colour only, 60 other topics": ("io_real without_depth",),
    "two cameras": (
        "io_cameras one_is_to_be_chosen",
        "exports cameras_and_frames_apart recordings_of",
    ),
    "JPEG, compressedDepth, 32FC1 with NaN, mono8": (
        "io_images compressed_images",
        "io_log metres_equal_millimetres",
    ),
    "truncated, corrupted chunk": ("io_damage truncated_file wrong_crc",),
    "same file twice, same names in two folders, globs": ("io_names splits_are_ordered links",),
    ".bag, .db3, metadata.yaml": ("io_bags tables_are_the_bytes without_rosbags_names",),
    "a folder with .mcap and others": ("io_bags formats_of_one_recording without_anything",),
    "a LeRobot dataset": ("io_bags lerobot",),
    "cut before the first CameraInfo": ("reproductions a_torn_log_without_a_calibration",),
    "--batch-size 0, --pictures -1": ("cli errors_are_one_line", "no_traceback flags"),
    "a height alone is a level camera": ("cli errors_are_one_line",),
    "a pitch of 573 degrees, angles without units": ("cli errors_are_one_line angles_have_units",),
    "a pitch without a height": ("cli errors_are_one_line",),
    "--config results/config.json": ("cli repeated_from_its_results",),
    "a preset in TOML": ("cli flags_go_before_the_file", "help_pages every_snippet_runs"),
    "sim replaces a file": ("cli sim_writes_a_log",),
    "an overflow without a remedy": ("reproductions an_overflow_names_its_page",),
    "a part of a log": ("io_part frames_between_two_moments parts_join",),
    "Ctrl-C, a power cut, log 49 of 50": (
        "resume signals_keep whatever_system_call a_bug_in_the_49th",
    ),
    "opening reads the whole log": ("io_index opening_reads_little",),
    "how many logs failed": ("reproductions how_many_logs_failed",),
    # Results
    "distance, height, join to pictures": ("queries three_engines_agree answers_are",),
    "units, version and configuration in the files": ("queries the_schema_is_printed",),
    "the order of corners, units of columns": ("help_pages every_column_is_explained",),
    "a log where results are meant": ("reading a_log_is_no_folder",),
    "a frame is as alone": ("engine_surfaces each_frame_is_as_alone",),
    "free and unknown in maps": ("export_grid nav2_loads",),
    "exports that Foxglove, Rerun, ROS 2 open": (
        "export_foxglove every_frame_replaces",
        "export_rerun with_the_log",
        "export_ros2 detections_are",
    ),
    "a sidecar on another clock than its recording": ("exports log_times",),
    "masks": ("export_coco simulated_log", "detector points_and_masks"),
    # Python
    "README's example is not the command": (
        "readme example_runs",
        "detector rows_of_jaxdet_run",
        "pipeline a_batch_is_a_stack",
    ),
    "Warp writes to standard output": ("detector nothing_is_written",),
    "vmap, NaN, points out of range end in a crash": (
        "checks not_for_transformations motions_and_units numbers_that_no_integer",
        "reproductions points_that_no_camera_sees",
    ),
    "metres as float, millimetres, degrees, fx of NaN, RGBA": (
        "checks arrays_of_their_kind cameras_that_do_not_exist motions_and_units",
        "detector mounts_that_no_camera_has images_that_are_none",
    ),
    "flat_plane of numbers, config by name, fx or unit of 0": (
        "detector low_level_calls",
        "checks cameras_that_do_not_exist motions_and_units",
    ),
    "arrays as extrinsics, lists of frames, no frames": ("reproductions low_level",),
    "open_log(Path), len, index, iteration": ("detector a_log_is_a_sequence",),
    "errors of the API name flags": ("detector what_no_camera_has_names what_comes_with_a_frame",),
    "each configuration value compiles anew": ("pipeline no_compile_time_constants",),
    # Real recordings
    "a moving camera has one plane, without a warning": (
        "prior camera_must_keep_its_place",
        "engine_surfaces refus",
    ),
    "a table top is the floor": ("floor_recorded table",),
    "a step down, and nothing says so": ("free_floor drop",),
    "numbered files of other recordings are one log": (
        "io_trust numbered_files_are_one_log a_drive_does_not_take",
    ),
}
"""By what failed: a file of tests and parts of the names of tests in it."""


@pytest.mark.parametrize("name", REPRODUCTIONS)
def test_each_has_its_tests(name: str) -> None:
    assert_there(REPRODUCTIONS[name])


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
def test_commands_show_that_they_are_at_work(log: Path) -> None:
    import pty

    parent, child = pty.openpty()
    run = [sys.executable, "-m", "jaxdet", "info", str(log)]
    subprocess.run(run, stdout=subprocess.DEVNULL, stderr=child, check=True, timeout=300)
    os.close(child)
    said = os.read(parent, 1 << 16).decode()
    os.close(parent)
    assert "reading s" in said


def test_a_torn_log_without_a_calibration_says_both(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with LogFile(path) as file:
        write_images(file, make_scene(3))
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(CalibrationError, match=r"calibration.*; x\.mcap is recovered: .*no end"):
        open_log(path)


def test_an_overflow_names_its_page(log: Path, tmp_path: Path, capsys: Captured) -> None:
    run = ["run", str(log), "--output", str(tmp_path / "out"), "--backend", "reference"]
    few = ["--preset", "paper", "--features.max-corners", "8"]
    assert main([*run, "--pictures", "0", *few]) == 0
    assert "than slots, see jaxdet help tuning" in capsys.readouterr().out
    main(["help", "tuning"])
    assert "`overflow`" in capsys.readouterr().out


def test_how_many_logs_failed_is_said(log: Path, tmp_path: Path, capsys: Captured) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"x")
    run = ["run", str(bad), str(log), "--output", str(tmp_path / "out"), "--backend", "reference"]
    assert main([*run, "--pictures", "0"]) == 1
    assert "; 1 of 2 logs failed" in capsys.readouterr().out
    assert main(["run", str(bad), "--output", str(tmp_path / "none")]) == 1
    said = capsys.readouterr()  # a single log's error is all there is to say
    assert said.out == "nothing was written\n" and said.err.count("\n") == 1


@pytest.mark.parametrize("name, value", [("z", -5), ("x", 400_000)])
def test_points_that_no_camera_sees_are_clustered_alike(name: str, value: int) -> None:
    """They were a crash; both backends put them into the same sets."""
    config = jaxdet.preset("paper")
    depth = np.full((1, 60, 80), 1500, np.uint16)
    color = np.random.default_rng(0).integers(0, 255, (1, 60, 80, 3), np.uint8)
    whole = jaxdet.detect(frames(small(80, 60), color, depth), config, backend="reference")
    assert whole.points is not None
    found = whole.points.features
    given = found._replace(**{name: np.full_like(getattr(found, name), value)})
    from jaxdet import reference, stages

    for module in (reference, stages):
        labels = module.cluster(given, 0.001, config)
        assert np.asarray(labels.num_obstacles).max() < given.x.shape[1]
    assert np.array_equal(
        np.asarray(stages.cluster(given, 0.001, config).labels),
        reference.cluster(given, 0.001, config).labels,
    )


def test_low_level_calls_with_what_is_no_batch_of_frames() -> None:
    given = frames(
        small(80, 60), np.zeros((1, 60, 80, 3), np.uint8), np.zeros((1, 60, 80), np.uint16)
    )
    arrays = given.calibration._replace(color_from_depth=Extrinsics(np.eye(3), [0, 0, 0]))
    none = given._replace(color=given.color[:0], depth=given.depth[:0], valid=given.valid[:0])
    for wrong, said in (
        ([given, given], "frames: list is no Frames; give a Frames"),
        (
            given._replace(calibration=arrays),
            "rotation of color_from_depth: ndarray is no tuple; give a tuple",
        ),
        (none, "there are no frames"),
    ):
        for backend in ("reference", "jax"):
            with pytest.raises((InputError, CalibrationError), match=said):
                jaxdet.detect(wrong, backend=backend)
