"""Logs in every serialization, container and form of depth, and split logs."""

import pickle

import numpy as np
import pytest

from jaxdet.errors import InputError
from jaxdet.io import LogOptions, find_logs, open_log
from tests.io_foxglove import write_foxglove
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_K,
    DEPTH_SIZE,
    SECOND,
    T_COLOR_DEPTH,
    LogFile,
    Scene,
    assert_holds,
    make_scene,
    ros_header,
    ros_image,
    ros_info,
    ros_type,
    write_calibration,
    write_images,
    write_log,
)


@pytest.mark.parametrize("form", ["ros", "proto", "json"])
def test_each_serialization_gives_the_same_frames(tmp_path, form):
    scene = make_scene()
    path = tmp_path / "log.mcap"
    if form == "ros":
        write_log(path, scene)
    else:
        write_foxglove(path, scene, form)
    with open_log(str(path)) as log:
        assert_holds(log, scene)
        assert_holds(log, scene, batch_size=5)
        with pickle.loads(pickle.dumps(log)) as sent:
            assert_holds(sent, scene, batch_size=2)
            assert str(sent.description) == str(log.description)
        color, depth = log.calibration.color, log.calibration.depth
        assert (color.width, color.height) == COLOR_SIZE and color[2:6] == COLOR_K
        assert depth is not None and (depth.width, depth.height) == DEPTH_SIZE
        assert depth[2:6] == DEPTH_K and log.calibration.color_from_depth is not None
        np.testing.assert_allclose(log.calibration.color_from_depth.T, T_COLOR_DEPTH, atol=1e-12)
        back = log.read([2, 0], color=True)
        np.testing.assert_array_equal(back.frames.color, scene.color[[2, 0]])
        with pytest.raises(IndexError):
            log.read([3])
        for wrong in ("all", 1.5, None):
            with pytest.raises(InputError, match="expected a bool or a collection"):
                log.read([0], color=wrong)
            with pytest.raises(InputError, match="expected a bool or a collection"):
                next(log.batches(1, color=wrong))


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"chunk_size": 3000}])
def test_each_form_of_container_gives_the_same_frames(tmp_path, compression, options):
    scene = make_scene(5)
    path = write_log(tmp_path / "log.mcap", scene, compression=compression, **options)
    with open_log(str(path)) as log:
        assert_holds(log, scene)


def test_aligned_depth_takes_precedence_over_raw_depth(tmp_path):
    raw, aligned = make_scene(), make_scene(size=COLOR_SIZE)
    topic = "/cam/aligned_depth_to_color/image_raw"
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log)
        write_images(log, raw)
        for depth, at in zip(aligned.depth, aligned.depth_ns, strict=True):
            log.ros(topic, ros_image(depth, "16UC1", int(at), COLOR_FRAME), int(at))
    with open_log(str(tmp_path / "log.mcap")) as log:
        assert log.calibration.is_aligned and "aligned" in log.description.choices[0]
        assert_holds(log, aligned)
    with open_log(str(tmp_path / "log.mcap"), LogOptions(depth=DEPTH)) as log:
        assert not log.calibration.is_aligned
        assert_holds(log, raw)


def test_depth_in_metres_equals_depth_in_millimetres(tmp_path):
    scene = make_scene()
    with LogFile(tmp_path / "log.mcap") as log:
        write_calibration(log)
        for color, depth, at, depth_at in zip(*scene, strict=True):
            metres = np.where(depth == 0, np.nan, depth * 0.001).astype(np.float32)
            image = ros_image(metres, "32FC1", int(depth_at), DEPTH_FRAME)
            log.ros(DEPTH, image, int(depth_at))
            log.ros(COLOR, ros_image(color, "rgb8", int(at), COLOR_FRAME), int(at))
    with open_log(str(tmp_path / "log.mcap")) as log:
        assert_holds(log, scene)


def test_images_of_an_rgbd_message_are_paired_whatever_their_timestamps(tmp_path):
    scene = make_scene(size=COLOR_SIZE)._replace(depth_ns=make_scene().color_ns - SECOND)
    with LogFile(tmp_path / "log.mcap") as log:
        for color, depth, at, depth_at in zip(*scene, strict=True):
            message = ros_type("realsense2_camera_msgs/msg/RGBD")(
                ros_header(int(at), "camera"),
                ros_info(COLOR_SIZE, COLOR_K, int(at), COLOR_FRAME),
                ros_info(COLOR_SIZE, COLOR_K, int(at), COLOR_FRAME),
                ros_image(color, "rgb8", int(at), COLOR_FRAME),
                ros_image(depth, "16UC1", int(depth_at), COLOR_FRAME),
            )
            log.ros("/cam/rgbd", message, int(at))
    with open_log(str(tmp_path / "log.mcap")) as log:
        assert log.calibration.is_aligned
        assert_holds(log, scene)


def test_splits_are_one_log_with_common_static_transforms(tmp_path):
    scene = make_scene(24)
    halves = [Scene(*(part[:10] for part in scene)), Scene(*(part[10:] for part in scene))]
    names = ["bag_2.mcap", "bag_10.mcap"]
    for name, half in zip(names, halves, strict=True):
        with LogFile(tmp_path / name) as log:
            write_calibration(log, tf=name == names[0])
            write_images(log, half)
    listed = "".join(f"  - {name}\n" for name in names)
    (tmp_path / "metadata.yaml").write_text(f"relative_file_paths:\n{listed}")
    [files] = find_logs([str(tmp_path)])
    assert files.name == "bag_2" and [path.name for path in files.paths] == names
    with open_log(files) as log:
        assert_holds(log, scene, batch_size=7)
        assert any("missing" in text for text in log.description.warnings)
    with open_log(str(tmp_path / names[1])) as log:
        assert_holds(log, halves[1])
        assert any("split bag_2.mcap" in text for text in log.description.warnings)


def test_images_are_decoded_into_given_arrays(tmp_path):
    scene = make_scene(5)
    path = write_log(tmp_path / "log.mcap", scene)
    with open_log(str(path)) as log:
        assert log.color_shape is not None
        depth, color = (
            np.full((4, *log.depth_shape), 7, "u2"),
            np.full((4, *log.color_shape), 7, "u1"),
        )
        batches = log.batches(4, images=lambda: (depth, color), color=True)
        for start, batch in zip((0, 4), batches, strict=True):
            assert batch.frames.color is color and batch.frames.depth is depth
            count = len(batch.status)
            np.testing.assert_array_equal(color[:count], scene.color[start : start + 4])
            np.testing.assert_array_equal(depth[:count], scene.depth[start : start + 4])
            assert not color[count:].any() and not depth[count:].any()
        depth[:], color[:] = 7, 7
        for batch in log.batches(4, images=lambda: (depth, color), color={1}):
            count, first = len(batch.status), int(batch.frames.number[0])
            np.testing.assert_array_equal(depth[:count], scene.depth[first : first + 4])
            np.testing.assert_array_equal(color[1], scene.color[1] if first == 0 else 0 * color[1])
            assert not np.delete(color, 1, 0).any()
        for batch in log.batches(4, images=lambda: depth):
            assert batch.frames.depth is depth and batch.frames.color is None
