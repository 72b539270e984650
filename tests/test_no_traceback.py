"""Wrong input of any kind ends in an error of one line that names the remedy."""

import io
import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxdet.cli import main
from jaxdet.errors import InputError
from jaxdet.render import draw_map
from jaxdet.results.occupancy import MapImage
from jaxdet.sim import SimConfig, load_depths, load_truth, truth, write_log
from jaxdet.sim.truth import truth_path
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    DEPTH,
    DEPTH_FRAME,
    LogFile,
    make_scene,
    ros_compressed,
    ros_image,
    write_calibration,
)
from tests.runs import only_log


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("made") / "s.mcap"
    write_log(path, SimConfig(frames=2, width=96, height=72))
    return path


def ended(capsys, arguments: list[str], code: int) -> str:
    """Run a command that fails; return its only line on standard error, which is printable."""
    assert main(arguments) == code
    message = capsys.readouterr()
    lines = [line for line in message.err.splitlines() if line.startswith("jaxdet: error: ")]
    assert len(lines) == 1 and "Traceback" not in message.err + message.out
    assert lines[0].isprintable()
    return lines[0]


FLAGS = {
    "--batch-size 0": "pass --batch-size 1 or more",
    "--workers 0": "pass --workers from 1",
    "--workers 99999999999999999999": "pass --workers from 1",
    "--pictures -1": "pass --pictures 0 or more",
    "--ground.window-s inf": "ground.window-s must be",
    "--features.canny-low nan": "features.canny-low must be a number",
    "--log.max-pixels 0": "max-pixels must be",
    "--log.depth-unit-m 1e-9": "depth-unit-m must be from 1e-05 to 0.1 m",
    "--log.depth-unit-m 0.5": "depth-unit-m must be from 1e-05 to 0.1 m",
}


@pytest.mark.parametrize("flags", FLAGS)
def test_wrong_flags_are_errors_of_one_line(capsys, tmp_path, made, flags):
    run = ["run", str(made), "--output", str(tmp_path / "out"), *flags.split()]
    assert FLAGS[flags] in ended(capsys, run, 2)


LOG_FLAGS = {
    "--log.color-from-depth nan 0 0 0 0 0 1": "nan m from the colour camera",
    "--log.depth-intrinsics 1e-45 1e-45 0 0": "depth camera is not calibrated",
    "--log.color-intrinsics 50 50 1e39 0": "optical centre",
    "--log.color-intrinsics 309000 309 48 36": "/color/camera_info: fx 309000 and fy 309",
    "--log.color-intrinsics 309000 309000 48 36": "field of view of the colour camera is 0.0178°",
}


@pytest.mark.parametrize("flags", LOG_FLAGS)
def test_implausible_cameras_are_errors_of_one_line(capsys, tmp_path, made, flags):
    run = ["run", str(made), "--output", str(tmp_path / "out"), *flags.split()]
    assert LOG_FLAGS[flags] in ended(capsys, run, 1)


TOML = {
    "lists in lists": b"a=" + b"[" * 5000 + b"]" * 5000,
    "400 digits": b"[ground]\nstep_height_m=" + b"9" * 400,
    "5000 digits": b"[ground]\nstep_height_m=" + b"9" * 5000,
    "inf": b"[ground]\nmax_depth_m=inf",
    "nan": b"[ground]\nmin_depth_m=nan",
    "no text": b"\xff\xfe\x00",
    "control characters": b"[a\\u001b]",
}


@pytest.mark.parametrize("name", TOML)
def test_bad_configuration_files_are_errors_of_one_line(capsys, tmp_path, made, name):
    path = tmp_path / "c.toml"
    path.write_bytes(TOML[name])
    run = ["run", str(made), "--output", str(tmp_path / "out"), "--config", str(path)]
    assert "c.toml" in ended(capsys, run, 2) or name == "nan"


def test_names_of_files_are_escaped_in_errors(capsys, tmp_path, made):
    name = tmp_path / os.fsdecode(b"a\xff\x1b[31m.mcap")
    shutil.copy(made, name)
    run = ["run", str(name), "--backend", "reference", "--pictures", "1"]
    assert main([*run, "--output", str(tmp_path / "out")]) == 0
    message = capsys.readouterr()
    assert r"a\xff\x1b[31m" in message.out and "\x1b" not in message.out + message.err
    folder = only_log(tmp_path / "out")
    assert folder.name.isascii() and folder.name.isprintable()
    assert "\\\\xff" in (folder / "summary.json").read_text(encoding="utf-8")
    assert len(list((folder / "pictures").iterdir())) == 1
    assert main(["info", "--json", str(name)]) == 0
    assert all(line.isprintable() for line in capsys.readouterr().out.splitlines())
    name.write_bytes(b"x")
    assert r"a\xff\x1b[31m.mcap" in ended(capsys, ["info", str(name)], 1)
    assert r"no\x1b[1m" in ended(capsys, ["no\x1b[1m"], 2)


def test_errors_are_shown_on_terminals_with_ascii_only(monkeypatch, made):
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", shown)
    assert main(["info", str(made)]) == 0
    shown.flush()
    assert rb"\xb0" in shown.buffer.getvalue()


def test_a_run_without_usable_frames_exits_with_1(capsys, tmp_path):
    scene, path = make_scene(3), tmp_path / "x.mcap"
    png = cv2.imencode(".png", scene.depth[0])[1].tobytes()
    with LogFile(path) as log:
        write_calibration(log)
        for color, at in zip(scene.color, scene.color_ns.tolist(), strict=True):
            damaged = ros_compressed(
                bytes(12) + png[:300], "16UC1; compressedDepth png", at, DEPTH_FRAME
            )
            log.ros(DEPTH + "/compressedDepth", damaged, at)
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
    run = ["run", str(path), "--backend", "reference", "--output", str(tmp_path / "out")]
    for _ in range(2):  # repeating the command repeats the error
        text = ended(capsys, run, 1)
        assert "none of its 3 frames could be used (3 decode_error); frame 0: " in text


def test_images_in_json_without_width_are_errors_of_one_line(capsys, tmp_path):
    path = tmp_path / "x.mcap"
    with LogFile(path) as log:
        stamp = {"timestamp": {"sec": 1, "nsec": 0}, "frame_id": "a"}
        empty = {"width": 0, "height": 0, "step": 0, "data": ""}
        for topic, form in ((COLOR, "rgb8"), (DEPTH, "16UC1")):
            log.json(topic, "foxglove.RawImage", stamp | empty | {"encoding": form}, 1)
        info = {"width": 0, "height": 0, "distortion_model": "", "D": [], "K": [1.0] * 9, "P": []}
        for topic in ("/cam/color/camera_info", "/cam/depth/camera_info"):
            log.json(topic, "foxglove.CameraCalibration", stamp | info, 1)
    assert "x.mcap" in ended(capsys, ["info", str(path)], 1)


def broken_truth(made: Path, folder: Path, how: str) -> Path:
    """Return a log with damaged ground truth."""
    path = folder / "s.mcap"
    shutil.copy(made, path)
    good = truth_path(made).read_bytes()
    if how == "cut":
        truth_path(path).write_bytes(good[: len(good) // 2])
        return path
    if how == "flipped":
        truth_path(path).write_bytes(good[:200] + bytes(range(256)) + good[456:])
        return path
    with np.load(truth_path(made)) as arrays:
        kept = {name: arrays[name] for name in arrays}
    if how == "missing":
        del kept["depth_000001"]
    if how == "shape":
        kept["T_world_camera"] = kept["T_world_camera"][:, :3]
    if how == "kind":
        kept["stamp_ns"] = kept["stamp_ns"].astype("U20")
    if how == "other size":
        kept["depth_000001"] = kept["depth_000001"][:7]
    np.savez(truth_path(path), **kept)
    if how == "4 GiB":
        head = b"\x93NUMPY\x01\0" + struct.pack("<H", 118)
        text = "{'descr': '|u1', 'fortran_order': False, 'shape': (65536, 65536), }"
        with (
            zipfile.ZipFile(truth_path(path), "a", zipfile.ZIP_DEFLATED) as file,
            file.open("depth_000001.npy", "w", force_zip64=True) as array,
        ):
            array.write(head + text.ljust(117).encode() + b"\n")
            array.write(bytes(4 << 20))
    return path


@pytest.mark.parametrize("how", ["cut", "flipped", "missing", "shape", "kind", "other size"])
def test_damaged_ground_truth_is_an_error_of_one_line(tmp_path, made, how):
    path = broken_truth(made, tmp_path, how)
    with pytest.raises(InputError, match="cannot read ground truth"):
        load_truth(path)
        load_depths(path, [0, 1])


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_ground_truth_with_an_image_of_4_gib_is_refused(tmp_path, made, monkeypatch):
    monkeypatch.setattr(truth, "MAX_ARRAY_BYTES", 2 << 20)
    path = broken_truth(made, tmp_path, "4 GiB")
    with pytest.raises(InputError, match="cannot read ground truth"):
        load_depths(path, [0, 1])


def test_unavailable_platforms_are_errors_of_one_line(tmp_path, made):
    command = [sys.executable, "-m", "jaxdet", "run", str(made), "--output", str(tmp_path / "o")]
    environment = {**os.environ, "JAX_PLATFORMS": "rocm"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode and "Traceback" not in done.stderr
    assert "no device for JAX_PLATFORMS=rocm; unset" in done.stderr


def test_an_internal_error_is_one_line_and_leaves_a_report(capsys, monkeypatch, tmp_path):
    def broken(args: list[str]) -> int:
        raise ZeroDivisionError("not foreseen\n\x1b[31m")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("jaxdet.cli.doctor.main", broken)
    text = ended(capsys, ["doctor"], 1)
    assert "an error in jaxdet itself (ZeroDivisionError)" in text
    [report] = tmp_path.glob("jaxdet-*.txt")
    assert str(report) in text and "not foreseen" in report.read_text()
    assert "\x1b" not in report.read_text()


@pytest.mark.parametrize("far_m", [1e-3, 3.0, 1e8, 1e14])
def test_a_map_of_any_extent_is_drawn(far_m):
    counts = np.ones((3, 4), np.int32)
    path = np.array([[0.0, 0.0], [far_m, -far_m]])
    assert draw_map(MapImage(counts, 0 * counts, (0.0, 0.0), 0.05, path), "map").shape[2] == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("words", [["--help"], ["run", "--help"], ["doctor", "--help"]])
def test_output_that_cannot_be_written_ends_the_command_without_a_traceback(words):
    command = [sys.executable, "-m", "jaxdet", *words]
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        found = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert found.returncode == 1 and "Traceback" not in found.stderr
    ours, theirs = os.pipe()
    os.close(ours)
    found = subprocess.run(command, stdout=theirs, stderr=subprocess.PIPE, text=True)
    os.close(theirs)
    assert found.returncode == 1 and not found.stderr
