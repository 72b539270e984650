"""Counts per frame, which can be added up while a run streams."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np


class Case(NamedTuple):
    """A required obstacle in a frame; values are NaN if it was missed or are unknown."""

    number: int
    """Number of the object in the ground truth images."""
    distance_m: float
    """True distance of the obstacle's nearest face, forward in the ground frame [m]."""
    found: bool
    """Whether a detection is matched to the obstacle."""
    position_error_m: float
    """Forward coordinate of point C of the detection minus ``distance_m`` [m]."""
    width_error_m: float
    """Width of the detection (right coordinate of B minus that of A) minus the width of the
    obstacle's visible surface [m]."""
    iou: float
    """Intersection over union of the detection's rectangle and the true footprint."""
    nearest_error_m: float
    """Distance of the detection (:func:`jaxdet.results.metric.distances`, the column
    ``distance_m``) minus the true distance, ``FrameTruth.nearest_floor_m`` [m]."""


class Tally(NamedTuple):
    """Counts, summed over frames, batches and logs."""

    frames: int = 0
    """Number of frames."""
    visible: int = 0
    """Required obstacles, counted per frame."""
    found: int = 0
    """True positives: required obstacles matched to a detection."""
    detections: int = 0
    """Number of detections."""
    matched: int = 0
    """Detections matched to an obstacle, required or not."""
    false: int = 0
    """False positives: detections that are neither matched nor ignored."""
    ignored: int = 0
    """Detections on walls or on obstacles that are not required."""
    on_floor: int = 0
    """False positives on the floor: at least half of their votes are for the floor or no object."""
    on_wall: int = 0
    """Ignored detections on walls."""
    splits: int = 0
    """False positives that could match an obstacle which is matched by a better detection."""
    merges: int = 0
    """Obstacles merged by detections: the first obstacle in each detection does not count."""
    points: int = 0
    """Kept points that are not on a wall."""
    points_right: int = 0
    """Number of correctly labelled points: points on an obstacle with the label of its matched
    detection, and points on the floor or on no object without a label."""
    pairs_both: int = 0
    """Pairs of ``points`` that share a detection and an obstacle."""
    pairs_detected: int = 0
    """Pairs of ``points`` that share a detection."""
    pairs_true: int = 0
    """Pairs of ``points`` that share an obstacle."""
    fmi_sum: float = 0.0
    """Sum of the frames' Fowlkes-Mallows indices."""
    fmi_frames: int = 0
    """Frames with a Fowlkes-Mallows index."""
    silhouette_sum: float = 0.0
    """Sum of the frames' silhouette coefficients."""
    davies_bouldin_sum: float = 0.0
    """Sum of the frames' Davies-Bouldin indices."""
    index_frames: int = 0
    """Frames with both of these indices, that is with at least two detections."""
    near_points: int = 0
    """Points on the visible side of the footprints of found obstacles."""
    near_covered: int = 0
    """Points of ``near_points`` in the rectangle of the obstacle's detection."""
    near_asked: int = 0
    """Points on the visible side of the footprints of all required obstacles."""
    near_safe: int = 0
    """Points of ``near_asked`` in any rectangle."""
    floor_pixels: int = 0
    """Pixels that show floor, see :func:`keep_shares`."""
    floor_pixels_kept: int = 0
    """Pixels of ``floor_pixels`` that the ground stage keeps."""
    obstacle_pixels: int = 0
    """Pixels that show obstacles above the step height, see :func:`keep_shares`."""
    obstacle_pixels_kept: int = 0
    """Pixels of ``obstacle_pixels`` that the ground stage keeps."""
    drivable_pixels: int = 0
    """Pixels of drivable floor that are in range and measured as floor."""
    drivable_claimed: int = 0
    """Pixels of ``drivable_pixels`` inside an outline."""
    cases: tuple[Case, ...] = ()
    """Required obstacles, one case per frame."""
    claims: tuple[float, ...] = ()
    """Fraction of ``drivable_pixels`` inside an outline, for each frame with enough pixels."""

    @property
    def counts(self) -> tuple[float, ...]:
        """All fields except ``cases`` and ``claims``."""
        return tuple(getattr(self, name) for name in COUNTS)

    def to_dict(self) -> dict[str, float]:
        """Return the counts by name."""
        return dict(zip(COUNTS, self.counts, strict=True))


COUNTS = Tally._fields[:-2]
"""Names of the counts, in order."""


def total(tallies: Iterable[Tally]) -> Tally:
    """Sum tallies."""
    every = list(tallies)
    if not every:
        return Tally()
    sums = [sum(numbers) for numbers in zip(*(one.counts for one in every), strict=True)]
    cases = tuple(case for one in every for case in one.cases)
    return Tally(*sums, cases=cases, claims=tuple(share for one in every for share in one.claims))


def keep_shares(
    mask: np.ndarray,
    z_m: np.ndarray,
    truth_id: np.ndarray,
    truth_height_m: np.ndarray,
    is_wall: np.ndarray,
    step_height_m: float = 0.05,
) -> Tally:
    """Count the pixels of floor and of obstacles that the ground stage keeps.

    Pixels with a measured depth and a true surface count: as floor if there is no object, as
    obstacle if they show an object other than a wall at a true height above the step. Lower parts
    of objects don't count.

    Args:
        mask: Kept pixels ``(..., H, W)`` bool.
        z_m: Measured depth ``(..., H, W)``, 0 = none or out of range [m].
        truth_id: Object numbers ``(..., H, W)`` integer, 0 = floor or nothing.
        truth_height_m: True height above the floor, ``(..., H, W)``, NaN without a surface [m].
        is_wall: Whether each object is a wall, ``(J,)`` bool.
        step_height_m: Height that the wheels can climb [m].

    Returns:
        A tally with the four numbers of pixels, for :func:`jaxdet.eval.score`.
    """
    seen = (z_m > 0) & np.isfinite(truth_height_m)
    solid = np.concatenate([[False], ~is_wall])[truth_id]
    floor = seen & (truth_id == 0)
    obstacle = seen & solid & (truth_height_m > step_height_m)
    return Tally(
        floor_pixels=int(floor.sum()),
        floor_pixels_kept=int((floor & mask).sum()),
        obstacle_pixels=int(obstacle.sum()),
        obstacle_pixels_kept=int((obstacle & mask).sum()),
    )
