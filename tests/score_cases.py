"""Ground truth and tallies that tests of scores share."""

import numpy as np

from jaxdet.eval import FrameTruth, Tally


def tallies(rows):
    """Return tallies of frames from their true positives, false positives and false negatives."""
    return [Tally(visible=tp + fn, found=tp, false=fp) for tp, fp, fn in rows]


def frame_truth():
    """Return a frame with three obstacles 0.3 m apart, the third 1 m behind, and a wall."""
    low = np.array([[[0, 1], [0.8, 1.05], [1.6, 2.0], [0.5, 1]]], float)
    outline = np.full((1, 4, 6, 2), np.nan)
    for j, (x, y) in enumerate(low[0]):
        outline[0, j, :4] = [[x, y], [x + 0.5, y], [x + 0.5, y + 0.2], [x, y + 0.2]]
    return FrameTruth(
        np.array([[[0, 1, 2, 3, 4]]]),
        np.array([[10, 20, 30, 40]]),
        low[..., 1].copy(),
        low[..., 1].copy(),
        np.array([False, False, False, True]),
        low,
        low + [0.5, 0.02],
        outline,
        np.array([[0.3, 0.6, 0.1, 2.0]]),
    )
