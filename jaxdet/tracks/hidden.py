"""Sides of things that are out of sight: which they are, and where they would be seen."""

import numpy as np

from jaxdet.tracks.pairs import pairs_in_frames
from jaxdet.tracks.things import Things

TOUCHES = 0.015
"""What is no farther from a thing in the image may hide it [widths of the image]."""
NARROWER = 0.3
"""Share of a thing's whole outlines that are narrower than it is taken to be: those that hold
something else are wider."""


def hide_sides(things: Things) -> Things:
    """Marks the sides that something nearer hides: it begins or ends where the thing does."""
    a, b = pairs_in_frames(things.frame)
    a, b = np.append(a, b), np.append(b, a)
    nearer = things.distance_m[b] < things.distance_m[a]
    a, b = a[nearer], b[nearer]
    one, other = things.columns[a], things.columns[b]
    hidden = things.hidden.copy()
    left = (other[:, 0] < one[:, 0]) & (other[:, 1] > one[:, 0] - TOUCHES)
    right = (other[:, 1] > one[:, 1]) & (other[:, 0] < one[:, 1] + TOUCHES)
    hidden[a[left], 0] = True
    hidden[a[right], 1] = True
    return things._replace(hidden=hidden)


def unseen(things: Things, track: np.ndarray, count: int) -> np.ndarray:
    """How far the middles of outlines with a hidden side would be shifted, were they whole.

    A thing is as wide across the view as it usually is where both sides are seen, but at most
    twice as wide as what is seen of it. With both sides hidden it stays where it is.

    Args:
        things: ``N`` sightings.
        track: ``(N,)`` int64, the track of each, from 0.
        count: Of tracks.

    Returns:
        ``(N, 2)`` float64 [m].
    """
    sides = things.hidden.sum(axis=1)
    shown = things.across_m[:, 1] - things.across_m[:, 0]
    order = np.lexsort((shown, sides > 0, track))  # whole ones first
    first = np.searchsorted(track[order], np.arange(count))
    whole = np.bincount(track[sides == 0], minlength=count)
    narrow = shown[order][first + (whole * NARROWER).astype(np.int64)]
    usual = np.where(whole > 2, narrow, 0.0)[track]
    missing = np.clip(usual - shown, 0.0, shown) / 2
    way = things.hidden[:, 1].astype(np.float64) - things.hidden[:, 0]
    return (missing * way)[:, None] * things.rightwards
