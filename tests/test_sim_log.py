"""Simulated logs on disk, read by other libraries, and their ground truth."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from jaxdet.errors import InputError
from jaxdet.io import open_log
from jaxdet.io.writer import Transform
from jaxdet.io.writer_cdr import encode_cdr, quaternion
from jaxdet.sim import (
    SimConfig,
    load_depths,
    load_obstacle_ids,
    load_scene,
    load_truth,
    simulate,
    write_log,
)
from jaxdet.sim.config import calibration_of
from jaxdet.sim.record import static_transforms
from jaxdet.sim.robot import mount, pose_at
from jaxdet.sim.truth import truth_path

CONFIG = SimConfig(scene="row", frames=4, width=96, height=72, rate_hz=10, seed=3)
COLOR, DEPTH = "/camera/camera/color", "/camera/camera/depth"
ALIGNED = "/camera/camera/aligned_depth_to_color"


def read_all(path):
    """Return messages by topic, read by rosbags."""
    topics = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            topics.setdefault(connection.topic, []).append(message)
    return topics


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "row.mcap"
    return path, write_log(path, replace(CONFIG, depth_form="both"))


def pixels(message, dtype):
    return np.asarray(message.data).view(dtype).reshape(message.height, message.width, -1)


def transforms(messages):
    """Return ``T_parent_child`` by (parent, child)."""
    tree = {}
    for item in (t for m in messages for t in m.transforms):
        q, p = item.transform.rotation, item.transform.translation
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        T[:3, 3] = p.x, p.y, p.z
        tree[item.header.frame_id, item.child_frame_id] = T
    return tree


def test_rosbags_reads_the_images(log):
    topics = read_all(log[0])
    for frame in simulate(replace(CONFIG, depth_form="both")):
        color = topics[f"{COLOR}/image_raw"][frame.number]
        assert color.encoding == "rgb8" and color.step == 3 * 96
        stamp = color.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == frame.stamp_ns
        np.testing.assert_array_equal(pixels(color, np.uint8), frame.color)
        depth = topics[f"{DEPTH}/image_rect_raw"][frame.number]
        aligned = topics[f"{ALIGNED}/image_raw"][frame.number]
        np.testing.assert_array_equal(pixels(depth, "<u2")[..., 0], frame.depth)
        np.testing.assert_array_equal(pixels(aligned, "<u2")[..., 0], frame.aligned)
        assert depth.encoding == "16UC1" and aligned.header.frame_id == color.header.frame_id
    info = topics[f"{DEPTH}/camera_info"][0]
    camera = calibration_of(CONFIG).depth
    np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), camera.K)
    assert info.distortion_model == "plumb_bob" and list(info.d) == [0] * 5


def test_mcap_ros2_reads_the_same_messages(log):
    theirs = read_all(log[0])
    ours = {}
    with log[0].open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            ours.setdefault(channel.topic, []).append(message)
    assert {t: len(m) for t, m in ours.items()} == {t: len(m) for t, m in theirs.items()}
    for one, other in zip(ours[f"{COLOR}/image_raw"], theirs[f"{COLOR}/image_raw"], strict=True):
        assert bytes(one.data) == bytes(other.data)
    assert ours["/odom"][1].pose.pose.position.x == theirs["/odom"][1].pose.pose.position.x
    assert list(ours[f"{COLOR}/camera_info"][0].p) == list(theirs[f"{COLOR}/camera_info"][0].p)


def test_tf_has_mount_and_extrinsics(log):
    topics = read_all(log[0])
    tree = transforms(topics["/tf_static"])
    link = tree["base_footprint", "base_link"] @ tree["base_link", "camera_link"]
    color = tree["camera_link", "camera_color_frame"]
    color = color @ tree["camera_color_frame", "camera_color_optical_frame"]
    depth = tree["camera_link", "camera_depth_frame"]
    depth = depth @ tree["camera_depth_frame", "camera_depth_optical_frame"]
    expected = mount(CONFIG.camera_height_m, CONFIG.camera_pitch_rad, CONFIG.camera_roll_rad)
    np.testing.assert_allclose(link @ color, expected, atol=1e-12)
    T_color_depth = calibration_of(CONFIG).color_from_depth.T
    np.testing.assert_allclose(np.linalg.inv(color) @ depth, T_color_depth, atol=1e-12)
    extrinsics = topics["/camera/camera/extrinsics/depth_to_color"][0]
    rotation = np.reshape(extrinsics.rotation, (3, 3)).T
    np.testing.assert_array_equal(rotation, T_color_depth[:3, :3])
    np.testing.assert_array_equal(extrinsics.translation, T_color_depth[:3, 3])


def test_odometry_begins_before_the_frames_and_ends_after_them(log):
    path, truth = log
    topics = read_all(path)
    stamps = np.array(
        [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in topics["/odom"]]
    )
    assert stamps[0] < truth.stamp_ns[0] and stamps[-1] > truth.stamp_ns[-1]
    assert np.ptp(np.diff(stamps)) < 1000 and len(topics["/tf"]) == len(stamps)
    scene = load_scene("row")
    for stamp, message in zip(stamps, topics["/odom"], strict=True):
        pose = pose_at(scene.path, (int(stamp) - CONFIG.start_ns) / 1e9)
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        assert (place.x, place.y) == pytest.approx((pose.x, pose.y), abs=1e-8)
        assert 2 * np.arctan2(turn.z, turn.w) == pytest.approx(pose.yaw, abs=1e-8)
    moving = [m for m in topics["/odom"] if m.twist.twist.linear.x > 0.01]
    assert moving and topics["/odom"][0].child_frame_id == "base_footprint"


def test_ground_truth_is_next_to_the_log(log):
    path, truth = log
    again = load_truth(path)
    for name, one, other in zip(truth._fields, truth, again, strict=True):
        np.testing.assert_array_equal(one, other, err_msg=name)
    frames, objects = 4, 8
    assert truth.is_wall.tolist() == [False] * 4 + [True] * 4
    assert truth.box_world.shape == (frames, objects, 8, 3)
    ids = load_obstacle_ids(path, [0, 1, 2, 3])
    counts = [[(ids[f] == j + 1).sum() for j in range(objects)] for f in range(frames)]
    np.testing.assert_array_equal(truth.visible_pixels, counts)
    depth = load_depths(path, [0, 3])
    assert depth.shape == ids[:2].shape
    nearest = [
        [depth[f][ids[k] == j + 1].min(initial=np.inf) for j in range(4)]
        for f, k in enumerate((0, 3))
    ]
    seen = truth.visible_pixels[[0, 3], :4] > 0
    np.testing.assert_allclose(
        np.array(nearest)[seen], truth.nearest_m[[0, 3], :4][seen], rtol=1e-3
    )
    hidden = truth.visible_pixels == 0
    assert np.isnan(truth.nearest_m[hidden]).all() and (truth.nearest_m[~hidden] > 0).all()
    # The first box's face is 0.125 m before its centre at 1.4 m; the robot starts at 0.
    assert truth.ground_min[0, 0, 1] == pytest.approx(1.275, abs=0.002)
    outline = truth.footprint_world[0, 0]
    outline = outline[~np.isnan(outline[:, 0])]
    np.testing.assert_allclose(outline.mean(0), [1.4, 0.5], atol=1e-6)
    np.testing.assert_allclose(truth.height_m[0, :4], [0.3, 0.38, 0.46, 0.54], atol=1e-6)
    assert not np.isnan(truth.T_world_camera).any() and (truth.camera_height == 0.3).all()


def test_the_log_is_opened_with_aligned_depth(log):
    with open_log(str(log[0])) as opened:
        frames = [batch.frames for batch in opened.batches(4)]
    assert sum(int(f.valid.sum()) for f in frames) == 4
    # Of both forms of depth, the one aligned to the colour camera is used.
    np.testing.assert_allclose(frames[0].T_world_camera[:4], log[1].T_world_camera, atol=1e-3)
    np.testing.assert_array_equal(frames[0].stamp_ns[:4], log[1].depth_stamp_ns)
    np.testing.assert_array_equal(frames[0].color_stamp_ns[:4], log[1].stamp_ns)


def test_ground_truth_is_optional(tmp_path):
    with pytest.raises(InputError, match="cannot read ground truth"):
        load_truth(tmp_path / "real.mcap")


def test_forms_of_depth_and_options_are_written(tmp_path):
    small = replace(CONFIG, frames=1, width=32, height=24)

    def topics(**changes):
        write_log(tmp_path / "x.mcap", replace(small, **changes))
        return read_all(tmp_path / "x.mcap")

    raw, metres = topics(), topics(depth_form="metres", compression="none")
    image = metres[f"{DEPTH}/image_rect_raw"][0]
    assert image.encoding == "32FC1"
    units = np.rint(pixels(image, "<f4") * 1000).astype(np.uint16)
    np.testing.assert_array_equal(units, pixels(raw[f"{DEPTH}/image_rect_raw"][0], "<u2"))
    aligned = topics(depth_form="aligned", odometry_hz=0)
    assert f"{DEPTH}/image_rect_raw" not in aligned and f"{ALIGNED}/camera_info" in aligned
    assert "/odom" not in aligned and "/tf" not in aligned
    bare = topics(mount_tf=False, extrinsics="none", compression="lz4")
    tree = transforms(bare["/tf_static"])
    assert ("base_link", "camera_link") not in tree
    assert ("camera_link", "camera_color_frame") not in tree
    assert not [t for t in bare if "extrinsics" in t]


def test_logs_are_reproducible(tmp_path):
    small = replace(CONFIG, width=64, height=48)
    sums = []
    for name in ("a.mcap", "b.mcap"):
        write_log(tmp_path / name, small)
        files = (tmp_path / name, truth_path(tmp_path / name))
        sums.append([hashlib.sha256(f.read_bytes()).hexdigest() for f in files])
    assert sums[0] == sums[1]
    write_log(tmp_path / "a.mcap", replace(small, frames=0))
    assert load_truth(tmp_path / "a.mcap").visible_pixels.shape == (0, 8)


def test_static_transforms_form_a_tree():
    children = [t.child for t in static_transforms(CONFIG, calibration_of(CONFIG))]
    assert len(set(children)) == len(children)
    assert isinstance(static_transforms(CONFIG, calibration_of(CONFIG))[0], Transform)


def test_quaternions_equal_those_of_scipy():
    for R in Rotation.random(50, random_state=0).as_matrix():
        got = Rotation.from_quat(list(quaternion(R).values())).as_matrix()
        np.testing.assert_allclose(got, R, atol=1e-12)


def test_invalid_messages_are_errors():
    with pytest.raises(KeyError):
        encode_cdr("geometry_msgs/Point", {"x": 0.0})
    with pytest.raises(ValueError, match="rotation: expected 9 values, got 3"):
        bad = {"rotation": (1, 2, 3), "translation": (0, 0, 0)}
        encode_cdr("realsense2_camera_msgs/Extrinsics", bad)
