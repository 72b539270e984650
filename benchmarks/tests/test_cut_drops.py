"""Drops cut into depth."""

import numpy as np
import pytest

from benchmarks.cut_drops import cuts
from jaxdet.config import Config
from jaxdet.types import Calibration
from tests.floor_cells import CAMERA, Pose, cast
from tests.scenes import frames


@pytest.mark.parametrize("drop_m", [0.15, 0.3])
def test_a_drop_cut_into_depth_ends_the_rays_and_keeps_the_plane(drop_m: float) -> None:
    pose = Pose(0.8, 15.0, 0.0)
    image = np.rint(cast(pose, [((-4.0, 4.5, 0.0), (4.0, 4.6, 2.5))]) * 1000).astype(np.uint16)
    color = np.zeros((1, *image.shape, 3), np.uint8)
    given = frames(Calibration(CAMERA), color, image[None], plane=pose.plane())
    both = cuts(given, Config(), 2.0, drop_m)
    assert len(both) == 2
    for cut in both:
        assert cut.is_right and cut.ahead > 50
        assert cut.passing == 0 and cut.as_drop > cut.ahead // 2
    assert cuts(given, Config(), 6.0, drop_m) == []
