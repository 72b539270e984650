"""Share of the drivable floor inside outlines of obstacles."""

from typing import NamedTuple

from benchmarks.paper.shots import Shot
from benchmarks.paper.systems import eval_config
from jaxdet import reference
from jaxdet.config import Config
from jaxdet.eval import claimed_floor, floor_positions, measured_floor
from jaxdet.types import Calibration, Detections


class Claim(NamedTuple):
    """Counts of pixels of a frame."""

    drivable: int
    """Pixels of drivable floor, measured and within range."""
    claimed: int
    """Those of them inside the rectangle of an obstacle."""

    @property
    def share(self) -> float:
        """Claimed divided by drivable pixels; 0 if no such floor is visible."""
        return self.claimed / self.drivable if self.drivable else 0.0


def claim_of(shot: Shot, found: Detections, config: Config) -> Claim:
    """Count the drivable floor of a frame inside outlines.

    Args:
        shot: Frame.
        found: Detections, ``B = 1``.
        config: Configuration with the range and the margin of outlines.

    Returns:
        The pixels that :func:`jaxdet.eval.claimed_floor` counts.
    """
    truth, calibration, counted = shot.truth, shot.calibration, eval_config(config)
    assert truth.drivable is not None and truth.depth_m is not None
    # Lengths of clustered points refer to the colour camera.
    lengths = Calibration(calibration.image) if config.cluster.points else calibration
    z_m = reference.align(shot.depth[None], calibration).z * calibration.depth_unit
    place = floor_positions(truth.depth_m, truth.drivable, lengths, shot.T_world_color[None])
    floor = measured_floor(place, truth.depth_m, z_m, counted)
    tally = claimed_floor(found, floor, calibration.depth_unit, counted)[0]
    return Claim(int(tally.drivable_pixels), int(tally.drivable_claimed))
