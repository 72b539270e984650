"""JAX and Warp implementation of the functions of :mod:`jaxdet.reference`, on batches."""

from jaxdet.stages._align import align
from jaxdet.stages._check import check_kernels
from jaxdet.stages._cluster import cluster
from jaxdet.stages._detect import detect, find_floors
from jaxdet.stages._features import features
from jaxdet.stages._footprint import footprint
from jaxdet.stages._ground import ground

__all__ = [
    "align",
    "check_kernels",
    "cluster",
    "detect",
    "features",
    "find_floors",
    "footprint",
    "ground",
]
