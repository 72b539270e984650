"""Reference implementation (specification) in plain NumPy, one file per step.

It is written to be read and checked, not to be fast. :func:`detect` is the complete method;
:mod:`jaxdet.stages` returns equal arrays.
"""

from jaxdet.reference._align import align
from jaxdet.reference._cells import cells
from jaxdet.reference._cluster import cluster
from jaxdet.reference._detect import detect, find_floors, surface_pairs
from jaxdet.reference._features import features
from jaxdet.reference._floor import FloorFit, find_floor
from jaxdet.reference._footprint import footprint
from jaxdet.reference._ground import ground

__all__ = [
    "FloorFit",
    "align",
    "cells",
    "cluster",
    "detect",
    "features",
    "find_floor",
    "find_floors",
    "footprint",
    "ground",
    "surface_pairs",
]
