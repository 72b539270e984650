"""Depth errors of simulated floors, compared with those of real cameras."""

import numpy as np

from benchmarks.real_floor import simulated


def test_depth_errors_of_simulated_floors_are_in_the_range_of_real_ones():
    """Medians over eight frames are in the range of a D415's frames, clean ones below it."""
    measured, clean = (
        [np.array([[s.no_depth, *s.deviation_m, s.above_step] for s in both]) for both in every]
        for every in (simulated(1.0, (0, 1)), simulated(0.0, (0,)))
    )
    # Share without depth; deviation [m] at 1.5-2, 2.5-3 and 3-4 m: whole image, then inside.
    low = [[0.10, 0.008, 0.008, 0.010], [0.04, 0.004, 0.006, 0.008]]
    high = [[0.17, 0.033, 0.034, 0.045], [0.11, 0.016, 0.024, 0.043]]
    got = np.nanmedian(measured, axis=0)[:, :4]
    assert (got >= low).all() and (got <= high).all()
    assert (np.nanmedian(clean, axis=0)[:, 1:4] < np.array(low)[:, 1:]).all()
    assert 0 <= np.nanmax(measured, axis=0)[0, 4] < 0.107
