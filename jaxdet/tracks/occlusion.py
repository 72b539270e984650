"""Hidden sides of objects: which sides are occluded, and where they are expected."""

import numpy as np

from jaxdet.tracks.observations import Observations
from jaxdet.tracks.pairs import pairs_in_frames

TOUCHES = 0.015
"""Maximum gap in the image between an object and a possible occluder [image widths]."""
NARROWER = 0.3
"""Quantile of the unoccluded widths that is taken as an object's width, since outlines merged with
another object are wider."""


def mark_hidden_sides(obs: Observations) -> Observations:
    """Mark the sides that a nearer object hides, i.e. overlaps or touches in the image."""
    a, b = pairs_in_frames(obs.frame)
    a, b = np.append(a, b), np.append(b, a)
    nearer = obs.distance_m[b] < obs.distance_m[a]
    a, b = a[nearer], b[nearer]
    one, other = obs.columns[a], obs.columns[b]
    hidden = obs.hidden.copy()
    left = (other[:, 0] < one[:, 0]) & (other[:, 1] > one[:, 0] - TOUCHES)
    right = (other[:, 1] > one[:, 1]) & (other[:, 0] < one[:, 1] + TOUCHES)
    hidden[a[left], 0] = True
    hidden[a[right], 1] = True
    return obs._replace(hidden=hidden)


def hidden_shift(obs: Observations, track: np.ndarray, count: int) -> np.ndarray:
    """Compute the shift from the centre of the visible part to the centre of the complete outline.

    The width of an object across the view is measured where both sides are visible, and assumed
    elsewhere, but at most twice the visible width. If both sides are hidden, there is no shift.

    Args:
        obs: ``N`` observations.
        track: Track indices from 0, ``(N,)`` int64.
        count: Number of tracks.

    Returns:
        Shifts ``(N, 2)`` float64 [m].
    """
    sides = obs.hidden.sum(axis=1)
    shown = obs.across_m[:, 1] - obs.across_m[:, 0]
    order = np.lexsort((shown, sides > 0, track))  # unoccluded ones first
    first = np.searchsorted(track[order], np.arange(count))
    whole = np.bincount(track[sides == 0], minlength=count)
    narrow = shown[order][first + (whole * NARROWER).astype(np.int64)]
    usual = np.where(whole > 2, narrow, 0.0)[track]
    missing = np.clip(usual - shown, 0.0, shown) / 2
    direction = obs.hidden[:, 1].astype(np.float64) - obs.hidden[:, 0]
    return (missing * direction)[:, None] * obs.rightwards
