"""Procedural models of the paper's obstacles, with random plausible dimensions.

A model stands on z = 0 at the origin, faces along x, and is built by ``builder(rng, phase)``;
``phase`` is the gait phase [rad], used only by walking people.
"""

from collections.abc import Callable

import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.sim.mesh import Mesh
from jaxdet.sim.models.cart import cart
from jaxdet.sim.models.furniture import chair, round_table, sofa, table
from jaxdet.sim.models.household import bag, bed, desk, office_chair, plant, rack
from jaxdet.sim.models.low import LOW_THINGS, low_thing
from jaxdet.sim.models.outdoors import street_light, tree_trunk
from jaxdet.sim.models.people import STRIDE_M, standing_person, walking_person
from jaxdet.sim.models.roadworks import barrier, cone
from jaxdet.sim.models.vehicle import vehicle
from jaxdet.sim.models.vessels import bin_with_lid, bucket, cable_drum

_BUILDERS: dict[str, Callable[[np.random.Generator, float], Mesh]] = {
    "person": standing_person,
    "walker": walking_person,
    "vehicle": vehicle,
    "barrier": barrier,
    "cone": cone,
    "bucket": bucket,
    "bin": bin_with_lid,
    "tree_trunk": tree_trunk,
    "street_light": street_light,
    "table": table,
    "chair": chair,
}
_LATER: dict[str, Callable[[np.random.Generator, float], Mesh]] = {
    "sofa": sofa,
    "round_table": round_table,
    "cable_drum": cable_drum,
    "cart": cart,
    "office_chair": office_chair,
    "desk": desk,
    "bed": bed,
    "rack": rack,
    "plant": plant,
    "bag": bag,
}
"""Models added later. They come after the low objects, as the index of a model is part of its
random seed."""

__all__ = ["KINDS", "LOW_THINGS", "STRIDE_M", "build_model"]

KINDS = (*_BUILDERS, *LOW_THINGS, *_LATER)
"""Names of the models."""


def build_model(kind: str, seed: int, phase: float = 0.0) -> Mesh:
    """Build a model.

    Args:
        kind: Name of the model.
        seed: Seed of its dimensions, colours and pose.
        phase: Gait phase [rad].

    Raises:
        ConfigError: The model is unknown.
    """
    if kind not in KINDS:
        raise ConfigError(f"unknown model {kind!r}", remedy=f"use {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    if kind in LOW_THINGS:
        return low_thing(kind, rng)
    return {**_BUILDERS, **_LATER}[kind](rng, phase)
