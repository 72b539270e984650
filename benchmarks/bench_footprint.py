"""Stage 5, footprint, against the reference."""

import jax

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, inputs
from jaxdet import reference, stages


def cases() -> list[Case]:
    """One batch of labelled features on the device."""
    given = inputs("640x480")
    plane, unit = given.plane, given.calibration.depth_unit
    features, labels = jax.device_put((given.features, given.labels))
    return [
        Case(
            name=f"b{BATCH}",
            run=lambda: stages.footprint(features, labels, plane, unit, CONFIG),
            frames=BATCH,
            peer=lambda: reference.footprint(given.features, given.labels, plane, unit, CONFIG),
            equal=True,
        )
    ]
