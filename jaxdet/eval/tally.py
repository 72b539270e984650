"""What is counted in a frame; the counts of frames add up, so a run can stream."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np


class Case(NamedTuple):
    """One obstacle asked for in one frame; NaN where it was not found or the truth says nothing."""

    number: int
    """The object's number in the pictures of the truth."""
    distance_m: float
    """True distance of its nearest face, forward in the ground frame [m]."""
    found: bool
    position_error_m: float
    """Forward coordinate of its detection's point C minus ``distance_m`` [m]."""
    width_error_m: float
    """Width of its detection (right coordinate of B minus that of A) minus the width of its
    visible surface [m]."""
    iou: float
    """Overlap of its detection's rectangle with the true footprint."""
    nearest_error_m: float
    """Distance of its detection (:func:`jaxdet.results.metric.distances`, the column
    ``distance_m``) minus the true one, ``FrameTruth.nearest_floor_m`` [m]."""


class Tally(NamedTuple):
    """Counts that add up over frames, batches and logs."""

    frames: int = 0
    visible: int = 0
    """Obstacles asked for, each frame anew."""
    found: int = 0
    """Of those, the ones matched to a detection: true positives."""
    detections: int = 0
    matched: int = 0
    """Detections matched to an obstacle, asked for or not."""
    false: int = 0
    """Detections that are matched to none and not ignored: false positives."""
    ignored: int = 0
    """Detections on walls or on obstacles that are not asked for: neither right nor wrong."""
    on_floor: int = 0
    """False detections with most votes for the floor or nothing."""
    on_wall: int = 0
    """Ignored detections, those on walls."""
    splits: int = 0
    """False detections that could match an obstacle which a better one has."""
    merges: int = 0
    """Obstacles beyond the first that are part of one detection."""
    points: int = 0
    """Kept features that lie on no wall."""
    points_right: int = 0
    """Of those, the ones on an obstacle with the label of its matched detection, and the ones on
    the floor or nothing without a label."""
    pairs_both: int = 0
    """Pairs of these points together in a detection and on one obstacle."""
    pairs_detected: int = 0
    """Pairs together in a detection."""
    pairs_true: int = 0
    """Pairs together on an obstacle."""
    fmi_sum: float = 0.0
    """Sum of the frames' Fowlkes-Mallows indices."""
    fmi_frames: int = 0
    """Frames that have one."""
    silhouette_sum: float = 0.0
    davies_bouldin_sum: float = 0.0
    index_frames: int = 0
    """Frames with two detections or more, so with internal indices."""
    near_points: int = 0
    """Points on the visible side of the footprints of obstacles found."""
    near_covered: int = 0
    """Of those, the ones in the rectangle of the obstacle's detection."""
    near_asked: int = 0
    """The same points, of all obstacles asked for."""
    near_safe: int = 0
    """Of those, the ones in any rectangle."""
    floor_pixels: int = 0
    floor_pixels_kept: int = 0
    obstacle_pixels: int = 0
    obstacle_pixels_kept: int = 0
    drivable_pixels: int = 0
    """Pixels of floor to drive on, near and measured as floor."""
    drivable_claimed: int = 0
    """Of those, the ones inside of an outline."""
    cases: tuple[Case, ...] = ()
    claims: tuple[float, ...] = ()
    """The shares of such pixels inside of an outline, of each frame that has enough of them."""

    @property
    def counts(self) -> tuple[float, ...]:
        """All fields but the cases and the claims."""
        return tuple(getattr(self, name) for name in COUNTS)

    def to_dict(self) -> dict[str, float]:
        """The counts by name."""
        return dict(zip(COUNTS, self.counts, strict=True))


COUNTS = Tally._fields[:-2]
"""The names of the counts, in order."""


def total(tallies: Iterable[Tally]) -> Tally:
    """All tallies as one."""
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
    """Counts what the ground stage keeps of the floor and of obstacles.

    A pixel takes part when it has a measured depth and the truth has a surface there. It is floor
    when no object is there, and obstacle when it shows an object that is no wall at a true height
    above the step. What lies lower on an object may be kept or not.

    Args:
        mask: ``(..., H, W)`` bool, kept pixels.
        z_m: ``(..., H, W)`` measured depth, 0 where there is none or it is out of range [m].
        truth_id: ``(..., H, W)`` integer, object numbers, 0 = floor or nothing.
        truth_height_m: ``(..., H, W)`` true height above the floor, NaN where nothing is [m].
        is_wall: ``(J,)`` bool.
        step_height_m: What the wheels can climb [m].

    Returns:
        A tally with the four numbers of pixels; :func:`jaxdet.eval.score` gives the shares.
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
