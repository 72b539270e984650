"""Stage 1, align, against the reference."""

from benchmarks.run import Case
from benchmarks.scene import BATCH, CALIBRATIONS, inputs
from jaxdet import reference, stages


def cases() -> list[Case]:
    """Depth to colour at two sizes; the depth images come from the host each time."""
    return [_case(size) for size in CALIBRATIONS]


def _case(size: str) -> Case:
    given = inputs(size)
    return Case(
        name=f"{size}.b{BATCH}",
        run=lambda: stages.align(given.depth, given.calibration),
        frames=BATCH,
        peer=lambda: reference.align(given.depth, given.calibration),
        equal=True,
        bytes_moved=given.depth.nbytes + given.aligned.depth.nbytes + given.aligned.z.nbytes,
    )
