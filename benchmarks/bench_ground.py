"""Stage 2, ground, against the reference."""

import jax

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, Inputs, inputs, repeated
from benchmarks.sweep import Point
from jaxdet import reference, stages


def cases() -> list[Case]:
    """The keep mask, aligned depth on the device; no other library has this step."""
    given = inputs("640x480")
    return [
        _case("vs_reference", given, BATCH)._replace(
            peer=lambda: reference.ground(given.aligned, given.plane, given.calibration, CONFIG),
            equal=True,
        )
    ]


def at(point: Point) -> Case:
    """Aligned depth on the device."""
    case = _case(point.name, inputs(point.size), point.batch)
    depth = inputs(point.size).aligned.z
    return case._replace(bytes_read=depth[0].nbytes * point.batch)


def _case(name: str, given: Inputs, batch: int) -> Case:
    aligned, plane = repeated((given.aligned, given.plane), batch)
    aligned = jax.device_put(aligned)
    return Case(
        name=name,
        run=lambda: stages.ground(aligned, plane, given.calibration, CONFIG),
        frames=batch,
    )
