"""Noise of the floor: measured on the cells below it, and at most the configured noise."""

from dataclasses import replace

import numpy as np
import pytest

from jaxdet.config import Config
from jaxdet.floor.frame import floor_frames
from jaxdet.floor.plane import SLOPE_BITS, flat_plane, step_height, unknown_plane
from jaxdet.reference._floor_noise import noise_slope
from jaxdet.reference._view import View
from jaxdet.types import Calibration, Intrinsics

UNIT, HEIGHT_M, NEAREST, FARTHEST = 0.001, 1.5, 150, 4600
CAMERA = Calibration(Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5))
STEP = step_height(CAMERA, Config())
MOST = STEP.most_noise(1500)
FLOOR = floor_frames(flat_plane(np.array([HEIGHT_M]), np.zeros(1), np.zeros(1)), UNIT)[0]


def cells(rows: int, noise: float, seed: int = 0) -> View:
    """Return cells of a floor; heights have a standard deviation of ``noise`` times z."""
    rng = np.random.default_rng(seed)
    z = np.linspace(1000, 4500, rows)[:, None].repeat(40, axis=1).astype(np.int64)
    height = np.rint(rng.normal(0, 1, z.shape) * noise * z).astype(np.int64)
    return View(0 * z, 0 * z, z, 0 * z, z, height)


def measured(view: View) -> float:
    """Return the noise per depth."""
    return noise_slope(view, STEP, FLOOR, NEAREST, FARTHEST) / (1 << SLOPE_BITS)


@pytest.mark.parametrize("noise", [0.002, 0.004, 0.007])
def test_the_noise_is_three_halves_of_the_depth_that_a_hundredth_of_the_cells_exceeds(
    noise: float,
) -> None:
    level = MOST / 16 / (1 << SLOPE_BITS)
    exact = 1.5 * 2.05 * noise  # 2 % of the cells below the floor are deeper
    assert exact - level / 2 < measured(cells(100, noise)) < exact + 2 * level


def test_the_noise_is_at_most_the_configured_one() -> None:
    assert noise_slope(cells(100, 0.02), STEP, FLOOR, NEAREST, FARTHEST) == MOST
    none = replace(Config(), ground=replace(Config().ground, noise_per_m=0.0))
    step = step_height(CAMERA, none)
    assert noise_slope(cells(100, 0.02), step, FLOOR, NEAREST, FARTHEST) == 0


def test_objects_and_cells_outside_of_the_range_do_not_count() -> None:
    view = cells(100, 0.003)
    objects = view.height.copy()
    objects[20:60, 5:30] = np.abs(objects[20:60, 5:30]) + 40
    assert measured(view._replace(height=objects)) <= measured(view)
    deep = np.where(view.z > 4000, -60, view.height)
    assert measured(view._replace(height=deep)) > measured(view)
    far = view._replace(height=deep, z=np.where(view.z > 4000, FARTHEST + 1, view.z))
    assert measured(far) == measured(view._replace(z=far.z))


def test_without_enough_floor_the_noise_is_the_configured_one() -> None:
    assert noise_slope(cells(5, 0.0), STEP, FLOOR, NEAREST, FARTHEST) < MOST
    assert noise_slope(cells(4, 0.0), STEP, FLOOR, NEAREST, FARTHEST) == MOST
    unknown = floor_frames(unknown_plane(1), UNIT)[0]
    assert noise_slope(cells(100, 0.0), STEP, unknown, NEAREST, FARTHEST) == 0


def test_noise_below_the_step_height_is_not_measured() -> None:
    """Seen from 0.3 m, the maximum noise is below 5 cm in the whole range."""
    low = floor_frames(flat_plane(np.array([0.3]), np.zeros(1), np.zeros(1)), UNIT)[0]
    assert noise_slope(cells(100, 0.0), STEP, low, NEAREST, FARTHEST) == STEP.most_noise(300)
