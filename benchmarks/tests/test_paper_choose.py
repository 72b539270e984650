"""Choice of the settings of preset ``paper``: variants are evaluated like the preset itself."""

import cv2
import numpy as np
import pytest

pytest.importorskip("matplotlib")

from benchmarks.paper import choose, plan
from benchmarks.paper.preset_frames import PresetFrames, gradient, with_settings
from benchmarks.paper.shots import Spec, Store
from benchmarks.paper.systems import Prepared, found_by, paper, tally_of
from jaxdet.eval import score
from jaxdet.presets import preset

SMALL = (("height", 240), ("width", 320))


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    specs = [Spec(scene, 100, 1, "normal", SMALL) for scene in ("roadblocks", "tree_trunk")]
    return PresetFrames(Store(tmp_path_factory.mktemp("frames")).load(specs), preset("paper"))


def test_tallies_of_the_preset_equal_those_of_the_report(frames):
    found = found_by(paper(), Prepared(frames.shots))
    config = preset("paper")
    for mine, shot, one in zip(frames.tallies({}), frames.shots, found, strict=True):
        theirs = tally_of(shot, one, config)
        assert (mine.found, mine.visible, mine.false) == (
            theirs.found,
            theirs.visible,
            theirs.false,
        )
        assert score([mine]).fmi == score([theirs]).fmi
    assert sum(tally.found for tally in frames.tallies({})) > 0


def test_settings_by_name_are_set_in_their_section():
    config = with_settings(preset("paper"), choose.FIRST)
    assert (config.features.canny_low, config.features.canny_high) == (100.0, 200.0)
    assert (config.cluster.min_points, config.cluster.depth_gap_m) == (10, 0.1)
    assert config.cluster.points
    for name in choose.GRID:
        assert hasattr(config.features, name) != hasattr(config.cluster, name)


def test_canny_thresholds_at_quantiles_of_the_gradients_change_the_corners(frames):
    image = np.full((8, 8), 10, np.uint8)
    image[:, 4:] = 110
    assert np.unique(gradient(image)).tolist() == [0, 400]
    edges = cv2.Canny(image, 399, 399)
    assert edges.any() and not cv2.Canny(image, 400, 400).any()
    few, many = (frames.with_bounds(share)[0].valid.sum() for share in (0.98, 0.8))
    assert 0 < few < many


def test_the_seeds_of_the_evaluation_are_not_used_otherwise():
    others = {*plan.TUNING_SEEDS, *plan.TEST_SEEDS, *plan.REHEARSAL_SEEDS}
    assert not others & set(plan.PRESET_SEEDS)
