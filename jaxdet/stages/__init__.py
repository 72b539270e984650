"""The fast stages: the five functions of :mod:`jaxdet.reference` over batches, in JAX and Warp."""

from jaxdet.stages._align import align
from jaxdet.stages._align_points import align_points
from jaxdet.stages._cluster import cluster
from jaxdet.stages._features import features
from jaxdet.stages._footprint import footprint
from jaxdet.stages._ground import ground
from jaxdet.stages._programs import covers, detect

__all__ = [
    "align",
    "align_points",
    "cluster",
    "covers",
    "detect",
    "features",
    "footprint",
    "ground",
]
