"""find_floor: floor of each frame on recorded cells."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxdet import open_log, reference
from jaxdet.camera import pixel_rays
from jaxdet.config import Config
from jaxdet.floor.plane import down_vector, flat_plane, unknown_plane
from jaxdet.reference._floor import find_floor
from jaxdet.reference.paper import align
from jaxdet.types import Calibration
from tests.floor_cells import CONFIG, UNIT, positions


def grids(path: Path) -> tuple[list[list[np.ndarray]], list[np.ndarray], Calibration]:
    """Return the cells and the aligned depth of each frame, and the calibration."""
    cells, depths = [], []
    with open_log(str(path)) as log:
        for batch in log.batches(6):
            frames, calibration = batch.frames, batch.frames.calibration
            z = frames.depth if calibration.is_aligned else align(frames.depth, calibration).z
            z = z[frames.valid]
            step = round(calibration.image.width / 160)
            cells += [positions(one[None], calibration.image, step) for one in z]
            depths += list(z)
        return cells, depths, log.calibration


def test_floor_of_a_recorded_cart_agrees_with_ransac(shared_data):
    """RANSAC results in README_DATA: height 0.62-0.63 m, pitch 19-20 degrees, roll 9-13 degrees."""
    cells, _, _ = grids(shared_data / "aims_slam/aims_slam_18frames.mcap")
    assert len(cells) == 18
    for one in cells:
        fit = find_floor(*one, unknown_plane(1), CONFIG, UNIT)
        assert fit.own[0]
        assert abs(fit.plane.height[0] - 0.625) < 0.012
        assert 18.3 < np.degrees(fit.plane.pitch[0]) < 20.5
        assert 9.0 < np.degrees(fit.plane.roll[0]) < 14.2
        prior = flat_plane(np.array([0.63]), *np.radians([[19.5], [11.5]]))
        near = find_floor(*one, prior, CONFIG, UNIT)
        assert near.own[0]
        assert abs(near.plane.height[0] - fit.plane.height[0]) < 0.012


@pytest.mark.parametrize(
    ("name", "step", "most"), [("mosd", 0.008, 0.01), ("wheelchair", 0.05, 0.03)]
)
def test_points_of_labelled_supports_are_hardly_above_the_floor(shared_data, name, step, most):
    cells, depths, calibration = grids(shared_data / f"labelled/{name}.mcap")
    x, y = pixel_rays(calibration.image)
    things = []
    for n, (one, z) in enumerate(zip(cells, depths, strict=True)):
        path = shared_data / f"labelled/{name}_labels/{n:03d}.png"
        label = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert label is not None
        plane = find_floor(*one, unknown_plane(1), CONFIG, UNIT).plane
        assert plane.valid[0]
        down = down_vector(plane.pitch, plane.roll)[0]
        above = plane.height[0] - z * UNIT * (down[0] * x + down[1] * y + down[2])
        seen = (z > 0) & (z < 4000)
        assert np.mean(above[seen & (label == 1)] > step) < most
        things.append(np.mean(above[seen & (label > 1)] > step))
    if name == "mosd":
        assert min(things) > 0.9


def test_kitchen_tables_are_not_the_floor(shared_data):
    """A hand-held camera among tables sees floor in five frames, table tops in most others."""
    cells, _, _ = grids(shared_data / "look/kitchen.mcap")
    alone = [find_floor(*one, unknown_plane(1), CONFIG, UNIT) for one in cells]
    assert [n for n, fit in enumerate(alone) if fit.own[0]] == [0, 1, 2, 9, 10]
    heights = [fit.plane.height[0] for fit in alone if fit.own[0]]
    assert all(1.2 < height < 1.55 for height in heights)


def test_floor_in_front_of_walls_agrees_with_ransac_or_is_refused(shared_data):
    """README_DATA: the camera is near the floor; in frames 1, 5 and 9 a wall is the largest plane.

    RANSAC on the lower rows of frame 5, where a fifth of the floor is measured: height 5 to 7 cm,
    pitch -6 to -7 degrees.
    """
    config, alone = Config(), []
    with open_log(str(shared_data / "d435_boxes_felixchenfy")) as log:
        for batch in log.batches(5):
            frames = batch.frames
            grid = reference.cells(frames.depth, frames.calibration, config.surface)
            unit, nothing = frames.calibration.depth_unit, unknown_plane(len(frames.depth))
            alone.append(find_floor(grid.x, grid.y, grid.z, nothing, config.floor, unit))
    assert np.concatenate([fit.own for fit in alone]).tolist() == [True] * 10
    plane = alone[1].plane
    assert 0.05 < plane.height[0] < 0.07
    assert -7.5 < np.degrees(plane.pitch[0]) < -5
    assert abs(np.degrees(plane.roll[0])) < 2
