"""Logs with properties of real recordings: each is read as the log it was made from."""

import copy
import json
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from jaxdet.cli.main import main
from jaxdet.errors import CalibrationError, InputError, TopicError
from jaxdet.io import Log, LogOptions, files, find_logs, open_log
from jaxdet.io.body_frames import T_BODY_OPTICAL
from jaxdet.io.motion import inverse
from jaxdet.io.namespaces import namespaces_of_camera
from jaxdet.sim import SimConfig, write_log
from tests.io_both_ways import is_indexed
from tests.rewritten import (
    Change,
    Message,
    changed,
    moved_camera,
    read_messages,
    write_messages,
)

ALIGNED = "/camera/camera/aligned_depth_to_color/image_raw"
COLOR = "/camera/camera/color/image_raw"
RAW_DEPTH = "/camera/camera/depth/image_rect_raw"
IMAGE, INFO, TF = "sensor_msgs/Image", "sensor_msgs/CameraInfo", "tf2_msgs/TFMessage"
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def aligned(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    """Return messages of a simulated log with aligned depth."""
    path = tmp_path_factory.mktemp("sim") / "sim.mcap"
    write_log(path, SimConfig(frames=6, width=160, height=120, depth_form="aligned"))
    return read_messages(path)


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    """Return messages of a simulated log with a separate depth camera that has a pose in TF."""
    path = tmp_path_factory.mktemp("sim") / "raw.mcap"
    config = SimConfig(frames=6, width=160, height=120, depth_form="raw", extrinsics="tf")
    write_log(path, config)
    return read_messages(path)


def opened(folder: Path, messages: Iterable[Message], **options: Any) -> Log:
    return open_log(
        str(write_messages(folder / f"{len(list(folder.iterdir()))}.mcap", messages)),
        LogOptions(**options),
    )


def depths(log: Log) -> np.ndarray:
    return log.read(range(log.num_frames)).frames.depth


def same(found: np.ndarray | None, expected: np.ndarray | None, atol: float = 1e-9) -> None:
    assert found is not None and expected is not None
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def moved_by(number: int) -> Change:
    """Return a change that moves the odometry of a robot, to make another robot of it."""

    def change(message: Message) -> None:
        if message.topic == "/tf":
            for item in message.body["transforms"]:
                item["transform"]["translation"]["x"] += 20 * number
        elif message.topic == "/odom":
            message.body["pose"]["pose"]["position"]["x"] += 20 * number

    return change


def under(namespace: str, keep: tuple[str, ...] = ()) -> Change:
    def change(message: Message) -> None:
        if message.topic not in keep:
            message.topic = namespace + message.topic

    return change


@pytest.mark.parametrize(
    ("spaces", "camera", "images", "own", "others"),
    [
        (["", "a", "b"], "/a/camera/depth", ["/a/camera/depth"], ("a", ""), ()),
        (["a", "b"], "/camera/depth", ["/camera/depth"], (), ("a", "b")),
        (["a"], "/b/camera/depth", ["/a/camera/depth", "/b/camera/depth"], (), ()),
        (["f/a", "f/b", "f"], "/f/a/camera/depth", [], ("f/a", "f"), ()),
        (["f/a/localization", "f/b/localization"], "/f/a/x/depth", [], ("f/a/localization",), ()),
        (["a", "a/localization", "b"], "/a/depth/image", [], ("a", "a/localization"), ()),
        ([""], "/camera/depth", [], ("",), ()),
    ],
)
def test_transforms_come_from_the_namespace_of_the_camera(spaces, camera, images, own, others):
    assert namespaces_of_camera(spaces, camera, images) == (own, others)


@pytest.mark.parametrize(
    ("first", "second", "keep"),
    [
        ("/robot1", "/robot2", ()),
        ("/fleet/a", "/fleet/b", ()),
        ("/a", "/b", ("/tf_static",)),
        ("", "/other", ()),
    ],
)
def test_each_robot_has_its_own_transforms(tmp_path, aligned, first, second, keep):
    both = changed(aligned, under(first, keep)) + changed(aligned, moved_by(1), under(second, keep))
    names = [name.strip("/") or "camera" for name in (first, second)]
    with opened(tmp_path, aligned) as alone:
        for number, name in enumerate(names):
            with opened(tmp_path, both, camera=name) as log:
                expected = alone.T_world_camera
                assert expected is not None
                expected = expected + 20 * number * np.eye(4)[0, :, None] * np.eye(4)[3]
                same(log.T_world_camera, expected)
                same(log.T_base_camera, alone.T_base_camera)
                assert not (first and log.description.warnings)


@pytest.mark.parametrize("prefix", ["/robot1", "/fleet/robot1"])
def test_odometry_comes_from_the_robot_of_the_camera(tmp_path, aligned, prefix):
    def without_moving(message: Message) -> list[Message] | None:
        return [] if message.topic == "/tf" else None

    def without_odometry(message: Message) -> list[Message] | None:
        return [] if message.topic in ("/tf", "/odom") else None

    def only_odometry(message: Message) -> list[Message] | None:
        return None if message.topic == "/odom" else []

    one = changed(aligned, without_moving)
    first, second = under(prefix), under("/robot2")
    both = changed(one, first) + changed(one, moved_by(1), second)
    both += changed(one, moved_by(2), only_odometry)  # outside of both namespaces
    with opened(tmp_path, one) as alone, opened(tmp_path, both, camera=prefix.strip("/")) as log:
        same(log.T_world_camera, alone.T_world_camera)
    lacking = changed(changed(aligned, without_odometry), first) + changed(one, second)
    with opened(tmp_path, lacking, camera=prefix.strip("/")) as log:
        assert not log.has_poses


@pytest.mark.parametrize("other", ["/tf_wheel", "/a_tf", "/tf_ekf/tf"])
@pytest.mark.parametrize("ahead_m", [0.0, 1.0])
def test_a_moving_frame_on_two_topics_is_used_from_the_one_of_the_robot(
    tmp_path, aligned, other, ahead_m
):
    """The other topic has its messages shortly before or after those of ``/tf``."""

    def elsewhere(message: Message) -> list[Message] | None:
        if message.topic != "/tf":
            return []
        message.topic = other
        message.log_ns += -5_000_000 if other == "/a_tf" and ahead_m else 5_000_000
        message.delay(5_000_000 if ahead_m else 0)
        message.body["transforms"][0]["transform"]["translation"]["x"] += ahead_m
        return None

    with (
        opened(tmp_path, aligned) as whole,
        opened(tmp_path, aligned + changed(aligned, elsewhere)) as log,
    ):
        same(log.T_world_camera, whole.T_world_camera)
        texts = [text for text in log.description.warnings if other in text and "/tf" in text]
        assert bool(texts) == (ahead_m > 0 and "/" not in other[1:])


def test_a_tf_frame_with_parents_on_two_topics_is_an_error_that_names_both(tmp_path, aligned):
    def elsewhere(message: Message) -> list[Message] | None:
        if message.topic != "/tf_static":
            return []
        message.topic = "/camera/tf_static"
        message.body["transforms"][0]["transform"]["translation"]["z"] += 1
        return None

    with opened(tmp_path, aligned + changed(aligned, elsewhere)) as log:
        [text] = [text for text in log.description.warnings if "/tf_static" in text]
    assert "is on /camera/tf_static and on /tf_static" in text


@pytest.mark.parametrize("frame", ["base_footprint", "base_link", "camera_link"])
def test_the_world_may_be_any_frame_of_the_tf_tree(tmp_path, aligned, frame):
    with opened(tmp_path, aligned, world_frame=frame) as log:
        assert log.world_frame == frame and log.T_world_camera is not None
        assert np.ptp(log.T_world_camera, axis=0).max() < 1e-12
        base = log.T_world_camera[0]
        with opened(tmp_path, aligned, base_frame=frame) as other:
            same(other.T_base_camera, base)


@pytest.mark.parametrize("common", ["map", "odom_all"])
def test_robots_in_the_same_tree_have_their_own_base_and_world(tmp_path, aligned, common):
    def prefixed(name: str) -> Change:
        def change(message: Message) -> None:
            rename(message.body, name)
            if message.topic == "/tf_static":
                item = copy.deepcopy(message.body["transforms"][0])
                item["header"]["frame_id"], item["child_frame_id"] = common, f"{name}/odom"
                message.body["transforms"].append(item)
            elif message.topic != "/tf":
                message.topic = f"/{name}{message.topic}"

        return change

    def rename(body: Any, name: str) -> None:
        for key, value in body.items() if isinstance(body, dict) else enumerate(body):
            if key in ("frame_id", "child_frame_id"):
                body[key] = f"{name}/{value}"
            elif isinstance(value, dict | list):
                rename(value, name)

    both = changed(aligned, prefixed("a")) + changed(aligned, moved_by(1), prefixed("b"))
    with opened(tmp_path, both, camera="b") as log:
        assert log.base_frame == "b/base_footprint"
        assert log.world_frame == (common if common == "map" else "b/odom")


def test_the_world_may_be_the_frame_of_the_odometry(tmp_path, aligned):
    def without_moving(message: Message) -> list[Message] | None:
        return [] if message.topic == "/tf" else None

    one = changed(aligned, without_moving)
    with opened(tmp_path, aligned) as alone, opened(tmp_path, one, world_frame="/odom") as log:
        assert log.world_frame == "odom"
        same(log.T_world_camera, alone.T_world_camera)
    with pytest.raises(CalibrationError, match="one of: base_footprint, base_link"):
        opened(tmp_path, one, world_frame="map")


def test_the_world_is_not_taken_from_unrelated_poses(tmp_path, aligned):
    with pytest.raises(CalibrationError, match=r"--log\.world-frame"):
        opened(tmp_path, aligned, world_frame="nowhere")
    with pytest.raises(TopicError, match=r"either --log\.odom or"):
        opened(tmp_path, aligned, world_frame="base_link", odom="/odom")


def binned(x: int, y: int = 0) -> Change:
    """Return a change that combines ``x`` columns and ``y`` rows of pixels, equal by default."""

    def change(message: Message) -> None:
        if message.kind == IMAGE:
            message.show(message.pixels[:: y or x, ::x])
        elif message.kind == INFO:
            message.body |= {"binning_x": x, "binning_y": y or x}

    return change


def cropped(x: int, y: int, width: int, height: int) -> Change:
    def change(message: Message) -> None:
        if message.kind == IMAGE:
            message.show(message.pixels[y : y + height, x : x + width])
        elif message.kind == INFO:
            roi = {"x_offset": x, "y_offset": y, "width": width, "height": height}
            message.body["roi"] = {**roi, "do_rectify": False}

    return change


@pytest.mark.parametrize("which", ["aligned", "raw"])
@pytest.mark.parametrize(
    ("changes", "shift", "factor"),
    [
        ([binned(2)], (0, 0), 2),
        ([binned(7)], (0, 0), 7),  # the size is not a multiple of 7
        ([binned(4)], (0, 0), 4),
        ([cropped(32, 40, 100, 60)], (32, 40), 1),
        ([cropped(0, 0, 90, 120)], (0, 0), 1),
        ([cropped(70, 0, 90, 80)], (70, 0), 1),
        ([cropped(8, 16, 96, 64), binned(2)], (8, 16), 2),
        ([cropped(0, 30, 100, 90), binned(2, 3)], (0, 30), (2, 3)),
        ([binned(1, 2)], (0, 0), (1, 2)),
    ],
)
def test_binning_and_regions_of_interest_are_applied(
    tmp_path, request, which, changes, shift, factor
):
    messages = request.getfixturevalue(which)
    with (
        opened(tmp_path, messages) as whole,
        opened(tmp_path, changed(messages, *changes)) as log,
    ):
        pairs = [(log.calibration.depth, whole.calibration.depth)]
        if which == "raw":
            pairs.append((log.calibration.color, whole.calibration.color))
        for found, full in pairs:
            x, y = shift
            expected = full.fx, full.fy, full.cx - x, full.cy - y
            np.testing.assert_allclose(found[2:6], np.array(expected) / np.resize(factor, 4))
            assert found.coefficients == full.coefficients
        assert log.has_color and not log.description.warnings


@pytest.mark.parametrize("region", [(0, 0, 0, 0), (5, 5, 160, 120)])
def test_the_error_for_images_that_fit_no_region_names_all_sizes(tmp_path, aligned, region):
    """Images of the size of the region contradict the binning."""

    def other(message: Message) -> None:
        if message.kind == INFO:
            names = "x_offset", "y_offset", "width", "height"
            roi = {**dict(zip(names, region, strict=True)), "do_rectify": False}
            size = {"width": 640, "height": 480, "binning_x": 3, "binning_y": 3}
            message.body |= {**size, "roi": roi}

    with pytest.raises(CalibrationError, match=r"640x480 \(region of interest: .*binning 3x3"):
        opened(tmp_path, changed(aligned, other))


def resized(factor: float) -> Change:
    """Return a change that resizes aligned depth and its calibration."""

    def change(message: Message) -> None:
        if "aligned" not in message.topic:
            return
        if message.kind == IMAGE:
            size = round(160 * factor), round(120 * factor)
            message.show(cv2.resize(message.pixels, size, interpolation=cv2.INTER_NEAREST))
        else:
            k = [value * factor for value in message.body["k"]]
            size = {"width": round(160 * factor), "height": round(120 * factor)}
            message.body |= {**size, "k": [*k[:8], 1.0]}

    return change


def part_of_depth(message: Message) -> None:
    if "aligned" in message.topic:
        cropped(20, 10, 100, 100)(message)


def renamed(old: str, new: str) -> Change:
    def change(message: Message) -> None:
        message.topic = message.topic.replace(old, new)

    return change


@pytest.mark.parametrize("change", [resized(0.5), resized(0.25), resized(2), part_of_depth])
@pytest.mark.parametrize("name", ["aligned_depth_to_color", "depth"])
@pytest.mark.parametrize("given", [None, False])
def test_depth_in_the_frame_of_colour_is_aligned_at_any_size(
    tmp_path, aligned, change, name, given
):
    messages = changed(aligned, change, renamed("aligned_depth_to_color", name))
    with opened(tmp_path, messages, depth_aligned=given) as log:
        motion = log.calibration.color_from_depth
        assert motion is not None and log.has_color
        same(motion.T, np.eye(4))
        assert not log.description.warnings


def as_disparity(topic: str, encoding: str = "32FC1") -> Change:
    def change(message: Message) -> None:
        if message.topic == ALIGNED:
            depth = message.pixels.astype(np.float32) / 1000
            shift = np.where(depth > 0, 15.4 / np.maximum(depth, 0.001), -1)
            shift = shift.astype(np.float32) if encoding == "32FC1" else shift.astype(np.uint16)
            message.show(shift, encoding)
            message.topic = topic
        elif message.topic.startswith("/camera/camera/aligned"):
            message.topic = topic.rpartition("/")[0] + "/camera_info"

    return change


@pytest.mark.parametrize(
    ("topic", "encoding"),
    [
        ("/stereo/disparity/image_raw", "32FC1"),
        ("/depth_camera/disparity_image", "16UC1"),
        ("/zed/zed_node/disparity/disparityImage", "32FC1"),
        ("/oak/stereo/disp", "16UC1"),
    ],
)
def test_disparity_is_not_read_as_depth(tmp_path, aligned, topic, encoding):
    messages = changed(aligned, as_disparity(topic, encoding))
    for options in ({}, {"depth": topic}):
        with pytest.raises(TopicError, match=f"{topic}: .*disparity in pixels"):
            opened(tmp_path, messages, **options)
    with opened(tmp_path, aligned + messages) as log:
        assert "aligned" in log.description.choices[0]


@pytest.mark.parametrize(("focal", "baseline"), [(0.0, 0.05), (200.0, 0.0), (float("nan"), 0.05)])
def test_disparity_without_focal_length_or_baseline_is_refused(tmp_path, aligned, focal, baseline):
    def change(message: Message) -> list[Message] | None:
        if message.topic != ALIGNED:
            return None
        message.show(np.full(message.pixels.shape, 9, np.float32), "32FC1")
        body = {"header": message.body["header"], "image": message.body, "f": focal, "t": baseline}
        window = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        body |= {"valid_window": window, "min_disparity": 0.0, "max_disparity": 99.0}
        kind = "stereo_msgs/DisparityImage"
        return [Message("/stereo/disparity", kind, {**body, "delta_d": 0.1}, message.log_ns)]

    with pytest.raises(TopicError, match=r"has focal length .* and baseline .* can't be computed"):
        opened(tmp_path, changed(aligned, change))


@pytest.mark.parametrize(("baseline", "least"), [(0.05, 0.0), (-0.12, 6.0), (0.05, float("nan"))])
def test_disparity_with_focal_length_and_baseline_is_converted(tmp_path, aligned, baseline, least):
    with opened(tmp_path, aligned) as whole:
        expected, focal = depths(whole).astype(int), whole.calibration.depth.fx

    def change(message: Message) -> list[Message] | None:
        if message.topic != ALIGNED:
            return None
        depth = message.pixels.astype(np.float32) / 1000
        with np.errstate(divide="ignore"):
            shift = np.where(depth > 0, focal * abs(baseline) / depth, -1)
        message.show(shift.astype(np.float32), "32FC1")
        body = {"header": message.body["header"], "image": message.body, "f": focal, "t": baseline}
        window = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        body |= {"valid_window": window, "min_disparity": least, "max_disparity": 500.0}
        kind = "stereo_msgs/DisparityImage"
        topic = "/camera/camera/aligned_depth_to_color/disparity"
        return [Message(topic, kind, {**body, "delta_d": 0.1}, message.log_ns)]

    with opened(tmp_path, changed(aligned, change)) as log:
        found = depths(log).astype(int)
        far = expected > 1000 * focal * abs(baseline) / least if least > 0 else expected < 0
        assert np.abs(found - expected)[~far].max() <= 1 and not found[far].any()


def in_floats(factor: float) -> Change:
    def change(message: Message) -> None:
        if message.topic == ALIGNED:
            message.show((message.pixels * np.float32(factor)).astype(np.float32), "32FC1")

    return change


def compressed_floats(factor: float) -> Change:
    """Return a change to compressedDepth with inverse depths A / (q - B) in a PNG."""

    def change(message: Message) -> list[Message] | None:
        if message.topic != ALIGNED:
            return None
        depth = message.pixels * factor
        a = 100.0 * 100 * factor * 1000
        with np.errstate(divide="ignore"):
            codes = np.where(depth > 0, np.round(a / depth), 0)
        codes = np.where(codes < 65536, codes, 0).astype(np.uint16)
        data = struct.pack("<iff", 0, a, 0.0) + cv2.imencode(".png", codes)[1].tobytes()
        body = {"header": message.body["header"], "format": "32FC1; compressedDepth png"}
        topic = f"{ALIGNED}/compressedDepth"
        kind = "sensor_msgs/CompressedImage"
        return [Message(topic, kind, {**body, "data": data}, message.log_ns)]

    return change


@pytest.mark.parametrize("make", [in_floats, compressed_floats])
def test_float_depth_in_millimetres_is_an_error_that_names_the_flag(tmp_path, aligned, make):
    slack = 0 if make is in_floats else 40
    with opened(tmp_path, aligned) as whole:
        expected = depths(whole).astype(int)
    with opened(tmp_path, changed(aligned, make(1.0)), depth_unit_m=0.001) as log:
        assert log.calibration.depth_unit == 0.001 and not log.description.warnings
        assert np.abs(depths(log) - expected).max() <= slack
    with opened(tmp_path, changed(aligned, make(0.001))) as log:
        assert np.abs(depths(log) - expected).max() <= slack and not log.description.warnings
    with opened(tmp_path, changed(aligned, make(1.0))) as log:
        [text] = log.description.warnings
        assert "looks like millimetres; pass --log.depth-unit-m 0.001" in text
    with opened(tmp_path, changed(aligned, make(0.001)), depth_unit_m=0.001) as log:
        assert "looks like metres; omit --log.depth-unit-m" in log.description.warnings[0]


@pytest.mark.parametrize("make", [in_floats, compressed_floats])
def test_float_depth_in_centimetres_names_its_flag(tmp_path, aligned, make):
    with opened(tmp_path, aligned) as whole:
        expected = depths(whole).astype(int)
    with opened(tmp_path, changed(aligned, make(0.1))) as log:
        [text] = log.description.warnings
    assert "looks like centimetres; pass --log.depth-unit-m 0.01" in text
    with opened(tmp_path, changed(aligned, make(0.1)), depth_unit_m=0.01) as log:
        assert np.abs(depths(log) - expected).max() <= 40 and not log.description.warnings


@pytest.mark.parametrize("form", ["16UC1", "16UC1; compressedDepth png"])
def test_tenths_of_a_millimetre_are_noticed(tmp_path, aligned, form):
    def change(message: Message) -> list[Message] | None:
        if message.topic != ALIGNED:
            return None
        pixels = np.minimum(10 * message.pixels.astype(int), 65535).astype(np.uint16)
        if form == "16UC1":
            message.show(pixels, form)
            return None
        data = bytes(12) + cv2.imencode(".png", pixels)[1].tobytes()
        body = {"header": message.body["header"], "format": form, "data": data}
        topic = f"{ALIGNED}/compressedDepth"
        return [Message(topic, "sensor_msgs/CompressedImage", body, message.log_ns)]

    with opened(tmp_path, changed(aligned, change)) as log:
        [text] = log.description.warnings
    assert "tenths of a millimetre; if distances are ten times too large, pass" in text
    with opened(tmp_path, changed(aligned, change), depth_unit_m=0.0001) as log:
        assert log.calibration.depth_unit == 0.0001 and not log.description.warnings


def test_millimetres_are_noticed_in_sparse_depth(tmp_path, aligned):
    def mostly_empty(message: Message) -> None:
        if message.topic == ALIGNED:
            image = message.pixels.copy()
            image[len(image) // 5 :] = 0
            message.show(image)

    with opened(tmp_path, changed(aligned, in_floats(1.0), mostly_empty)) as log:
        [text] = log.description.warnings
    assert "looks like millimetres" in text


def as_png(message: Message) -> list[Message] | None:
    if message.topic != ALIGNED:
        return None
    body = {"header": message.body["header"], "format": "16UC1; png compressed "}
    body["data"] = cv2.imencode(".png", message.pixels)[1].tobytes()
    return [Message(f"{ALIGNED}/compressed", "sensor_msgs/CompressedImage", body, message.log_ns)]


@pytest.mark.parametrize("form", [(), (as_png,)])
def test_the_largest_depth_means_that_nothing_was_measured(tmp_path, aligned, form):
    def saturated(message: Message) -> None:
        if message.topic == ALIGNED:
            message.show(np.where(message.pixels > 0, message.pixels, np.uint16(65535)))

    with (
        opened(tmp_path, aligned) as whole,
        opened(tmp_path, changed(aligned, saturated, *form)) as log,
    ):
        np.testing.assert_array_equal(depths(log), depths(whole))


@pytest.mark.parametrize(
    ("topic", "form"),
    [
        (f"{ALIGNED}/compressed", "16UC1; jpeg compressed "),
        ("/camera/camera/depth/image_rect_raw/compressed", "jpeg"),
        ("/zed/depth/depth_registered/compressed", "32FC1; jpeg compressed "),
        (f"{ALIGNED}/compressedDepth", "16UC1; compressedDepth jpeg"),
    ],
)
def test_depth_as_jpeg_is_refused_with_the_reason(tmp_path, aligned, topic, form):
    def change(message: Message) -> list[Message] | None:
        if message.topic != ALIGNED:
            return None
        grey = np.clip(message.pixels, 0, 255).astype(np.uint8)
        body = {"header": message.body["header"], "format": form}
        body["data"] = cv2.imencode(".jpg", grey)[1].tobytes()
        return [Message(topic, "sensor_msgs/CompressedImage", body, message.log_ns)]

    messages = changed(aligned, change)
    for options in ({}, {"depth": topic}):
        with pytest.raises(TopicError, match=r"recorded as JPEG .*distances are lost.*png"):
            opened(tmp_path, messages, **options)


def stored(
    source: Path, payload: Callable[[bytes], bytes], schema: tuple[str, bytes] | None
) -> Path:
    """Copy a log with other payloads and, if given, another encoding and text of its schemas."""
    path = source.with_name("stored.mcap")
    with source.open("rb") as file, path.open("wb") as target:
        writer = Writer(target)
        writer.start("ros2", "tests")
        channels: dict[int, int] = {}
        for known, channel, message in make_reader(file).iter_messages():
            assert known is not None
            if channel.id not in channels:
                text = schema or (known.encoding, known.data)
                number = writer.register_schema(known.name, *text)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            at = message.log_time, payload(message.data), message.publish_time
            writer.add_message(channels[channel.id], *at)
        writer.finish()
    return path


@pytest.mark.parametrize("scan", [False, True])
@pytest.mark.parametrize("which", ["aligned", "raw"])
@pytest.mark.parametrize(
    ("payload", "schema"),
    [(zstandard.ZstdCompressor().compress, None), (bytes, ("", b"")), (bytes, ("ros2msg", b""))],
    ids=["compressed", "no_definition", "empty_definition"],
)
def test_messages_as_stored_by_the_recorder_are_read(
    tmp_path, request, which, scan, payload, schema
):
    source = write_messages(tmp_path / "x.mcap", request.getfixturevalue(which))
    packed = stored(source, payload, schema)
    with open_log(str(source)) as whole, open_log(str(packed), LogOptions(scan=scan)) as log:
        np.testing.assert_array_equal(depths(log), depths(whole))
        np.testing.assert_array_equal(log.stamps_ns, whole.stamps_ns)
        same(log.T_world_camera, whole.T_world_camera)
        assert log.calibration == whole.calibration


def in_frame(frame: str, *topics: str) -> Change:
    def change(message: Message) -> None:
        if message.kind in (IMAGE, INFO) and message.topic.startswith(topics):
            message.body["header"]["frame_id"] = frame

    return change


def without_frames(word: str) -> Change:
    def change(message: Message) -> None:
        if message.kind == TF:
            every = message.body["transforms"]
            some = [item for item in every if word not in item["child_frame_id"]]
            message.body["transforms"] = some

    return change


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("lower_m", [0.0, 0.1, 0.25])
def test_body_frames_are_converted_to_optical_frames(tmp_path, aligned, named, lower_m):
    """The floor may be below the base frame."""
    body, lower = in_frame("camera_color_frame", "/camera"), moved_camera(lower_m)
    changes: list[Change] = [body, lower] if named else [body, lower, without_frames("optical")]
    with (
        opened(tmp_path, changed(aligned, lower)) as whole,
        opened(tmp_path, changed(aligned, *changes)) as log,
    ):
        same(log.T_base_camera, whole.T_base_camera)
        same(log.T_world_camera, whole.T_world_camera)
        assert (log.camera_frame == "camera_color_optical_frame") == named
        [text] = log.description.warnings
        assert "'camera_color_frame'" in text and "--log.camera-frame" in text
        assert is_indexed(log)


def test_a_body_frame_is_recognized_from_poses_in_the_world(tmp_path, raw):
    """TF of a tracked camera has no frame of a robot, so only the world defines the vertical."""
    with opened(tmp_path, raw) as whole:
        expected = whole.T_world_camera
    assert expected is not None
    poses = iter(expected @ inverse(T_BODY_OPTICAL))

    def tracked(message: Message) -> list[Message] | None:
        if message.kind == TF or message.topic == "/odom" or "color" in message.topic:
            return []
        return None

    changes = tracked, in_frame("tracker", "/camera")
    messages = changed(raw, *changes)
    from jaxdet.io.writer_cdr import pose_of

    for message in [item for item in messages if item.kind == IMAGE]:
        pose = pose_of(next(poses))
        motion = {"translation": pose["position"], "rotation": pose["orientation"]}
        header = {**message.body["header"], "frame_id": "map"}
        item = {"header": header, "child_frame_id": "tracker", "transform": motion}
        messages.append(Message("/tf", TF, {"transforms": [item]}, message.log_ns))
    with opened(tmp_path, messages) as log:
        same(log.T_world_camera, expected, 1e-6)
        assert any("body frame" in text for text in log.description.warnings)


@pytest.mark.parametrize(
    "bodies", [{"depth"}, {"color"}, {"depth", "color"}], ids=lambda names: "-".join(sorted(names))
)
def test_extrinsics_between_body_frames_are_converted(tmp_path, raw, bodies):
    changes = [in_frame(f"camera_{name}_frame", f"/camera/camera/{name}") for name in bodies]
    with opened(tmp_path, raw) as whole, opened(tmp_path, changed(raw, *changes)) as log:
        one, other = log.calibration.color_from_depth, whole.calibration.color_from_depth
        assert one is not None and other is not None
        same(one.T, other.T)
        same(log.T_base_camera, whole.T_base_camera)
        same(log.T_world_camera, whole.T_world_camera)
        texts = [text for text in log.description.warnings if "body frame" in text]
        assert len(texts) == len(bodies)


def test_a_camera_that_looks_up_is_not_in_a_body_frame(tmp_path, aligned):
    """No points lie on the floor for either interpretation of the frame."""

    def walls(message: Message) -> None:
        if message.topic == ALIGNED:
            message.show(np.full(message.pixels.shape, 900, np.uint16))

    changes = in_frame("camera_color_frame", "/camera"), without_frames("optical"), walls
    with opened(tmp_path, changed(aligned, *changes)) as log:
        assert log.camera_frame == "camera_color_frame"


def late(seconds: float, *topics: str) -> Change:
    def change(message: Message) -> None:
        if message.topic.startswith(topics):
            message.delay(round(seconds * SECOND))

    return change


@pytest.mark.parametrize("seconds", [3.7, -2.0, 86_400.0])
@pytest.mark.parametrize(
    "topics", [("/tf", "/odom"), ("/camera/camera/aligned",), ("/camera/camera/color",)]
)
def test_offsets_of_clocks_are_estimated_from_log_times(tmp_path, aligned, topics, seconds):
    with (
        opened(tmp_path, aligned) as whole,
        opened(tmp_path, changed(aligned, late(seconds, *topics))) as log,
    ):
        same(log.T_world_camera, whole.T_world_camera)
        shift = round(seconds * SECOND) * (topics[0].endswith("color"))
        np.testing.assert_array_equal(log.color_stamps_ns, whole.color_stamps_ns + shift)
        texts = [*log.description.warnings, *log.description.notes]
        flags = ["color" for name in topics if "camera" in name]
        flags += ["pose" for name in topics if "color" not in name]
        for flag in ("color", "pose"):
            assert any(f"--log.{flag}-offset-s 0" in text for text in texts) == (flag in flags)


def first_stamps(count: int, at_s: int, kinds: tuple[str, ...] = (ALIGNED, COLOR)) -> Callable:
    left = dict.fromkeys(kinds, count)

    def change(message: Message) -> None:
        if left.get(message.topic, 0):
            number = count - left[message.topic]
            left[message.topic] -= 1
            message.body["header"]["stamp"] = {"sec": at_s, "nanosec": number * 33_000_000}

    return change


@pytest.mark.parametrize("scan", [False, True])
@pytest.mark.parametrize(
    "change", [(1, 5), (2, 5), (2, 946_684_800), (1, 5, (ALIGNED,))], ids=lambda args: str(args)
)
def test_start_in_seconds_ignores_timestamps_of_an_unset_clock(tmp_path, aligned, change, scan):
    start = {"start": "0.08s", "scan": scan}
    with (
        opened(tmp_path, aligned, **start) as whole,
        opened(tmp_path, changed(aligned, first_stamps(*change)), **start) as log,
    ):
        assert log.frames == whole.frames and 0 < len(log.frames) < 6
        which = "1 is" if change[0] == 1 else f"{change[0]} are"
        text = f"of 6 timestamps, {which} years before the others"
        assert any(text in item for item in log.description.warnings)
        assert log.description.duration_s == pytest.approx(whole.description.duration_s)


@pytest.mark.parametrize("scan", [False, True])
@pytest.mark.parametrize("topics", [("/camera",), ("/tf", "/odom"), ("/camera", "/tf", "/odom")])
def test_a_clock_set_during_the_log_has_no_offset(tmp_path, aligned, topics, scan):
    """A part of the timestamps is of 1970, before the clock was set."""
    middle = sorted(item.log_ns for item in aligned if item.topic == ALIGNED)[2]

    def change(message: Message) -> None:
        if message.topic.startswith(topics) and message.log_ns < middle:
            message.delay(-1_699_999_000 * SECOND)

    with (
        opened(tmp_path, aligned) as whole,
        opened(tmp_path, changed(aligned, change), scan=scan) as log,
    ):
        same(log.T_world_camera, whole.T_world_camera)
        assert not any("offset" in text for text in log.description.warnings)


@pytest.mark.parametrize("late_ns", [0, 7_000_000, 60 * SECOND])
@pytest.mark.parametrize("part", [1.0, 0.5])
def test_duplicates_in_a_merged_recording_count_once(tmp_path, aligned, late_ns, part):
    again = changed(aligned)[: round(len(aligned) * part)]
    for message in again:
        message.log_ns += late_ns
    with opened(tmp_path, aligned) as whole, opened(tmp_path, aligned + again) as log:
        assert log.num_frames == whole.num_frames
        np.testing.assert_array_equal(depths(log), depths(whole))
        same(log.T_world_camera, whole.T_world_camera)
        assert any(
            "occur twice (same timestamp and content)" in t for t in log.description.warnings
        )


@pytest.mark.parametrize("late_ns", [3_000, 1_000_000])
def test_duplicates_that_begin_late_in_a_recording_count_once(tmp_path, aligned, late_ns):
    """The first images occur once, and no two log times are equal."""
    many = changed(aligned)
    for number in range(1, 4):
        some = changed(aligned)
        for message in some:
            message.log_ns += number * SECOND
            message.delay(number * SECOND)
        many += some
    again = [item for item in changed(many) if item.log_ns > many[0].log_ns + 2 * SECOND]
    for message in again:
        message.log_ns += late_ns
    source = write_messages(tmp_path / "merged.mcap", many + again)
    with opened(tmp_path, many) as whole:
        expected = depths(whole)
    assert main(["run", str(source), "-o", str(tmp_path / "out"), "--pictures", "0", "-q"]) == 0
    frames = json.loads((tmp_path / "out" / "merged" / "summary.json").read_text())["frames"]
    assert frames == len(expected) == 24


@pytest.mark.parametrize("seconds", [3, -3])
def test_poses_that_another_recorder_recorded_have_no_offset(tmp_path, aligned, seconds):
    """Only the log times of the poses are from another clock."""

    def change(message: Message) -> None:
        if message.topic in ("/tf", "/odom"):
            message.log_ns += seconds * SECOND

    with opened(tmp_path, aligned) as whole, opened(tmp_path, changed(aligned, change)) as log:
        same(log.T_world_camera, whole.T_world_camera)


@pytest.mark.parametrize("topics", [("/tf", "/odom"), ("/camera/camera/aligned",)])
@pytest.mark.parametrize("later_s", [0.7, 2.0])
def test_offsets_of_clocks_are_estimated_in_a_merged_recording(tmp_path, aligned, topics, later_s):
    wrong = changed(aligned, late(1000, *topics))
    again = changed(wrong)
    for message in again:
        message.log_ns += round(later_s * SECOND)
    with opened(tmp_path, aligned) as whole, opened(tmp_path, wrong + again) as log:
        assert log.num_frames == whole.num_frames
        same(log.T_world_camera, whole.T_world_camera)


def test_different_images_with_equal_timestamps_both_count(tmp_path, aligned):
    def other(message: Message) -> list[Message] | None:
        if message.topic != ALIGNED:
            return []
        message.show(message.pixels + np.uint16(1))
        return None

    with opened(tmp_path, aligned + changed(aligned, other)) as log:
        assert log.num_frames == 12


@pytest.mark.parametrize("without", [ALIGNED, "/camera/camera/aligned_depth_to_color/camera_info"])
def test_info_lists_the_topics_of_a_log_without_a_camera(tmp_path, aligned, without, capsys):
    some = [item for item in aligned if item.topic != without and not item.topic.endswith("info")]
    path = write_messages(tmp_path / "x.mcap", some)
    assert main(["info", str(path)]) == 1
    shown, error = capsys.readouterr()
    assert shown.startswith("x: not usable\ntopics\n") and "/odom" in shown
    assert "error" in error and ("no topic with depth images" in error or "no calibration" in error)
    assert main(["info", str(path), "--json"]) == 1
    [log] = json.loads(capsys.readouterr().out)["logs"]
    assert {item["topic"] for item in log["topics"]} == {item.topic for item in some}


def test_a_link_to_a_parent_folder_is_followed_once(tmp_path, aligned):
    folder = tmp_path / "logs"
    (folder / "deep").mkdir(parents=True)
    write_messages(folder / "x.mcap", aligned)
    (folder / "deep" / "all").symlink_to("/", target_is_directory=True)
    (folder / "here").symlink_to(folder, target_is_directory=True)
    [log] = find_logs([folder])
    assert log.name == "x" and "deep/all is left out: a link to a parent folder" in log.note


def test_a_tree_of_too_many_folders_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_FOLDERS", 20)
    for number in range(30):
        (tmp_path / f"{number}").mkdir()
    with pytest.raises(InputError, match="more than 20 subfolders; pass a smaller folder"):
        find_logs([tmp_path])
