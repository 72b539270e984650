"""Lower parts of obstacles: cells below the step height under the cells of an obstacle."""

import numpy as np
import pytest

from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.reference._lower_parts import with_lower_parts
from jaxdet.reference._view import View

HEIGHT = [90, 70, 45, 30, 20, 0]
FORWARD = [1000, 1000, 1005, 990, 1000, 980]
LABEL = [3, 3, -1, -1, -1, -1]


def extended(
    height: list[int], forward: list[int], label: list[int], roll_deg: float | None = 0.0
) -> list[int]:
    """Return the obstacles of a column of cells, the first one at the top of the image."""
    column = [np.array(a, np.int64)[:, None] for a in (label, height, forward)]
    none = np.zeros((len(label), 1), np.int64)
    view = View(none, none, none + 1000, none, column[2], column[1])
    level = flat_plane(np.array([0.5]), np.zeros(1), np.radians([roll_deg or 0.0]))
    plane = unknown_plane(1) if roll_deg is None else level
    floor = floor_frames(plane, 0.001)[0]
    return with_lower_parts(column[0], column[1] > 25, view, floor).ravel().tolist()


def test_an_obstacle_goes_on_down_to_half_of_the_step_height() -> None:
    assert extended(HEIGHT, FORWARD, LABEL) == [3, 3, 3, 3, -1, -1]


@pytest.mark.parametrize(("roll", "moves"), [(-44.0, True), (46.0, False), (None, False)])
def test_it_goes_on_unless_the_camera_is_on_its_side_or_the_floor_is_unknown(
    roll: float | None, moves: bool
) -> None:
    assert (extended(HEIGHT, FORWARD, LABEL, roll) == [3, 3, 3, 3, -1, -1]) == moves
    assert moves or extended(HEIGHT, FORWARD, LABEL, roll) == LABEL


def test_rows_of_a_camera_upside_down_go_upward() -> None:
    column = (HEIGHT[::-1], FORWARD[::-1], LABEL[::-1])
    assert extended(*column, 180.0) == [-1, -1, 3, 3, 3, 3]
    assert extended(*column, 0.0) == LABEL[::-1]


def test_floor_that_rises_gently_is_no_part_of_an_obstacle() -> None:
    gentle = [1000, 1000, 974, 950, 900, 800]
    assert extended(HEIGHT, gentle, LABEL) == LABEL
    assert extended(HEIGHT, [1000, 1000, 975, 950, 900, 800], LABEL) == [3, 3, 3, -1, -1, -1]


def test_cells_of_other_obstacles_and_behind_an_edge_keep_their_label() -> None:
    other = [3, 3, -1, 5, -1, -1]
    assert extended(HEIGHT, FORWARD, other) == [3, 3, 3, 5, -1, -1]
    rising = [90, 70, 75, 30, 20, 0]
    assert extended(rising, FORWARD, LABEL) == LABEL
