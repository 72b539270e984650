"""Clocks of topics: constant offsets, and clocks that are set or adjusted during the recording."""

from pathlib import Path

import numpy as np
import pytest

from jaxdet.io import LogOptions, open_log
from jaxdet.io.chunks import MAX_TIME_NS
from jaxdet.io.clocks import read_clock
from jaxdet.sim import SimConfig, write_log
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    DEPTH,
    DEPTH_FRAME,
    SECOND,
    START,
    LogFile,
    make_scene,
    ros_image,
    ros_odometry,
    ros_tf,
    write_calibration,
)
from tests.rewritten import Message, changed, read_messages, write_messages

CAMERA, POSES, UNSET = "/camera", ("/tf", "/odom"), -1_699_999_000.0
ALIGNED = "/camera/camera/aligned"


@pytest.mark.parametrize(("jumps_s", "steady"), [((2.0, 2.0, 2.0), True), ((0.0, 2.0, 4.0), False)])
def test_only_a_constant_offset_of_colour_is_applied(
    tmp_path: Path, jumps_s: tuple[float, ...], steady: bool
) -> None:
    scene = make_scene(3)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        for number in range(30):
            at = START + number * SECOND // 10
            ahead = round(jumps_s[number % 3] * SECOND)
            log.ros(DEPTH, ros_image(scene.depth[number % 3], "16UC1", at, DEPTH_FRAME), at)
            image = ros_image(scene.color[number % 3], "rgb8", at + ahead, COLOR_FRAME)
            log.ros(COLOR, image, at)
    with open_log(str(tmp_path / "x.mcap")) as found:
        notes = (*found.description.notes, *found.description.warnings)
        assert any("--log.color-offset-s" in text for text in notes) == steady


@pytest.mark.parametrize(
    ("offset_s", "jitter_s", "is_warned"),
    [
        (0.0, 0.0, False),
        (0.15, 0.0, False),
        (-0.15, 0.03, False),
        (0.3, 0.0, True),
        (-0.3, 0.03, True),
        (0.4, 0.03, True),
        (-0.48, 0.01, True),
        (0.3, 0.3, False),
        (1.0, 0.03, False),
    ],
)
@pytest.mark.parametrize("of", ["odometry", "transforms"])
def test_an_offset_of_poses_that_is_not_corrected_is_a_warning_if_it_exceeds_the_jitter(
    tmp_path: Path, offset_s: float, jitter_s: float, is_warned: bool, of: str
) -> None:
    """Offsets of more than 0.5 s are corrected; the flag replaces both."""
    random, scene = np.random.default_rng(1), make_scene(3)

    def stamp_of(at: int) -> int:
        return at - round(abs(random.normal(0, jitter_s)) * SECOND)

    unturned = (0, 0, 0, 1)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        log.ros("/tf_static", ros_tf(("base_link", DEPTH_FRAME, (0, 0, 0.3), unturned)), START)
        for number in range(60):
            at = START + number * SECOND // 10
            if number % 3 == 0:
                image = ros_image(scene.depth[number % 3], "16UC1", stamp_of(at), DEPTH_FRAME)
                log.ros(DEPTH, image, at)
            stamp = stamp_of(at) + round(offset_s * SECOND)
            edge = "odom", "base_link", (number / 10, 0, 0), unturned
            if of == "odometry":
                log.ros("/odom", ros_odometry(*edge, stamp), at)
            else:
                log.ros("/tf", ros_tf(edge, stamp_ns=stamp), at)
    for options in (LogOptions(), LogOptions(pose_offset_s=0.0)):
        with open_log(str(tmp_path / "x.mcap"), options) as found:
            assert found.has_poses
            texts = [text for text in found.description.warnings if "pose-offset" in text]
            warned = [text for text in texts if "is not corrected" in text]
            corrected = [text for text in texts if "this is corrected" in text]
            expected = (is_warned, abs(offset_s) > 0.5) if options == LogOptions() else (False,) * 2
            assert (bool(warned), bool(corrected)) == expected, texts


@pytest.mark.parametrize("late", [COLOR, "/odom"])
def test_a_topic_with_the_timestamps_of_depth_that_is_recorded_late_has_no_offset(
    tmp_path: Path, late: str
) -> None:
    """Visual odometry, for instance, has the timestamps of the images and is computed late."""
    scene, unturned = make_scene(3), (0, 0, 0, 1)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        log.ros("/tf_static", ros_tf(("base_link", DEPTH_FRAME, (0, 0, 0.3), unturned)), START)
        for number in range(30):
            at = START + number * SECOND // 10
            times = {name: at + SECOND * (name == late) for name in (DEPTH, COLOR, "/odom")}
            images = scene.depth[number % 3], scene.color[number % 3]
            log.ros(DEPTH, ros_image(images[0], "16UC1", at, DEPTH_FRAME), times[DEPTH])
            log.ros(COLOR, ros_image(images[1], "rgb8", at, COLOR_FRAME), times[COLOR])
            pose = "odom", "base_link", (number, 0, 0), unturned
            log.ros("/odom", ros_odometry(*pose, at), times["/odom"])
    for scan in (False, True):
        with open_log(str(tmp_path / "x.mcap"), LogOptions(scan=scan)) as found:
            np.testing.assert_array_equal(found.color_stamps_ns, found.stamps_ns)
            assert found.T_world_camera is not None
            np.testing.assert_allclose(np.diff(found.T_world_camera[:, 0, 3]), 1)
            [text] = found.description.warnings
            assert text.startswith(late) and "equal timestamps were recorded 1.0 s apart" in text


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    """Return messages of a simulated log with aligned depth."""
    path = tmp_path_factory.mktemp("sim") / "sim.mcap"
    write_log(path, SimConfig(frames=24, width=160, height=120, depth_form="aligned"))
    return read_messages(path)


@pytest.mark.parametrize(
    ("seconds", "share", "late_ns"),
    [
        (UNSET, 0.9, 0),
        (UNSET + 946_684_800, 0.1, 20_000_000),
        (-2.0, 0.5, 20_000_000),
        (2.0, 0.5, 0),
        (2.0, 0.9, 20_000_000),
    ],
)
@pytest.mark.parametrize(
    "topics",
    [("/",), (CAMERA,), (ALIGNED,), ("/camera/camera/color",), POSES, ("recorder",)],
    ids=lambda topics: topics[0],
)
def test_a_clock_that_was_adjusted_is_as_if_it_had_always_been_right(
    tmp_path: Path,
    drive: list[Message],
    topics: tuple[str, ...],
    seconds: float,
    share: float,
    late_ns: int,
) -> None:
    """Timestamps before the adjustment are wrong, and of ``recorder`` all log times as well.

    A recorder whose clock is set ahead by seconds can't be distinguished from one that pauses.
    """
    if topics == ("recorder",) and seconds == -2.0:
        return
    random, recorder = np.random.default_rng(1), topics == ("recorder",)
    times = [item.log_ns for item in drive]
    step_ns = min(times) + round(share * (max(times) - min(times)))

    def change(message: Message) -> None:
        is_wrong = message.log_ns < step_ns and message.topic != "/tf_static"
        if is_wrong and (recorder or message.topic.startswith(topics)):
            message.delay(round(seconds * SECOND))
        message.log_ns += round(random.uniform(0, late_ns))
        if is_wrong and recorder:
            message.log_ns += round(seconds * SECOND)

    right = write_messages(tmp_path / "right.mcap", drive)
    wrong = write_messages(tmp_path / "wrong.mcap", changed(drive, change), ordered=False)
    exact = not late_ns and not recorder
    for scan in (False, True):
        options = LogOptions(start="0.39s", stop="0.61s", scan=scan)
        with open_log(str(right), options) as whole, open_log(str(wrong), options) as log:
            assert len(log.frames) == 7 or not exact
            assert abs(log.frames[0] - whole.frames[0]) <= (0 if exact else 1)
            about, expected = log.description, whole.description
            assert about.duration_s == pytest.approx(expected.duration_s, abs=0.05)
            found, poses = log.read(range(24), color=True), whole.T_world_camera
            assert log.T_world_camera is not None and poses is not None
            same = whole.read(range(24), color=True)
            np.testing.assert_array_equal(found.frames.depth, same.frames.depth)
            np.testing.assert_array_equal(found.frames.color, same.frames.color)
            atol = 1e-6 if exact else 0.02
            np.testing.assert_allclose(log.T_world_camera, poses, rtol=0, atol=atol)
            texts = [text for text in about.warnings if "was set or adjusted" in text]
            assert len(texts) == 1
            assert not [text for text in about.warnings if "offset" in text]


def test_log_times_that_are_wrong_or_late_do_not_change_timestamps() -> None:
    stamps = START + np.arange(300) * SECOND // 30
    late = np.where(np.arange(300) // 20 == 3, stamps[80], stamps)
    logs = {
        "a stalled recorder": np.maximum.accumulate(late),
        "images that are sent 2 s late": stamps + 2 * SECOND * (np.arange(300) // 50 == 2),
        "one image that is sent 5 s late": stamps + 5 * SECOND * (np.arange(300) == 40),
        "a player that pauses for a minute": stamps + 60 * SECOND * (np.arange(300) > 100),
        "a player at a tenth of the speed": START + 10 * (stamps - START),
        "a recorder whose clock is set back": stamps - 3 * SECOND * (np.arange(300) > 100),
        "no log times": np.zeros(300, np.int64),
    }
    for name, log_ns in logs.items():
        clock = read_clock("/a", stamps, log_ns, 8)
        np.testing.assert_array_equal(clock.stamps_ns, stamps, name)
        assert not clock.text, name
    for later_s in (0.001, 1000):
        again = stamps + round(later_s * SECOND)
        times, content = np.append(stamps, again), np.zeros((600, 7))
        clock = read_clock("/a", np.tile(stamps, 2), times, 8, content=content)
        assert not clock.text and set(clock.delays_ns.tolist()) == {0}


@pytest.mark.parametrize("step_s", [2.0, -2.0, 1.5])
def test_timestamps_that_occur_twice_since_a_clock_was_adjusted_are_different(
    step_s: float,
) -> None:
    """The step is a multiple of the interval, as it may be in a simulation."""
    stamps = START + np.arange(300) * (SECOND // 32)
    wrong = stamps + round(step_s * SECOND) * (np.arange(300) < 200)
    moving = np.arange(300)[:, None] * np.ones(7)
    for content in (None, moving):
        clock = read_clock("/a", wrong, stamps, 8, content=content)
        np.testing.assert_array_equal(clock.stamps_ns, stamps)
        assert "300 timestamps, 200 are" in clock.text


@pytest.mark.filterwarnings("error")
def test_damaged_times_are_no_faults(tmp_path: Path) -> None:
    """Differences of such times exceed 64 bits."""
    stamps, log_ns = np.array([2**62, 2**62, 1, 5]), np.array([0, 2**62, MAX_TIME_NS, 1])
    assert (read_clock("/a", stamps, log_ns, 8).stamps_ns >= 0).all()
    scene = make_scene(8)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        for number in range(8):
            image = ros_image(scene.depth[number], "16UC1", START + number, DEPTH_FRAME)
            log.ros(DEPTH, image, number)
            image = ros_image(scene.color[number], "rgb8", 1 + number, COLOR_FRAME)
            log.ros(COLOR, image, MAX_TIME_NS - 8 + number)
    with open_log(str(tmp_path / "x.mcap")) as found:
        assert len(found) == 8
