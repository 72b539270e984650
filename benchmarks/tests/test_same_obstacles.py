"""Comparison of the obstacles of two commits, and copies of logs without colour."""

import numpy as np
import pytest

from benchmarks import same_obstacles
from benchmarks.log_copies import copy_without_color
from benchmarks.same_obstacles import CELLS, JOINED, OUTSIDE, RECTANGLE, Frame, LogResult, compare
from jaxdet.io import open_log
from jaxdet.sim import SimConfig, write_log

SIZE = {"width": 640, "height": 480}
ALIGNED = {"color": SIZE, "color_from_depth": None}
SHIFTED = {
    "color": SIZE,
    "color_from_depth": {"rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "translation": [0.015, 0, 0]},
}
FRAME = {"camera_height_m": 0.5, "camera_pitch_rad": 0.0, "camera_roll_rad": 0.0}


def obstacle(right=0.0, **changes):
    """Return a board 30 cm wide, 2 m ahead, with columns 1 cm apart."""
    line = [[right + x / 100, 2.0] for x in range(-15, 16)]
    corners = [[right - 0.15, 2.0], [right + 0.15, 2.0], [right + 0.15, 2.2], [right - 0.15, 2.2]]
    row = dict.fromkeys(("x", "y", "x_min", "x_max", "y_min", "y_max"), 0.0)
    row |= {"z": 2.0, "z_min": 2.0, "z_max": 2.0, "num_points": 50, "distance_m": 2.0}
    row |= {"bottom_m": 0.0, "top_m": 0.3, "u_min": 200, "u_max": 300, "v_min": 200, "v_max": 300}
    row |= {"contour": np.ravel(line).tolist(), "corners_ground": np.ravel(corners).tolist()}
    return row | changes


def result(calibration, *obstacles):
    return LogResult({7: Frame(FRAME, list(obstacles))}, calibration)


def compared(calibration, old, new):
    return compare(result(calibration, *old), result(calibration, *new), 0.03, same_obstacles.EXACT)


def test_aligned_obstacles_must_be_equal():
    one = compared(ALIGNED, [obstacle()], [obstacle()])
    assert one.aligned and one.same == 1 and not one.differences
    other = compared(ALIGNED, [obstacle()], [obstacle(top_m=0.3001), obstacle(1.0)])
    assert other.same == 0 and [part.side for part in other.differences] == ["both", "new"]


def test_equal_obstacles_seen_by_a_moved_camera_are_equal():
    """The depth camera is 15 mm to the right of the colour camera."""
    found = compared(SHIFTED, [obstacle(0.015)], [obstacle(0.0)])
    assert found.same == 1 and not found.differences
    exact = compare(
        result(SHIFTED, obstacle(0.015)), result(SHIFTED, obstacle(0.0)), 1e-6, ("distance_m",)
    )
    assert exact.same == 1


@pytest.mark.parametrize("case", ["rectangle", "cells", "joined", "outside"])
def test_differences_have_their_reason(case):
    wider = obstacle()
    if case == "rectangle":
        wider["corners_ground"] = (np.array(wider["corners_ground"]) * 1.1).tolist()
    elif case == "cells":
        wider["contour"] = [*np.array(wider["contour"]).tolist(), 0.25, 2.0]
    elif case == "joined":
        wider["top_m"] = 0.8
    new = [obstacle(), obstacle(2.0, u_min=None)] if case == "outside" else [wider]
    (one,) = compared(SHIFTED, [obstacle(0.015)], new).differences
    reasons = {"rectangle": RECTANGLE, "cells": CELLS, "joined": JOINED, "outside": OUTSIDE}
    assert one.reason == reasons[case]


def test_frames_of_one_side_are_counted():
    old, new = result(SHIFTED), result(SHIFTED)
    new.frames[9] = new.frames[7]
    found = compare(old, new, 0.03, ())
    assert (found.frames, found.only_old, found.only_new) == (1, 0, 1)


def test_a_copy_without_color_has_the_same_depth(tmp_path):
    log, copy = tmp_path / "log.mcap", tmp_path / "copy.mcap"
    write_log(log, SimConfig("single_box", 2, width=96, height=72))
    copy_without_color(log, copy)
    with open_log(str(log)) as one, open_log(str(copy)) as other:
        assert one.has_color and not other.has_color
        ours, theirs = (source.read(range(2)).frames for source in (one, other))
        np.testing.assert_array_equal(ours.depth, theirs.depth)
        np.testing.assert_array_equal(ours.T_world_camera, theirs.T_world_camera)
