"""ROS 2 node, run with a stub of ROS 2; it was never run with the real one."""

import importlib
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import jaxdet
from jaxdet.cli import main as jaxdet_command
from jaxdet.ros2.__main__ import LAUNCH_FILE, main
from jaxdet.ros2.node import PARAMETERS, UNPAIRED, ObstacleNode
from tests.ros2_stub import Node, image_message, info_message, install

DEPTH, INFO = "/cam/depth/image", "/cam/depth/camera_info"
TOPICS = ["/tf", "/jaxdet/scan", "/jaxdet/local_map", "/jaxdet/detections"]


@pytest.fixture(scope="module")
def frames(driven_log: Path) -> Iterator[tuple[Any, list[Any]]]:
    """Intrinsics, and the frames of a log."""
    with jaxdet.open_log(driven_log) as log:
        yield log.calibration.depth, list(log)


def deliver(node: Node, image: Any, info: Any) -> None:
    node.deliver(DEPTH, image)
    node.deliver(INFO, info)


def same(a: Any, b: Any) -> bool:
    """Return whether two messages are equal, including NaN."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    if hasattr(a, "__msgtype__"):
        names = a.__dataclass_fields__
        return all(same(getattr(a, name), getattr(b, name)) for name in names)
    return a == b


def test_messages_equal_those_of_the_export(driven_results, frames, tmp_path, monkeypatch):
    camera, images = frames
    with jaxdet.open_results(driven_results) as results:
        (prior,) = results.logs[0].summary["ground"]
    command = ["export", str(driven_results), "--to", "ros2", "--output", str(tmp_path / "out")]
    assert jaxdet_command(command) == 0
    exported: dict[str, list[Any]] = {}
    with AnyReader([tmp_path / "out/sim.jaxdet.mcap"]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            exported.setdefault(connection.topic, []).append(message)
    node = install(
        monkeypatch, **{f"camera_{k}": prior[k] for k in ("height_m", "pitch_rad", "roll_rad")}
    )
    obstacles = ObstacleNode(node)
    for frame in images:
        deliver(
            node,
            image_message(frame.stamp_ns, "camera_depth_optical_frame", frame.depth),
            info_message(frame.stamp_ns, camera),
        )
    assert node.warnings == [] and obstacles.published == obstacles.received == len(images)
    for topic in TOPICS:
        assert len(node.published[topic]) == len(images)
        assert same(node.published[topic], exported[topic]), topic
    assert any(message.detections for message in node.published["/jaxdet/detections"])


def test_node_declares_topics_qos_and_parameters(monkeypatch):
    node = install(monkeypatch)
    ObstacleNode(node)
    newest = {"depth": 1, "reliability": "best_effort"}
    assert node.qos[DEPTH] == node.qos[INFO] == newest
    assert node.qos["/jaxdet/local_map"] == {"depth": 1, "durability": "transient_local"}
    assert list(node.published) == TOPICS
    assert node.declared.keys() == PARAMETERS.keys()
    node = install(monkeypatch, publish_grid=False)
    ObstacleNode(node)
    assert list(node.published) == [name for name in TOPICS if name != "/jaxdet/local_map"]


def bad_images(camera: Any, depth: np.ndarray) -> dict[str, tuple[Any, Any]]:
    """Return pairs of image and calibration by the warning that they cause."""
    good, small = image_message(7, "camera", depth), image_message(7, "camera", depth[:60])
    short = image_message(7, "camera", depth)
    del short.data[-100:]
    huge = image_message(7, "camera", depth)
    huge.height = huge.width = 60_000
    huge.step = 120_000
    color = image_message(7, "camera", np.zeros((*depth.shape, 3), np.uint8), "rgb8")
    size = "the depth images are 160x60, but their calibration is for 160x120; "
    size += "remap camera_info to the"
    return {
        "encoding 'rgb8' is not depth; remap depth": (color, info_message(7, camera)),
        f"{size} calibration of {DEPTH}": (small, info_message(7, camera)),
        "bytes are too few for 160x120": (short, info_message(7, camera)),
        "bytes are too few for 60000x60000": (huge, info_message(7, camera)),
        "/camera_info: the depth camera is not calibrated": (
            good,
            info_message(7, camera._replace(fx=0.0, fy=0.0)),
        ),
        "no measurement in range": (
            image_message(7, "camera", np.zeros_like(depth)),
            info_message(7, camera),
        ),
    }


def test_nothing_is_published_for_unusable_images(frames, monkeypatch):
    camera, images = frames
    node = install(monkeypatch)
    obstacles = ObstacleNode(node)
    for warning, (image, info) in bad_images(camera, images[0].depth).items():
        node.warnings.clear()
        deliver(node, image, info)
        (reported,) = node.warnings
        assert warning in reported and reported.startswith("nothing is published: /cam/depth/")
        assert "--" not in reported and set(node.counts().values()) == {0}
    deliver(node, image_message(8, "camera", images[0].depth), info_message(8, camera))
    assert set(node.counts().values()) == {1}
    assert str(obstacles) == "7 depth images, 1 with published obstacles"


def test_images_without_calibration_are_a_warning(frames, monkeypatch):
    camera, images = frames
    node = install(monkeypatch)
    obstacles = ObstacleNode(node)
    for number in range(UNPAIRED + 1):
        assert node.warnings == []
        node.deliver(DEPTH, image_message(number * 10**8, "camera", images[0].depth))
    (reported,) = node.warnings
    assert reported.startswith(f"{INFO}: no CameraInfo within slop_s of the last 31 depth images")
    node.deliver(INFO, info_message(UNPAIRED * 10**8 + 4 * 10**7, camera))
    (message,) = node.published["/jaxdet/detections"]
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 0)
    assert (obstacles.received, obstacles.published) == (UNPAIRED + 1, 1)


def test_a_changed_calibration_is_used_from_its_image_on(frames, monkeypatch):
    camera, images = frames
    depth, wider = images[0].depth, camera._replace(fx=camera.fx * 0.8, fy=camera.fy * 0.8)
    node = install(monkeypatch, camera_frame="other")
    ObstacleNode(node)
    for stamp, used in enumerate((camera, camera, wider)):
        deliver(node, image_message(stamp, "camera", depth), info_message(stamp, used))
    assert len(node.infos) == 2 and "changed calibration, 160x120" in node.infos[1]
    first, second, third = node.published["/jaxdet/detections"]
    assert same(first.detections[0].bbox, second.detections[0].bbox)
    assert first.header.frame_id == "other"
    expected = jaxdet.Detector(wider)(depth)
    assert len(third.detections) == len(expected)
    assert not same(first.detections[0].bbox, third.detections[0].bbox)


def test_float_depth_and_rectified_images_are_used(frames, monkeypatch):
    """Float images are in metres, and rectified images have no distortion."""
    camera, images = frames
    depth, metres = 2 * images[0].depth, images[0].depth.astype("<f4") / 1000
    node = install(monkeypatch, depth_unit_m=0.0005)
    node.remaps["depth"] = "/cam/image_rect"
    ObstacleNode(node)
    info = info_message(0, camera, D=(0.1, 0.0, 0.0, 0.0, 0.0))
    info.p[0], info.p[5], info.p[2], info.p[6] = camera.fx, camera.fy, camera.cx, camera.cy
    for pixels, encoding in ((metres, "32FC1"), (depth, "16UC1")):
        node.deliver("/cam/image_rect", image_message(0, "camera", pixels, encoding))
        node.deliver(INFO, info)
    expected = jaxdet.Detector(camera, depth_unit_m=0.0005)(depth)
    first, second = node.published["/jaxdet/detections"]
    assert same(first, second) and len(first.detections) == len(expected) > 0
    table = expected.to_pandas()
    heights = (table.top_m - table.bottom_m).tolist()
    assert [one.bbox.size.z for one in first.detections] == pytest.approx(heights)
    assert "plumb_bob" not in node.infos[0]


def test_the_mount_comes_from_tf(frames, monkeypatch):
    camera, images = frames
    node = install(monkeypatch, base_frame="base_link", config="wheeled")
    ObstacleNode(node)
    pair = image_message(0, "camera", images[0].depth), info_message(0, camera)
    deliver(node, *pair)
    (reported,) = node.warnings
    assert "base_frame base_link: no transform to 'camera'" in reported
    level = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.3], [0, 0, 0, 1.0]])
    node.transforms["base_link", "camera"] = level
    deliver(node, *pair)
    (tf,) = node.published["/tf"]
    assert tf.transforms[0].child_frame_id == "camera_floor"
    expected = jaxdet.Detector(camera, mount=jaxdet.Mount(0.3))(images[0].depth)
    assert tf.transforms[0].transform.translation.y == pytest.approx(
        expected.floor.height_m * np.cos(expected.floor.pitch_rad), abs=1e-3
    )
    node.transforms["base_link", "camera"] = np.diag([1.0, -1.0, -1.0, 1.0])
    deliver(node, *pair)
    warning = node.warnings[-1]
    assert "base_frame base_link: camera height must be above 0 and below 20 m, got 0 m" in warning
    assert "base_frame must have z = 0 on the floor" in warning


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"config": "wheeld"}, "unknown preset 'wheeld'"),
        ({"config": "paper"}, "config: this method needs colour images"),
        ({"depth_unit_m": 1}, "depth_unit_m: the depth unit must be from 1e-05 to 0.1 m, got 1 m"),
        ({"depth_unit_m": "mm"}, "depth_unit_m: expected"),
        (
            {"camera_height_m": 30},
            "camera_height_m: camera height must be above 0 and below 20 m, got 30",
        ),
        ({"camera_height_m": 0.3, "camera_roll_rad": 9}, "camera_roll_rad: expected radians from"),
        ({"camera_pitch_rad": 0.1}, "camera_height_m: is required with an angle"),
        ({"camera_height_m": 0.3, "base_frame": "base"}, "camera_height_m: contradicts base_frame"),
    ],
)
def test_wrong_parameters_are_errors_of_one_line(parameters, problem, monkeypatch, capsys):
    install(monkeypatch, **parameters)
    assert main(["--ros-args"]) == 2
    error = capsys.readouterr().err
    assert problem in error and error.startswith("jaxdet: ") and error.count("\n") == 1


def test_node_runs_until_it_is_interrupted(frames, monkeypatch, capsys):
    camera, images = frames
    left = list(images[:2])

    def spin(node: Node) -> bool:
        if not left:
            raise KeyboardInterrupt
        frame = left.pop()
        image = image_message(frame.stamp_ns, "camera", frame.depth)
        deliver(node, image, info_message(frame.stamp_ns, camera))
        return True

    install(monkeypatch, spin, camera_height_m=1)  # an integer, as from YAML
    assert main(["--ros-args", "-r", "depth:=/d"]) == 0
    assert capsys.readouterr().err == "2 depth images, 2 with published obstacles\n"


def test_the_node_ends_when_ros_shuts_down(monkeypatch, capsys):
    install(monkeypatch, lambda node: False)
    assert main([]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("package", ["rclpy", "vision_msgs"])
def test_without_ros_the_error_names_the_remedy(package, monkeypatch, capsys):
    install(monkeypatch)
    for name in (package, f"{package}.msg"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main([]) == 2
    error = capsys.readouterr().err
    assert f"{package} can't be imported" in error and error.count("\n") == 1
    assert "source /opt/ros/<distro>/setup.bash" in error
    assert ("install ros-<distro>-vision-msgs" in error) == (package == "vision_msgs")


def test_launch_file_sets_every_parameter(capsys):
    assert main(["--launch-file"]) == 0
    assert capsys.readouterr().out == f"{LAUNCH_FILE}\n"
    launch = ET.parse(LAUNCH_FILE).getroot()
    arguments = {arg.attrib["name"]: arg.attrib["default"] for arg in launch.findall("arg")}
    (node,) = launch.findall("node")
    assert importlib.import_module(node.attrib["args"].removeprefix("-m ") + ".__main__")
    used = {"$(var python)": node.attrib["exec"]}
    used |= {
        f"$(var {remap.attrib['from']})": remap.attrib["to"] for remap in node.findall("remap")
    }
    assert {"$(var depth)", "$(var camera_info)"} < used.keys()
    params = node.findall("param")
    types = {param.attrib["name"]: param.attrib["type"] for param in params}
    used |= {f"$(var {param.attrib['name']})": param.attrib["value"] for param in params}
    assert all(name == value for name, value in used.items())
    assert used.keys() == {f"$(var {name})" for name in arguments}
    assert types == {name: type(default).__name__ for name, (default, _) in PARAMETERS.items()}
    for name, (default, _) in PARAMETERS.items():
        text = str(default).lower() if isinstance(default, bool) else str(default)
        assert arguments[name] == text


def test_the_page_lists_every_parameter():
    page = (Path(jaxdet.__file__).parent / "help/recipes.md").read_text(encoding="utf-8")
    table = page.partition("| parameter | default |")[2].partition("\n\n")[0]
    cells = [line.split("|")[1] for line in table.splitlines()[2:]]
    named = [name for cell in cells for name in re.findall(r"`(\w+)`", cell)]
    assert sorted(named) == sorted(PARAMETERS)
