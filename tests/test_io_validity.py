"""Frames for which a calibration is valid."""

import numpy as np

from jaxdet.io.messages import CameraInfoMessage
from jaxdet.io.validity import CalibrationChange, other_calibration, says_other, values_of


def info(width=640, fx=500.0, stamp=0):
    return CameraInfoMessage(
        stamp,
        "camera",
        width,
        480,
        "plumb_bob",
        (0.0,) * 5,
        (fx, 0.0, 320.0, 0.0, fx, 240.0, 0.0, 0.0, 1.0),
        (),
    )


def test_the_first_calibration_is_valid_for_earlier_frames():
    used, other = info(), info(fx=400.0)
    changes = [
        CalibrationChange(10, 10, values_of(used)),
        CalibrationChange(20, 20, values_of(other)),
    ]
    assert other_calibration(np.array([5, 15, 20, 25]), changes, used, False).tolist() == [
        False,
        False,
        True,
        True,
    ]


def test_another_size_or_lens_is_a_change_of_calibration():
    assert says_other(info(width=848), info())
    assert says_other(info()._replace(height=400), info())
    assert says_other(info()._replace(P=(1.0,) * 12), info())
    assert says_other(info()._replace(model="equidistant"), info())
    assert not says_other(info(stamp=7)._replace(frame_id="x"), info())
