"""Stage 2, ground, against the reference."""

import jax

from benchmarks.run import Case
from benchmarks.scene import BATCH, CALIBRATIONS, CONFIG, inputs
from jaxdet import reference, stages


def cases() -> list[Case]:
    """The keep mask at two sizes, aligned depth on the device."""
    return [_case(size) for size in CALIBRATIONS]


def _case(size: str) -> Case:
    given = inputs(size)
    aligned = jax.device_put(given.aligned)
    return Case(
        name=f"{size}.b{BATCH}",
        run=lambda: stages.ground(aligned, given.plane, given.calibration, CONFIG),
        frames=BATCH,
        peer=lambda: reference.ground(given.aligned, given.plane, given.calibration, CONFIG),
        equal=True,
        bytes_moved=given.aligned.z.nbytes + given.keep.mask.nbytes,
    )
