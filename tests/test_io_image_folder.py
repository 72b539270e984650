"""Image folders as logs: layouts of TUM, Open3D, ScanNet, 7-Scenes, Stray Scanner, Record3D."""

import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import jaxdet
from jaxdet.errors import CalibrationError, ConfigError, FrameStatus, InputError
from jaxdet.io import Log, LogOptions, find_logs, open_log
from jaxdet.io.folders.layouts import LAYOUTS
from jaxdet.results.manifest import fingerprint
from jaxdet.verify import verify
from tests.runs import run_logs

SIZE = (40, 30)
K = (50.0, 51.0, 20.5, 14.5)
CAMERA = {
    "width": SIZE[0],
    "height": SIZE[1],
    "intrinsic_matrix": [K[0], 0, 0, 0, K[1], 0, K[2], K[3], 1],
}
STAMPS = ("1305031102.175304", "1305031102.211214", "1305031102.275326")
NO_STAMPS = "{}: it has no timestamps; 30 frames per second are assumed"
GIVEN = LogOptions(color_intrinsics=K, depth_unit_m=0.0002)


def images(count: int = 3) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    width, height = SIZE
    color = random.integers(0, 256, (count, height, width, 3), np.uint8)
    return color, random.integers(0, 1 << 16, (count, height, width), np.uint16)


def write(folder: Path, color_names: list[str], depth_names: list[str]) -> None:
    for array, names in zip(images(), (color_names, depth_names), strict=True):
        array = array[: len(names)]
        for image, name in zip(array, names, strict=True):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            flipped = image[..., ::-1] if image.ndim == 3 else image
            assert cv2.imwrite(str(path), flipped)


def write_tum(folder: Path) -> Path:
    names = [[f"{part}/{stamp}.png" for stamp in STAMPS] for part in ("rgb", "depth")]
    write(folder, *names)
    for part, files in zip(("rgb", "depth"), names, strict=True):
        lines = [f"{stamp} {name}\n" for stamp, name in zip(STAMPS, files, strict=True)]
        (folder / f"{part}.txt").write_text("# timestamp filename\n" + "".join(lines))
    poses = [f"{stamp} {i} 0 1.5 0 0 0 1\n" for i, stamp in enumerate(STAMPS)]
    (folder / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "".join(poses))
    return folder


def write_open3d(folder: Path, **camera: object) -> Path:
    write(
        folder,
        [f"color/{number}.png" for number in (8, 9, 10)],
        [f"depth/{number:06d}.png" for number in (8, 9, 10)],
    )
    (folder / "camera.json").write_text(json.dumps({**CAMERA, **camera}))
    return folder


def assert_frames(log, stamps_ns: list[int]) -> None:
    color, depth = images()
    [batch] = log.batches(3, color=True)
    assert set(batch.status) == {FrameStatus.OK}
    assert np.array_equal(batch.frames.color, color)
    assert np.array_equal(batch.frames.depth, depth)
    assert batch.frames.stamp_ns.tolist() == batch.frames.color_stamp_ns.tolist() == stamps_ns


@pytest.mark.parametrize("scan", [False, True])
def test_tum_folders_have_timestamps_and_poses(tmp_path, scan):
    folder = write_tum(tmp_path / "desk.1")
    options = LogOptions(color_intrinsics=K, depth_unit_m=0.0002, scan=scan)
    with open_log(str(folder), options) as log:
        assert log.name == "desk.1"
        assert_frames(log, [int(stamp.replace(".", "")) * 1000 for stamp in STAMPS])
        assert log.calibration.is_aligned and log.calibration.depth_unit == 0.0002
        poses = log.T_world_camera
        assert poses is not None
        assert poses[:, :3, 3].tolist() == [[0, 0, 1.5], [1, 0, 1.5], [2, 0, 1.5]]
        assert not any("stamps" in text for text in log.description.warnings)


@pytest.mark.parametrize("unit", [None, 0.0002])
def test_tum_folders_with_an_implausible_depth_unit_cause_a_warning(tmp_path, unit):
    options = LogOptions(color_intrinsics=K, depth_unit_m=unit)
    with open_log(str(write_tum(tmp_path / "desk")), options) as log:
        warning = [text for text in log.description.warnings if "--log.depth-unit-m 0.0002" in text]
        assert len(warning) == (unit is None)


def test_an_input_without_logs_is_an_error_with_the_known_layouts(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    page = (Path(jaxdet.__file__).parent / "help" / "logs.md").read_text()
    with pytest.raises(InputError, match="no folder of images found") as caught:
        find_logs([str(tmp_path)])
    for layout in LAYOUTS:
        assert layout.names in str(caught.value)
        assert all(name in page for name in layout.names.split(", "))


def test_without_lists_file_names_are_timestamps(tmp_path):
    folder = write_tum(tmp_path / "desk")
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        (folder / name).unlink()
    with open_log(str(folder), GIVEN) as log:
        assert_frames(log, [int(stamp.replace(".", "")) * 1000 for stamp in STAMPS])


def with_capitals(folder: Path) -> Path:
    """Convert all names in a folder to upper case."""
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rename(path.with_name(path.name.upper()))
    return folder


def test_case_of_names_is_ignored(tmp_path):
    """The lists name the images as they are."""
    folder = write_tum(tmp_path / "tum")
    for name in ("rgb", "depth"):
        text = (folder / f"{name}.txt").read_text()
        (folder / f"{name}.txt").write_text(
            text.replace(f"{name}/", f"{name.upper()}/").replace("png", "PNG")
        )
    with open_log(with_capitals(folder), GIVEN) as log:
        assert_frames(log, [int(stamp.replace(".", "")) * 1000 for stamp in STAMPS])
        assert log.T_world_camera is not None
    folder = with_capitals(write_open3d(tmp_path / "room", depth_scale=5000))
    with open_log(folder) as log:
        assert_frames(log, [10**9 + number * 10**9 // 30 for number in (8, 9, 10)])
        assert log.calibration.depth_unit == 0.0002
    (tmp_path / "stray").mkdir()
    confidence = write_stray(tmp_path / "stray")
    with open_log(with_capitals(tmp_path / "stray")) as log:
        np.testing.assert_array_equal(log[2].depth, np.where(confidence[2] > 0, images()[1][2], 0))
        assert_phone_poses(log)


@pytest.mark.parametrize("scan", [False, True])
def test_open3d_folders_have_a_camera_and_frame_numbers(tmp_path, scan):
    folder = write_open3d(tmp_path / "room", depth_scale=5000)
    with open_log(str(folder), LogOptions(scan=scan)) as log:
        assert_frames(log, [10**9 + number * 10**9 // 30 for number in (8, 9, 10)])
        assert log.calibration.depth[:6] == (*SIZE, *K)
        assert log.calibration.depth_unit == 0.0002
        assert NO_STAMPS.format(folder) in log.description.warnings


@pytest.mark.parametrize("given", ["room", "room/depth", "."])
@pytest.mark.parametrize("scan", [False, True])
def test_folders_need_no_colour(tmp_path, given, scan):
    shutil.rmtree(write_open3d(tmp_path / "room", depth_scale=5000) / "color")
    with open_log(str(tmp_path / given), LogOptions(scan=scan)) as log:
        assert log.name == "room" and not log.has_color
        assert log.calibration.depth[:6] == (*SIZE, *K) and log.calibration.depth_unit == 0.0002
        assert np.array_equal(log.read(range(3)).frames.depth, images()[1])


def test_missing_and_truncated_images_are_frames_with_an_error(tmp_path):
    folder = write_tum(tmp_path)
    (folder / "rgb" / f"{STAMPS[1]}.png").unlink()
    (folder / "depth" / f"{STAMPS[2]}.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with open_log(str(folder), GIVEN) as log:
        [batch] = log.batches(3, color=True)
        assert batch.status == (*[FrameStatus.OK] * 2, FrameStatus.DECODE_ERROR)
        missing, torn = f"rgb/{STAMPS[1]}.png", f"depth/{STAMPS[2]}.png"
        assert batch.errors[:2] == ("", "") and batch.errors[2].startswith(f"{torn}: compressed im")
        assert batch.notes.why_bad_color == f"{missing}: the image has no data"
        batch = log.read([1], color=True, need_color=True)
        assert batch.status == (FrameStatus.NO_COLOR,)
        assert batch.errors == (f"{missing}: the image has no data",)
    with (folder / "depth.txt").open("a") as file:
        file.write("1305031110.5 depth/none.png\n")
    with open_log(str(folder), GIVEN) as log:
        assert log.num_frames == 4


@pytest.mark.parametrize("scan", [False, True])
def test_an_unreadable_image_is_a_frame_with_an_error(tmp_path, monkeypatch, scan):
    folder, bad = write_tum(tmp_path), f"{STAMPS[1]}.png"
    opened = Path.open

    def refusing(path, *args, **options):
        if path.name == bad and path.parent.name == "depth":
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, *args, **options)

    monkeypatch.setattr(Path, "open", refusing)
    with open_log(str(folder), replace(GIVEN, scan=scan)) as log:
        [batch] = log.batches(3)
        assert batch.status == (FrameStatus.OK, FrameStatus.DECODE_ERROR, FrameStatus.OK)
        assert f"{bad} can't be read (Permission denied)" in batch.errors[1]
        assert any(f"{bad} can't be read" in text for text in log.description.warnings)


def test_missing_files_of_a_folder_are_named(tmp_path):
    folder = write_open3d(tmp_path / "room")
    (folder / "camera.json").write_text("{}")
    with pytest.raises(CalibrationError, match=r"--log\.color-intrinsics"):
        open_log(str(folder))
    row_major = [K[0], 0, K[2], 0, K[1], K[3], 0, 0, 1]
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "intrinsic_matrix": row_major}))
    with pytest.raises(InputError, match=r"camera\.json.*column-major"):
        open_log(str(folder))
    (folder / "color" / "8.png").rename(folder / "color" / "first.png")
    with pytest.raises(InputError, match=r"first\.png.*neither a timestamp.*number"):
        open_log(str(folder), GIVEN)


def test_an_unreadable_folder_does_not_affect_others(tmp_path):
    write_open3d(tmp_path / "a")
    write_open3d(tmp_path / "b")
    (tmp_path / "a" / "rgb").mkdir()
    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["a", "b"]
    with pytest.raises(InputError, match="several folders of images: color, rgb; keep one"):
        open_log(logs[0])
    with open_log(logs[1]) as log:
        assert log.num_frames == 3


def test_metadata_files_of_macos_are_ignored(tmp_path):
    folder = write_open3d(tmp_path / "room")
    (folder / "pose").write_text("a file, not a folder")
    for path in [*folder.glob("*/*.png"), folder / "drive.mcap", folder / "camera.json"]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\26\7")
    [files] = find_logs([str(tmp_path)])
    with open_log(files) as log:
        assert log.name == "room"
        assert_frames(log, [10**9 + number * 10**9 // 30 for number in (8, 9, 10)])


def test_changes_of_a_folder_while_reading_are_reported(tmp_path):
    folder = write_open3d(tmp_path / "room")
    before = fingerprint(folder)
    with open_log(str(folder)) as log:
        (folder / "color" / "11.png").write_bytes(b"x")
        with pytest.raises(InputError, match="changed while it was read"):
            list(log.batches(3))
    assert fingerprint(folder) != before and "size" in before
    with open_log(str(folder)) as log:
        shutil.rmtree(folder)
        with pytest.raises(InputError, match="changed while it was read"):
            list(log.batches(3))


def test_results_record_the_image_folder(tmp_path):
    """The folder is found again, a copy counts as the same log, and results inside are refused."""
    folder = write_tum(tmp_path / "room")

    def results(output: Path) -> Path:
        run_logs(folder, output, log=GIVEN, pictures=0)
        return output

    found = verify(results(tmp_path / "out"))
    assert not (found.findings or found.notes) and found.frames_of_logs == len(STAMPS)
    (tmp_path / "copy").mkdir()
    copy = shutil.copytree(folder, tmp_path / "copy" / "room", copy_function=shutil.copyfile)
    copied, known = fingerprint(copy), fingerprint(folder)
    assert {**copied, "path": 0, "mtime_ns": 0} == {**known, "path": 0, "mtime_ns": 0}
    assert copied["mtime_ns"] != known["mtime_ns"]
    shutil.rmtree(folder)
    found = verify(tmp_path / "out", [str(copy)])
    assert not (found.findings or found.notes) and found.frames_of_logs == len(STAMPS)
    [note] = verify(tmp_path / "out").notes
    assert note.endswith("the log is not at its original path; pass it with --against")
    write_tum(folder)
    for inside in (folder, folder / "out"):
        with pytest.raises(ConfigError, match=r"is in the log .*; pass an --output next to it"):
            results(inside)
    assert not (folder / ".jaxdet").exists()


def test_recordings_take_precedence_over_images_next_to_them(tmp_path):
    write_open3d(tmp_path / "frames")
    (tmp_path / "drive.mcap").write_bytes(b"x")
    [log] = find_logs([str(tmp_path)])
    assert [path.name for path in log.paths] == ["drive.mcap"]
    assert "frames is left out: images next to a recording" in log.note


def test_images_in_other_folders_are_separate_logs(tmp_path):
    write_open3d(tmp_path / "b" / "one")
    write_open3d(tmp_path / "a" / "two")
    (tmp_path / "a" / "drive.mcap").write_bytes(b"x")
    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["a/drive", "b/one"]
    assert "a/two is left out: images next to a recording" in logs[0].note
    assert logs[1].note == ""


def test_depth_is_aligned_by_the_layout_of_the_folder(tmp_path):
    text = "depth is assumed to be aligned to colour, as in TUM's and Open3D's folders; otherwise"
    for folder, warning in (
        (write_tum(tmp_path / "tum"), True),
        (write_open3d(tmp_path / "o"), False),
    ):
        with open_log(str(folder), GIVEN if warning else LogOptions()) as log:
            found = [line for line in log.description.warnings if line.startswith(text)]
            assert (len(found), log.description.extrinsics_source) == (
                warning,
                "not needed: depth is aligned to colour (as in TUM's and Open3D's folders)",
            )


def test_a_recorded_folder_of_open3d_is_read(shared_data):
    folder = shared_data / "d435_boxes_felixchenfy" / "data"
    with open_log(str(folder)) as log:
        assert log.num_frames == 10 and log.calibration.is_aligned
        batch = log.read([7], color=True)
        assert batch.status == (FrameStatus.OK,)
        depth = cv2.imread(str(folder / "depth" / "000007.png"), cv2.IMREAD_UNCHANGED)
        color = cv2.imread(str(folder / "color" / "000007.png"))
        assert np.array_equal(batch.frames.depth[0], depth)
        assert np.array_equal(batch.frames.color[0], color[..., ::-1])


@pytest.mark.parametrize(
    "camera", [{"width": -5}, {"height": 1e39}, {"depth_scale": 0}, {"depth_scale": 1e-300}]
)
def test_invalid_camera_files_are_errors(tmp_path, camera):
    with pytest.raises(InputError, match=r"camera\.json.*can't be read"):
        open_log(str(write_open3d(tmp_path / "room", **camera)))


@pytest.mark.parametrize(
    "stamp", ["nan", "inf", "-1", "2147483647.1", "1e999999999", "9" * 5000, "x"]
)
def test_invalid_timestamps_are_errors(tmp_path, stamp):
    folder = write_tum(tmp_path / "desk")
    with (folder / "rgb.txt").open("a") as file:
        file.write(f"{stamp} rgb/{STAMPS[0]}.png\n")
    with pytest.raises(
        InputError, match=r"rgb\.txt.*(expected a timestamp|out of range)"
    ) as caught:
        open_log(str(folder), GIVEN)
    assert len(str(caught.value)) < 200 + len(str(folder))


def test_depth_without_a_scale_is_in_millimetres(tmp_path):
    with open_log(str(write_open3d(tmp_path / "room"))) as log:
        assert log.calibration.depth_unit == 0.001


def test_the_fingerprint_depends_on_the_size_of_each_file(tmp_path):
    sizes = {"a.png": 1, "b.png": 2}
    found = []
    for _ in range(2):
        for name, size in sizes.items():
            (tmp_path / name).write_bytes(b"x" * size)
        found.append(fingerprint(tmp_path)["fingerprint"])
        sizes = {"a.png": 2, "b.png": 1}
    assert found[0] != found[1]


def depth_poses(count: int = 3) -> np.ndarray:
    T = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    T[:, :3, 3] = np.arange(count)[:, None] * [0.1, 0.2, 0.0] + [0, 0, 1.5]
    return T


@pytest.mark.parametrize("matrices", ["intrinsic/intrinsic", "intrinsics", "intrinsic"])
@pytest.mark.parametrize(("lost", "pose"), [(False, "{}"), (True, "{}"), (False, "{:06d}")])
def test_scannet_folders_have_both_calibrations_and_poses(tmp_path, lost, pose, matrices):
    write(tmp_path, [f"color/{i}.jpg" for i in (0, 1, 10)], [])
    for image, number in zip(images()[1], (0, 1, 10), strict=True):
        (tmp_path / "depth").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"depth/{number}.png"), image[::2, ::2])
    for name in ("intrinsic", "pose"):
        (tmp_path / name).mkdir()
    for kind, factor in (("color", 1), ("depth", 2)):
        matrix = np.eye(4)
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = np.array(K) / factor
        np.savetxt(tmp_path / f"{matrices}_{kind}.txt", matrix)
    poses = depth_poses()
    for T, number in zip(poses, (0, 1, 10), strict=True):
        T = np.full((4, 4), -np.inf) if lost and number == 1 else T
        np.savetxt(tmp_path / "pose" / f"{pose.format(number)}.txt", T)
    with open_log(str(tmp_path)) as log:
        np.testing.assert_allclose(log.calibration.depth[2:6], np.array(K) / 2)
        assert log.calibration.color is not None and log.calibration.color[2:6] == K
        assert log.depth_shape == (15, 20) and log.color_shape == (30, 40, 3)
        np.testing.assert_array_equal(log[0].depth, images()[1][0][::2, ::2])
        assert log.T_world_camera is not None
        some = [0, 2] if lost else [0, 1, 2]  # a lost pose is interpolated
        np.testing.assert_allclose(log.T_world_camera[some], poses[some], atol=1e-12)


def test_seven_scenes_folders_are_read(tmp_path):
    names = [f"frame-{i:06d}" for i in range(3)]
    write(tmp_path, [f"{n}.color.png" for n in names], [f"{n}.depth.png" for n in names])
    for T, name in zip(depth_poses(), names, strict=True):
        np.savetxt(tmp_path / f"{name}.pose.txt", T)
    with pytest.raises(CalibrationError, match=r"--log\.color-intrinsics"):
        open_log(str(tmp_path))
    with open_log(str(tmp_path), LogOptions(color_intrinsics=K)) as log:
        assert NO_STAMPS.format(tmp_path) in log.description.warnings
        assert log.num_frames == 3 and log.has_color
        np.testing.assert_array_equal(log[2].depth, images()[1][2])
        np.testing.assert_allclose(log.T_world_camera, depth_poses(), atol=1e-12)


ARKIT_POSES = [(0.1 * i, 1.5, -0.2 * i) for i in range(3)]
"""Positions of a camera that looks along -z, in the world of ARKit, whose y is up."""


def assert_phone_poses(log: Log) -> None:
    """Assert that the camera looks along y of a world with z up, at unchanged x."""
    assert log.T_world_camera is not None
    rotation = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    for T, (x, y, z) in zip(log.T_world_camera, ARKIT_POSES, strict=True):
        np.testing.assert_allclose(T[:3, :3], rotation, atol=1e-9)
        np.testing.assert_allclose(T[:3, 3], (x, -z, y), atol=1e-9)


def write_stray(folder: Path) -> np.ndarray:
    """Write a recording of Stray Scanner without its video; return the confidences."""
    depths = images()[1]
    confidence = np.random.default_rng(1).integers(0, 3, depths.shape).astype(np.uint8)
    for name, stack in (("depth", depths), ("confidence", confidence)):
        (folder / name).mkdir()
        for number, image in enumerate(stack):
            cv2.imwrite(str(folder / name / f"{number:06d}.png"), image)
    matrix = [[1400.0, 0, 960.0], [0, 1400.0, 720.0], [0, 0, 1]]
    np.savetxt(folder / "camera_matrix.csv", matrix, delimiter=",")
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i, (x, y, z) in enumerate(ARKIT_POSES):  # q is that of ARKit, turned 180° about x
        lines.append(f"{100 + i / 60}, {i:06d}, {x}, {y}, {z}, 1.0, 0.0, 0.0, 0.0")
    (folder / "odometry.csv").write_text("\n".join(lines))
    return confidence


@pytest.mark.parametrize("scan", [False, True])
def test_stray_scanner_folders_have_confidences_and_poses(tmp_path, scan):
    confidence = write_stray(tmp_path)
    with open_log(str(tmp_path), LogOptions(scan=scan)) as log:
        depths = images()[1]
        height, width = depths.shape[1:]
        camera = log.calibration.depth
        wanted = 1400 * width / 1920, 1400 * height / 1440, width / 2, height / 2
        assert not log.has_color and camera[2:6] == pytest.approx(wanted)
        for frame, depth, mask in zip(log, depths, confidence, strict=True):
            assert frame.error == ""
            np.testing.assert_array_equal(frame.depth, np.where(mask > 0, depth, 0))
        stamps = [round((100 + i / 60) * 1e9) for i in range(3)]
        assert np.abs(log.stamps_ns - stamps).max() < 1000
        assert_phone_poses(log)


def test_a_depth_image_without_its_confidences_is_a_frame_with_an_error(tmp_path):
    write_stray(tmp_path)
    (tmp_path / "confidence" / "000001.png").unlink()
    with open_log(str(tmp_path), LogOptions(scan=True)) as log:
        errors = [frame.error for frame in log]
        assert errors[::2] == ["", ""] and "000001.png: the confidences can't" in errors[1]
    (tmp_path / "odometry.csv").write_text("timestamp, frame, x, y, z, qx, qy, qz, qw\n1, 0, x")
    with pytest.raises(InputError, match=r"recording's data can't be read .*; export it again"):
        open_log(str(tmp_path))


def test_depth_images_after_the_end_of_torn_odometry_are_reported(tmp_path):
    write_stray(tmp_path)
    path = tmp_path / "odometry.csv"
    path.write_text(path.read_text()[:-20])
    with open_log(str(tmp_path)) as log:
        np.testing.assert_array_equal(log.T_world_camera[:, 2, 3], 1.5)
        assert log.num_frames == 2
        text = "1 depth images without a timestamp are left out, for example 000002.png"
        assert f"{tmp_path}: {text}" in log.description.warnings


@pytest.mark.filterwarnings("error")
def test_invalid_poses_of_phones_are_ignored(tmp_path):
    write_stray(tmp_path)
    path = tmp_path / "odometry.csv"
    path.write_text(path.read_text().replace("1.0, 0.0, 0.0, 0.0", "0.0, 0.0, 0.0, 0.0", 1))
    with open_log(str(tmp_path)) as log:
        assert log.num_frames == 3 and log.T_world_camera is not None
        assert np.isfinite(log.T_world_camera[1:]).all()


def test_confidences_may_be_padded_differently(tmp_path):
    folder = write_open3d(tmp_path / "room")
    (folder / "Confidence").mkdir()
    for number in (8, 9, 10):
        mask = np.full(SIZE[::-1], number != 9, np.uint8)
        assert cv2.imwrite(str(folder / "Confidence" / f"{number}.png"), mask)
    with open_log(str(folder)) as log:
        assert [frame.error for frame in log] == [""] * 3
        assert [bool(frame.depth.any()) for frame in log] == [True, False, True]


def test_a_missing_depth_image_with_confidences_is_a_frame_with_an_error(tmp_path):
    folder = write_tum(tmp_path)
    (folder / "confidence").mkdir()
    for stamp in STAMPS:
        ones = np.ones(SIZE[::-1], np.uint8)
        assert cv2.imwrite(str(folder / "confidence" / f"{stamp}.png"), ones)
    name = f"depth/{STAMPS[1]}.png"
    (folder / name).unlink()
    with open_log(str(folder), GIVEN) as log:
        errors = [frame.error for frame in log]
        assert errors[::2] == ["", ""] and f"{name} can't be read (No such file" in errors[1]


def test_record3d_folders_with_depth_in_png_are_read(tmp_path):
    write(tmp_path, [f"rgb/{i}.png" for i in range(3)], [f"depth/{i}.png" for i in range(3)])
    color, depths = images()
    poses = [(0.0, 0.0, 0.0, 1.0, *place) for place in ARKIT_POSES]
    height, width = color.shape[1:3]
    about = {"K": [90, 0, 0, 0, 91, 0, width / 2, height / 2, 1], "w": width, "h": height}
    about |= {"fps": 60, "poses": poses}
    (tmp_path / "metadata.json").write_text(json.dumps(about))
    with open_log(str(tmp_path)) as log:
        assert log.calibration.image[2:6] == (90, 91, width / 2, height / 2) and log.has_color
        np.testing.assert_array_equal(log[1].depth, depths[1])
        assert np.diff(log.stamps_ns).tolist() == pytest.approx([1e9 / 60] * 2, abs=2)
        assert log.stamps_ns[0] == 10**9  # zero would mean that there is no timestamp
        assert_phone_poses(log)
    (tmp_path / "metadata.json").write_text(json.dumps(about | {"poses": poses[:1]}))
    with open_log(str(tmp_path)) as log:
        assert log.num_frames == 3 and log.T_world_camera is not None
        assert np.isfinite(log.T_world_camera[0]).all()
    for wrong in ({"frameTimestamps": [[0.0, 1.0]]}, {"fps": 0}):
        (tmp_path / "metadata.json").write_text(json.dumps(about | wrong))
        with pytest.raises(InputError, match=r"recording's data can't be read .*; export it again"):
            open_log(str(tmp_path))
    swapped = about | {"w": height, "h": width}
    (tmp_path / "metadata.json").write_text(json.dumps(swapped))
    with pytest.raises(InputError, match=r"matrix is for 30x40 pixels, but images have 40x30"):
        open_log(str(tmp_path))
    for path in (tmp_path / "depth").iterdir():
        path.rename(path.with_suffix(".exr"))
    with pytest.raises(
        InputError, match=r"depth in .exr files is not supported; export it as 16-bit PNG"
    ):
        open_log(str(tmp_path))


@pytest.mark.parametrize("color", ["image", "rgb"])
def test_redwood_folders_have_timestamps_in_file_names(tmp_path, color):
    names = [f"{i + 1:07d}-{i * 33_369:012d}" for i in range(3)]
    write(tmp_path, [f"{color}/{n}.jpg" for n in names], [f"depth/{n}.png" for n in names])
    with open_log(str(tmp_path), LogOptions(color_intrinsics=K)) as log:
        assert np.diff(log.stamps_ns).tolist() == [33_369_000] * 2
        assert not any("no timestamps" in text for text in log.description.warnings)


def test_times_in_the_names_of_only_one_kind_of_image_cause_a_warning(tmp_path):
    times, numbers = ["0000001-000000000000"], ["000000"]
    for folder, color, depth in (("a", times, numbers), ("b", numbers, times), ("c", times, times)):
        write(tmp_path / folder, [f"rgb/{n}.jpg" for n in color], [f"depth/{n}.png" for n in depth])
        with open_log(str(tmp_path / folder), LogOptions(color_intrinsics=K)) as log:
            warns = NO_STAMPS.format(tmp_path / folder) in log.description.warnings
            assert warns == (folder != "c")


@pytest.mark.parametrize(("times", "gap"), [(False, "\n"), (True, "\n"), (False, " ")])
def test_depth_of_sun3d_folders_is_rotated_by_three_bits(tmp_path, times, gap):
    names = [f"{i + 1:07d}" + f"-{i * 33_369:012d}" * times for i in range(3)]
    write(tmp_path, [f"image/{n}.jpg" for n in names], [f"depth/{n}.png" for n in names])
    rows = f"{K[0]} 0 {K[2]}", f"0 {K[1]} {K[3]}", "0 0 1"
    (tmp_path / "intrinsics.txt").write_text(gap.join(rows))
    with open_log(str(tmp_path)) as log:
        assert log.calibration.depth[2:6] == K
        for frame, stored in zip(log, images()[1], strict=True):
            np.testing.assert_array_equal((frame.depth << 3) | (frame.depth >> 13), stored)


@pytest.mark.parametrize("raw", [False, True])
def test_depth_of_openloris_folders_is_the_aligned_one(tmp_path, raw):
    parts = ("color", "aligned_depth")
    names = [[f"{part}/{stamp}.png" for stamp in STAMPS] for part in parts]
    write(tmp_path, *names)
    for part, files in zip(parts, names, strict=True):
        lines = [f"{stamp} {name}\r\n" for stamp, name in zip(STAMPS, files, strict=True)]
        (tmp_path / f"{part}.txt").write_bytes(
            b"\xef\xbb\xbf# Time name\r\n" + "".join(lines).encode()
        )
    if raw:
        write(tmp_path, [], [f"depth/{stamp}.png" for stamp in STAMPS[::-1]])
    with open_log(str(tmp_path), GIVEN) as log:
        assert_frames(log, [int(stamp.replace(".", "")) * 1000 for stamp in STAMPS])


@pytest.mark.parametrize(
    ("color", "depth"),
    [("{:05d}", "{:05d}_d16"), ("{}_cam0", "{}_cam0"), ("f{}_640x480", "{}-1403636579763555")],
)
def test_frame_numbers_are_the_numbers_that_differ(tmp_path, color, depth):
    numbers = 8, 9, 10
    colors = [f"rgb/{color.format(number)}.png" for number in numbers]
    write(tmp_path, colors, [f"depth/{depth.format(number)}.png" for number in numbers])
    with open_log(str(tmp_path), LogOptions(color_intrinsics=K)) as log:
        assert_frames(log, [10**9 + number * 10**9 // 30 for number in numbers])


def test_images_with_the_same_frame_number_are_an_error(tmp_path):
    folder = write_open3d(tmp_path / "room")
    shutil.copy(folder / "depth" / "000009.png", folder / "depth" / "000009_view.png")
    text = r"room/depth: 2 images have the frame number 9; remove all but one"
    with pytest.raises(InputError, match=text):
        open_log(str(folder))


@pytest.mark.parametrize("kind", ["rgb", "depth"])
def test_a_list_of_images_that_do_not_exist_is_an_error(tmp_path, kind):
    folder = write_tum(tmp_path)
    path = folder / f"{kind}.txt"
    path.write_text(path.read_text().replace(f"{kind}/", f"{kind}\\"))
    with pytest.raises(
        InputError, match=rf"{kind}\.txt: none of the 3 images .* exists.*{kind}.*png"
    ):
        open_log(str(folder), GIVEN)
    path.write_text("")
    with pytest.raises(InputError, match=rf"{kind}\.txt: none of the 0 images .* remove the list"):
        open_log(str(folder), GIVEN)


def test_a_list_of_colour_in_a_folder_without_colour_is_ignored(tmp_path):
    folder = write_tum(tmp_path)
    shutil.rmtree(folder / "rgb")
    with open_log(str(folder), GIVEN) as log:
        assert log.num_frames == 3 and not log.has_color
