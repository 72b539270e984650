"""Free floor claimed: how much of the floor that can be driven on lies inside outlines."""

from typing import NamedTuple

from benchmarks.paper.shots import Shot
from benchmarks.paper.systems import eval_config
from jaxdet import reference
from jaxdet.config import Config
from jaxdet.eval import claimed_floor, floor_positions, measured_floor
from jaxdet.types import Calibration, Detections


class Claim(NamedTuple):
    """Pixels of one frame."""

    drivable: int
    """That show floor to drive on, measured and within range."""
    claimed: int
    """Of those, inside the rectangle of some obstacle."""

    @property
    def share(self) -> float:
        """Claimed of drivable; 0 where no such floor is seen."""
        return self.claimed / self.drivable if self.drivable else 0.0


def claim_of(shot: Shot, found: Detections, config: Config) -> Claim:
    """The drivable floor of a frame that its outlines claim.

    Args:
        shot: The frame.
        found: ``B = 1``.
        config: For the range and the outlines' margin.

    Returns:
        The pixels that :func:`jaxdet.eval.claimed_floor` counts.
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
