"""Colour in any encoding, missing, or at a lower rate: each depth image is a frame."""

import struct
import zlib

import cv2
import numpy as np
import pytest
import zstandard

from jaxdet.errors import CalibrationError, FrameStatus, TopicError
from jaxdet.io import LogOptions
from tests.io_both_ways import open_both_ways
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_INFO,
    DEPTH_K,
    DEPTH_SIZE,
    START,
    T_COLOR_DEPTH,
    LogFile,
    assert_holds,
    make_scene,
    ros_compressed,
    ros_image,
    ros_info,
    ros_tf,
    ros_type,
    write_calibration,
    write_images,
)

ALIGNED = "/cam/aligned_depth_to_color/image_raw"
INFRA = "/cam/infra1/image_rect_raw"
BAYER = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "gbrg": (1, 2, 0, 1), "grbg": (1, 0, 2, 1)}


def smooth(seed: int) -> np.ndarray:
    """Return an image whose neighbouring pixels are similar."""
    coarse = np.random.default_rng(seed).integers(40, 200, (3, 4, 3), np.uint8)
    return cv2.resize(coarse, COLOR_SIZE, interpolation=cv2.INTER_CUBIC)


def mosaic(image: np.ndarray, pattern: str) -> np.ndarray:
    result = image[..., 1].copy()
    for place, channel in enumerate(BAYER[pattern]):
        row, column = divmod(place, 2)
        result[row::2, column::2] = image[row::2, column::2, channel]
    return result


def wide(image: np.ndarray) -> np.ndarray:
    """Return the image with 16 bits per sample, of which the lower 8 are noise."""
    return image.astype(np.uint16) * 256 + 99


def semi_planar(image: np.ndarray, v_first: bool) -> np.ndarray:
    """Return NV12 or NV21, made from the I420 of OpenCV."""
    planes = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420).reshape(-1)
    size = COLOR_SIZE[0] * COLOR_SIZE[1]
    u, v = planes[size : size + size // 4], planes[size + size // 4 :]
    chroma = np.stack([v, u] if v_first else [u, v], axis=1).reshape(-1)
    return np.concatenate([planes[:size], chroma]).reshape(-1, COLOR_SIZE[0])


def interleaved(image: np.ndarray, u_first: bool) -> np.ndarray:
    """Return UYVY or YUY2, with the chroma of the left pixel of each pair."""
    planes = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420).reshape(-1)
    y = planes[: COLOR_SIZE[0] * COLOR_SIZE[1]].reshape(COLOR_SIZE[1], COLOR_SIZE[0])
    u, v = (
        plane.reshape(COLOR_SIZE[1] // 2, -1).repeat(2, 0)
        for plane in np.split(planes[y.size :], 2)
    )
    chroma = np.stack([u, v], axis=2).reshape(y.shape)
    return np.stack([chroma, y] if u_first else [y, chroma], axis=2)


def packed(image: np.ndarray, form: str) -> bytes:
    """Compress as the zstd transport did before and after 2026, or without a header."""
    height, width = image.shape[:2]
    head = struct.pack("<IIBII", height, width, 0, 3 * width, 4) + b"rgb8"
    if form == "gzip":
        packer = zlib.compressobj(wbits=31)
        return head + packer.compress(image.tobytes()) + packer.flush()
    body = zstandard.compress(image.tobytes())
    return body if form == "bare" else head + body


CODINGS = {
    **{f"bayer_{name}8": lambda a, n=name: mosaic(a, n) for name in BAYER},
    **{f"bayer_{name}16": lambda a, n=name: wide(mosaic(a, n)) for name in BAYER},
    "nv12": lambda a: semi_planar(a, False),
    "nv21": lambda a: semi_planar(a, True),
    "yuv422_yuy2": lambda a: interleaved(a, False),
    "yuv422": lambda a: interleaved(a, True),
    "rgb16": wide,
    "bgr16": lambda a: wide(a[..., ::-1]),
    "bgra8": lambda a: np.dstack([a[..., ::-1], a[..., 0]]),
    "rgba16": lambda a: wide(np.dstack([a, a[..., 0]])),
    "mono16": lambda a: wide(a[..., 1]),
    "mono8": lambda a: a[..., 1],
}
EXACT = {"rgb16", "bgr16", "bgra8", "rgba16", "mono16", "mono8", "zstd", "gzip", "bare"}


def coded(image: np.ndarray, coding: str, at: int):
    if coding in ("zstd", "gzip", "bare"):
        return ros_compressed(packed(image, coding), "zstd", at, COLOR_FRAME)
    pixels = CODINGS[coding](image)
    message = ros_image(pixels, coding, at, COLOR_FRAME, padding=6, big=coding == "bgr16")
    message.height = COLOR_SIZE[1]
    return message


@pytest.mark.parametrize("aligned", [False, True])
@pytest.mark.parametrize("coding", [*CODINGS, "zstd", "gzip", "bare"])
def test_colour_in_every_encoding_is_read(tmp_path, coding, aligned):
    scene = make_scene(3, size=COLOR_SIZE if aligned else DEPTH_SIZE)
    images = [smooth(seed) for seed in range(3)]
    path = tmp_path / "x.mcap"
    with LogFile(path) as log:
        write_calibration(log, aligned)
        for depth, color, at in zip(scene.depth, images, scene.depth_ns.tolist(), strict=True):
            frame, topic = (COLOR_FRAME, ALIGNED) if aligned else (DEPTH_FRAME, DEPTH)
            log.ros(topic, ros_image(depth, "16UC1", at, frame), at)
            suffix = "/zstd" if coding in ("zstd", "gzip", "bare") else ""
            log.ros(COLOR + suffix, coded(color, coding, at), at)
    with open_both_ways(str(path)) as log:
        assert log.has_color and log.has_color_camera and log.camera == "cam"
        batch = log.read([0, 1, 2], color=True, need_color=True)
        assert batch.status == (FrameStatus.OK,) * 3, batch.errors
        np.testing.assert_array_equal(batch.frames.depth, scene.depth)
        expected = np.stack(images).astype(int)
        if coding.startswith("mono"):
            expected = expected[..., 1:2].repeat(3, 3)
        off = np.abs(batch.frames.color.astype(int) - expected)
        assert off.max() == 0 if coding in EXACT else np.median(off) <= 6 and off.mean() < 9


def write_depth(path, color=lambda i: False, count=8, more=None):
    """Write depth at 30 Hz, with colour for frames whose number satisfies ``color``."""
    scene = make_scene(count)
    with LogFile(path) as log:
        write_calibration(log)
        for i, (image, depth, at, depth_at) in enumerate(zip(*scene, strict=True)):
            if more:
                more(log, i, int(depth_at))
            log.ros(DEPTH, ros_image(depth, "16UC1", int(depth_at), DEPTH_FRAME), int(depth_at))
            if color(i):
                log.ros(COLOR, ros_image(image, "rgb8", int(at), COLOR_FRAME), int(at))
    return str(path), scene


@pytest.mark.parametrize(
    ("kept", "shown"),
    [
        (lambda i: i % 2 == 0, [0, 0, 2, 2, 4, 4, 6, 6]),
        (lambda i: i % 5 == 1, [1, 1, 1, 1, 6, 6, 6, 6]),
        (lambda i: i == 7, [None, None, None, 7, 7, 7, 7, 7]),
    ],
)
def test_dropped_or_slower_colour_loses_no_frames(tmp_path, kept, shown):
    path, scene = write_depth(tmp_path / "x.mcap", kept)
    with open_both_ways(path, LogOptions(pair_tolerance_s=0.14)) as log:
        assert log.num_frames == 8
        np.testing.assert_array_equal(log.stamps_ns, scene.depth_ns)
        stamps = [-1 if i is None else scene.color_ns[i] for i in shown]
        np.testing.assert_array_equal(log.color_stamps_ns, stamps)
        for frame, i in zip(log, shown, strict=True):
            assert frame.status is FrameStatus.OK
            np.testing.assert_array_equal(frame.depth, scene.depth[frame.number])
            if i is None:
                assert frame.color is None and frame.color_stamp_ns == -1
            else:
                np.testing.assert_array_equal(frame.color, scene.color[i])
        about = log.described(log.read(range(8)).notes)
        assert about.pairing.num_with_color == 8 - shown.count(None)
        missing = f"colour missing for {shown.count(None)} of 8 frames"
        assert (missing in " ".join(about.notes)) == (None in shown)
        [batch] = log.batches(8, color=True, need_color=True)
        assert [status == "no_color" for status in batch.status] == [i is None for i in shown]


def test_a_log_of_depth_only_is_read(tmp_path):
    path, scene = write_depth(tmp_path / "x.mcap")
    with open_both_ways(path) as log:
        assert not log.has_color and not log.has_color_camera and log.color_shape is None
        assert log.calibration.color is None and log.calibration.depth[2:6] == DEPTH_K
        assert (log.camera, log.camera_frame, log.color_frame) == ("cam", DEPTH_FRAME, "")
        note = "no colour (no topic with colour images): pictures show depth"
        assert note in log.description.notes and not log.description.warnings
        for batch in log.batches(5, color=True):
            assert batch.frames.color is None and set(batch.status) == {FrameStatus.OK}
            assert (batch.frames.color_stamp_ns == -1).all()
        np.testing.assert_array_equal(log.read(range(8)).frames.depth, scene.depth)


def test_colour_can_be_left_out(tmp_path):
    path, scene = write_depth(tmp_path / "x.mcap", lambda i: True)
    with open_both_ways(path, LogOptions(color="none")) as log:
        assert not log.has_color and "--log.color none" in log.color_problem
        assert log.calibration.color is None
        np.testing.assert_array_equal(log.read(range(8), color=True).frames.depth, scene.depth)


@pytest.mark.parametrize("encoding", ["mono8", "mono16", "16UC1"])
@pytest.mark.parametrize("own_info", [True, False])
def test_infrared_is_shown_if_there_is_no_colour(tmp_path, encoding, own_info):
    grey = make_scene(8, seed=5).depth

    def more(log, i, at):
        frame = "infra1_optical" if own_info else DEPTH_FRAME
        pixels = (grey[i] >> 8).astype(np.uint8) if encoding == "mono8" else grey[i]
        for name in ("infra1", "infra2"):
            topic = f"/cam/{name}/image_rect_raw"
            log.ros(topic, ros_image(pixels, encoding, at, frame), at)
        if own_info and i == 0:
            log.ros("/cam/infra1/camera_info", ros_info(DEPTH_SIZE, DEPTH_K, at, frame), at)

    path, scene = write_depth(tmp_path / "x.mcap", more=more)
    with open_both_ways(path) as log:
        assert log.has_color and not log.has_color_camera and log.camera == "cam"
        assert log.calibration.color is None and log.calibration.is_aligned
        assert any(INFRA in text for text in log.description.notes)
        frames = log.read(range(8), color=True).frames
        np.testing.assert_array_equal(frames.depth, scene.depth)
        np.testing.assert_array_equal(frames.color, (grey >> 8)[..., None].repeat(3, 3))
    path, scene = write_depth(tmp_path / "y.mcap", lambda i: True, more=more)
    with open_both_ways(path) as log:
        assert log.has_color_camera
        assert_holds(log, scene)


def test_infrared_is_not_shown_with_depth_aligned_to_colour(tmp_path):
    scene = make_scene(3, size=COLOR_SIZE)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log, aligned=True)
        log.ros("/cam/infra1/camera_info", ros_info(COLOR_SIZE, DEPTH_K, START, DEPTH_FRAME), START)
        for depth, at in zip(scene.depth, scene.depth_ns.tolist(), strict=True):
            log.ros(ALIGNED, ros_image(depth, "16UC1", at, COLOR_FRAME), at)
            log.ros(INFRA, ros_image(depth.astype("u1"), "mono8", at, DEPTH_FRAME), at)
    with open_both_ways(str(tmp_path / "x.mcap")) as log:
        assert not log.has_color and log.has_color_camera and log.calibration.is_aligned
        assert log.calibration.depth[:6] == (*COLOR_SIZE, *COLOR_K)
        np.testing.assert_array_equal(log.read(range(3), color=True).frames.depth, scene.depth)


@pytest.mark.parametrize(
    ("schema", "reason"),
    [
        ("foxglove.CompressedVideo", "video"),
        ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "video of FFmpeg"),
        ("theora_image_transport/msg/Packet", "video (Theora)"),
    ],
)
def test_colour_as_video_is_reported_in_a_note(tmp_path, schema, reason):
    def more(log, i, at):
        log.json("/cam/color/video", schema, {"data": ""}, at)

    path, scene = write_depth(tmp_path / "x.mcap", more=more)
    with open_both_ways(path) as log:
        assert not log.has_color
        text = f"no colour (unsupported: {reason} of /cam/color/video): pictures show depth"
        assert log.description.notes.count(text) == 1
        np.testing.assert_array_equal(log.read(range(8)).frames.depth, scene.depth)
    with pytest.raises(TopicError, match="/cam/color/video"):
        open_both_ways(path, LogOptions(color="/cam/color/video"))


@pytest.mark.parametrize("form", ["h264", "webp", "zstd"])
def test_unsupported_colour_formats_are_reported_in_a_note(tmp_path, form):
    data = struct.pack("<IIBII", 3, 4, 0, 12, 7) + b"of_mars" if form == "zstd" else b"\0" * 90

    def more(log, i, at):
        log.ros(f"{COLOR}/compressed", ros_compressed(data, form, at, COLOR_FRAME), at)

    path, scene = write_depth(tmp_path / "x.mcap", more=more)
    with open_both_ways(path) as log:
        assert not log.has_color and f"'{form}' of {COLOR}/compressed" in log.color_problem
        np.testing.assert_array_equal(log.read(range(8)).frames.depth, scene.depth)


@pytest.mark.parametrize("data", [b"", b"\x1f\x8b" + bytes(9), zstandard.compress(b"\0" * 10**8)])
def test_damaged_zstd_colour_loses_no_frames(tmp_path, data):
    head = struct.pack("<IIBII", COLOR_SIZE[1], COLOR_SIZE[0], 0, 120, 4) + b"rgb8"

    def more(log, i, at):
        good = packed(smooth(0), "zstd")
        message = ros_compressed(head + data if i else good, "zstd", at, COLOR_FRAME)
        log.ros(f"{COLOR}/zstd", message, at)

    path, scene = write_depth(tmp_path / "x.mcap", more=more)
    with open_both_ways(path) as log:
        batch = log.read(range(8), color=True)
        assert set(batch.status) == {FrameStatus.OK} and batch.notes.bad_color == 7
        assert (batch.frames.color_stamp_ns >= 0).tolist() == [True] + [False] * 7
        np.testing.assert_array_equal(batch.frames.depth, scene.depth)


def test_depth_compressed_by_zstd_is_read(tmp_path):
    scene = make_scene(3)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        for depth, at in zip(scene.depth, scene.depth_ns.tolist(), strict=True):
            head = struct.pack("<IIBII", *depth.shape, 0, 2 * depth.shape[1], 5) + b"16UC1"
            data = head + zstandard.compress(depth.tobytes())
            log.ros(f"{DEPTH}/zstd", ros_compressed(data, "zstd", at, DEPTH_FRAME), at)
    with open_both_ways(str(tmp_path / "x.mcap")) as log:
        np.testing.assert_array_equal(log.read(range(3)).frames.depth, scene.depth)


def test_several_colour_topics_are_reported_in_a_note(tmp_path):
    def more(log, i, at):
        for name in ("one", "other"):
            image = ros_image(smooth(i), "rgb8", at, COLOR_FRAME)
            log.ros(f"/{name}/color/image_raw", image, at)

    path, scene = write_depth(tmp_path / "x.mcap", more=more)
    with open_both_ways(path) as log:
        assert not log.has_color and "several topics may be colour" in log.color_problem
        assert "choose one with --log.color" in log.color_problem
        np.testing.assert_array_equal(log.read(range(8)).frames.depth, scene.depth)


def test_an_uncalibrated_colour_camera_is_an_error_only_if_flags_refer_to_it(tmp_path):
    scene = make_scene(3)
    path = str(tmp_path / "x.mcap")
    with LogFile(tmp_path / "x.mcap") as log:
        log.ros(DEPTH_INFO, ros_info(DEPTH_SIZE, DEPTH_K, START, DEPTH_FRAME), START)
        for color, depth, at in zip(scene.color, scene.depth, scene.depth_ns.tolist(), strict=True):
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
            log.ros(DEPTH, ros_image(depth, "16UC1", at, DEPTH_FRAME), at)
    with open_both_ways(path) as log:
        assert not log.has_color and "no calibration of the colour camera" in log.color_problem
        note = "colour camera without calibration: pictures show depth"
        assert any(text.startswith(note) for text in log.description.notes)
    with pytest.raises(CalibrationError, match=r"--log\.color-from-depth"):
        open_both_ways(path, LogOptions(color_intrinsics=COLOR_K))
    given = LogOptions(color_intrinsics=COLOR_K, color_from_depth=(0.01, 0, 0, 0, 0, 0, 1))
    with open_both_ways(path, given) as log:
        assert log.has_color and log.calibration.image[2:6] == COLOR_K
        np.testing.assert_array_equal(log.read(range(3), color=True).frames.color, scene.color)


def test_aligned_depth_of_half_the_size_has_scaled_intrinsics(tmp_path):
    scene = make_scene(3, size=(20, 15))
    half = tuple(value / 2 for value in COLOR_K)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log, aligned=True)
        info = ros_info((20, 15), half, START, COLOR_FRAME)
        log.ros("/cam/aligned_depth_to_color/camera_info", info, START)
        for color, depth, at in zip(scene.color, scene.depth, scene.depth_ns.tolist(), strict=True):
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
            log.ros(ALIGNED, ros_image(depth, "16UC1", at, COLOR_FRAME), at)
    with open_both_ways(str(tmp_path / "x.mcap")) as log:
        assert log.calibration.depth[:6] == (20, 15, *half)
        assert log.calibration.image[:6] == (*COLOR_SIZE, *COLOR_K)
        np.testing.assert_array_equal(log.calibration.color_from_depth.T, np.eye(4))
        frames = log.read(range(3), color=True).frames
        np.testing.assert_array_equal(frames.depth, scene.depth)
        np.testing.assert_array_equal(frames.color, scene.color)


def test_the_mount_comes_from_the_colour_camera_if_tf_lacks_the_depth_camera(tmp_path):
    scene = make_scene(3)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log, tf=False)
        message = ros_type("realsense2_camera_msgs/msg/Extrinsics")
        rotation = T_COLOR_DEPTH[:3, :3].T.reshape(-1)
        extrinsics = message(rotation, T_COLOR_DEPTH[:3, 3].copy())
        log.ros("/cam/extrinsics/depth_to_color", extrinsics, START)
        level = (-0.5, 0.5, -0.5, 0.5)
        log.ros("/tf_static", ros_tf(("base_link", COLOR_FRAME, (0.1, 0, 0.4), level)), START)
        for step in range(3):
            edge = "odom", "base_link", (1.0, 2.0, 0.0), (0, 0, 0, 1)
            at = START - 50_000_000 + step * 100_000_000
            log.ros("/tf", ros_tf(edge, stamp_ns=at), at)
        for color, depth, at in zip(scene.color, scene.depth, scene.depth_ns.tolist(), strict=True):
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
            log.ros(DEPTH, ros_image(depth, "16UC1", at, DEPTH_FRAME), at)
    with open_both_ways(str(tmp_path / "x.mcap")) as log:
        assert log.camera_frame == DEPTH_FRAME
        T_base_color = np.eye(4)
        T_base_color[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
        T_base_color[:3, 3] = 0.1, 0, 0.4
        np.testing.assert_allclose(log.T_base_camera, T_base_color @ T_COLOR_DEPTH, atol=1e-12)
        T_odom_base = np.eye(4)
        T_odom_base[:2, 3] = 1, 2
        assert log.T_world_camera is not None and log.T_base_camera is not None
        for T in log.T_world_camera:
            np.testing.assert_allclose(T, T_odom_base @ log.T_base_camera, atol=1e-12)


def test_a_thermal_camera_is_not_a_depth_camera(tmp_path):
    def more(log, i, at):
        log.ros("/flir/image_raw", ros_image(smooth(i)[..., 0].astype("u2"), "mono16", at, "f"), at)

    path, _ = write_depth(tmp_path / "x.mcap", lambda i: True, more=more)
    with open_both_ways(path) as log:
        assert (log.camera, log.label) == ("cam", "x") and not log.description.cameras


def test_two_depth_cameras_without_colour_require_a_choice(tmp_path):
    scene = make_scene(3)
    with LogFile(tmp_path / "x.mcap") as log:
        for name in ("front", "rear"):
            info = ros_info(DEPTH_SIZE, DEPTH_K, START, name)
            log.ros(f"/{name}/depth/camera_info", info, START)
            for depth, at in zip(scene.depth, scene.depth_ns.tolist(), strict=True):
                log.ros(f"/{name}/depth/image_raw", ros_image(depth, "16UC1", at, name), at)
    with open_both_ways(str(tmp_path / "x.mcap"), LogOptions(camera="rear")) as log:
        assert log.camera_frame == "rear" and log.num_frames == 3


@pytest.mark.parametrize(("every", "reported"), [(1, False), (3, True)])
def test_a_depth_topic_with_more_images_is_reported_in_a_note(tmp_path, every, reported):
    """Depth is aligned on the robot, which is too slow for some of the images."""
    scene = make_scene(6)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        write_images(log, scene)
        for depth, at in list(zip(scene.depth, scene.color_ns.tolist(), strict=True))[::every]:
            image = np.resize(depth, COLOR_SIZE[::-1])
            log.ros(ALIGNED, ros_image(image, "16UC1", at, COLOR_FRAME), at)
    with open_both_ways(str(tmp_path / "x.mcap")) as log:
        assert log.num_frames == 6 // every
        text = f"/cam/depth/image_rect_raw has 6 depth images, but {ALIGNED}, which is used, has 2"
        assert any(text in note for note in log.description.notes) == reported
