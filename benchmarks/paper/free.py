"""Claimed floor: share of the drivable floor that is inside outlines."""

from typing import NamedTuple

from benchmarks.paper.shots import Shot
from benchmarks.paper.systems import eval_config
from jaxdet import reference
from jaxdet.config import Config
from jaxdet.eval import claimed_floor, floor_positions, measured_floor
from jaxdet.types import Calibration, Detections


class Claim(NamedTuple):
    """Numbers of pixels of one frame."""

    drivable: int
    """Number of pixels that show drivable floor, are measured and in range."""
    claimed: int
    """Number of drivable pixels inside the rectangle of an obstacle."""

    @property
    def share(self) -> float:
        """Share of the drivable pixels that are claimed; 0 if there are none."""
        return self.claimed / self.drivable if self.drivable else 0.0


def claim_of(shot: Shot, found: Detections, config: Config) -> Claim:
    """Count the drivable floor of a frame, and how much of it the outlines claim.

    Args:
        shot: The frame.
        found: Detections of the frame.
        config: Configuration of the range and the outlines' margin.

    Returns:
        Numbers of pixels as counted by :func:`jaxdet.eval.claimed_floor`.
    """
    truth, calibration, counted = shot.truth, shot.calibration, eval_config(config)
    assert truth.drivable is not None and truth.depth_m is not None
    # Lengths of clustered points refer to the colour camera.
    lengths = Calibration(calibration.image) if config.cluster.points else calibration
    z_m = reference.paper.align(shot.depth[None], calibration).z * calibration.depth_unit
    place = floor_positions(truth.depth_m, truth.drivable, lengths, shot.T_world_color[None])
    floor = measured_floor(place, truth.depth_m, z_m, counted)
    tally = claimed_floor(found, floor, calibration.depth_unit, counted)[0]
    return Claim(int(tally.drivable_pixels), int(tally.drivable_claimed))
