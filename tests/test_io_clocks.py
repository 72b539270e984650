"""Clocks of topics: only a constant offset is applied."""

from pathlib import Path

import pytest

from jaxdet.io import open_log
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
