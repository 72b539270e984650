"""Recordings made by others, and files that are not recordings."""

from pathlib import Path

import numpy as np
import pytest

from jaxdet.errors import InputError, JaxdetError, TopicError
from jaxdet.io import find_logs, open_log
from jaxdet.io.motion import motion_matrix
from tests.io_both_ways import is_indexed


def test_a_recorded_unaligned_log_is_read(shared_data):
    with open_log(str(shared_data / "aims_slam" / "aims_slam_18frames.mcap")) as log:
        color, depth = log.calibration.color, log.calibration.depth
        assert log.num_frames == 18 and depth is not None
        assert color[:6] == (640, 480, 610.0, 610.0, 320.0, 240.0)
        assert depth[:6] == (640, 480, 384.5, 384.5, 321.7, 236.8)
        assert log.calibration.color_from_depth is not None
        assert log.calibration.color_from_depth.translation == (0.0148, 0.0, 0.0)
        assert sum(batch.frames.valid.sum() for batch in log.batches(8)) == 18
        assert is_indexed(log)


def test_a_recorded_pair_with_factory_calibration_is_read(shared_data):
    path = shared_data / "realsense_d435_bag" / "realsense_d435_1pair.mcap"
    with open_log(str(path)) as log:
        pairing = log.described(next(log.batches(2)).notes).pairing
        assert pairing is not None
        assert (pairing.num_frames, pairing.num_with_color) == (2, 1)
        assert log.stamps_ns[1] == 1600000360981765000
        t = np.array([0.01431131, 0.00060231, 0.00061080])
        q = np.array([-5.3199e-05, 0.00646343, 0.00515485, 0.99996585])
        assert log.calibration.color_from_depth is not None
        np.testing.assert_allclose(
            log.calibration.color_from_depth.T, motion_matrix(t, q), rtol=0, atol=1e-6
        )
        assert log.read([0]).frames.valid.all()


def test_recorded_logs_without_depth_are_clear_errors(shared_data):
    files = sorted((shared_data / "mcap_real").glob("*.mcap"))
    assert files
    for path in files:
        with pytest.raises((TopicError, InputError)) as caught:
            open_log(str(path))
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_recorded_logs_are_equal_by_index_and_by_scan(shared_data):
    """``test_a_recorded_unaligned_log_is_read`` covers the log in ``aims_slam``."""
    found = 0
    for path in sorted(shared_data.rglob("*.mcap")):
        if path.parent.name not in ("mcap_real", "aims_slam"):
            with open_log(str(path)) as log:
                assert is_indexed(log)
                found += 1
    assert found >= 5


def test_empty_inputs_are_errors(tmp_path: Path):
    for text in (str(tmp_path), str(tmp_path / "no.mcap"), str(tmp_path / "*.mcap")):
        with pytest.raises(JaxdetError, match=str(tmp_path)):
            find_logs([text])
