"""Clocks of topics: only a constant offset is applied."""

from pathlib import Path

import numpy as np
import pytest

from jaxdet.io import LogOptions, open_log
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
