"""Benchmark with inserted low boxes: their depth, and where they don't fit."""

import numpy as np
import pytest

from benchmarks.low_boxes import Box, insert, outcomes, view_of
from jaxdet.config import Config
from jaxdet.types import Calibration, Frames
from tests.floor_cells import CAMERA, Pose, cast, measured
from tests.scenes import frames

POSE = Pose(0.8, 30.0, 0.0)
BOX = Box(forward=1.2, right=-0.25, width=0.3, height=0.1)
CORNERS = ((-0.4, 1.2, 0.0), (-0.1, 1.5, 0.1))


def given(depth: np.ndarray) -> Frames:
    """Return a frame of a camera above a known floor."""
    black = np.zeros((1, *depth.shape, 3), np.uint8)
    return frames(Calibration(CAMERA), black, depth[None], plane=POSE.plane())


def image(noise: float = 0.0) -> np.ndarray:
    return measured(cast(POSE, []), 0, noise)


def test_an_inserted_box_has_the_depth_of_a_box_and_the_holes_of_the_image() -> None:
    one = given(image())
    made = insert(view_of(one, POSE.plane()), BOX)
    assert made is not None
    depth, mask = made
    true, known = cast(POSE, [CORNERS]), one.depth[0] > 0
    np.testing.assert_array_equal(mask, known & (true < cast(POSE, []) - 1e-6))
    np.testing.assert_allclose(depth[mask], true[mask], atol=0.005)
    np.testing.assert_array_equal(depth[~mask], one.depth[0][~mask] * 0.001)


def test_an_inserted_box_has_the_noise_of_the_image() -> None:
    made = insert(view_of(given(image(0.005)), POSE.plane()), BOX)
    assert made is not None
    depth, mask = made
    error = (depth - cast(POSE, [CORNERS]))[mask] / depth[mask] ** 2
    assert np.std(error) == pytest.approx(0.005, rel=0.2)


@pytest.mark.parametrize(
    "other",
    [((-0.1, 1.2, 0.0), (0.2, 1.5, 0.2)), ((-0.6, 0.9, 0.0), (0.2, 1.0, 0.4))],
    ids=["on an object", "hidden"],
)
def test_a_box_that_does_not_fit_is_not_inserted(other: tuple[tuple[float, ...], ...]) -> None:
    near, far = other
    corners = (near[0], near[1], near[2]), (far[0], far[1], far[2])
    view = view_of(given(measured(cast(POSE, [corners]), 0, 0.0)), POSE.plane())
    assert insert(view, BOX) is None
    free = view_of(given(image()), POSE.plane())
    assert insert(free, BOX._replace(right=3.0)) is None


def test_boxes_on_a_floor_without_noise_are_found_and_end_the_free_floor() -> None:
    results = list(outcomes(given(image()), Config()))
    high = [one for one in results if one.box.height > 0.09 and one.box.forward < 2]
    assert len(high) > 5
    assert all(one.found and one.ends for one in high)
