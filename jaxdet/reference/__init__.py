"""The specification: the five stages in plain NumPy, one file each.

Written to be read and checked, not to be fast. :mod:`jaxdet.stages` has the same five functions
and returns equal arrays. Obstacles made of surfaces are found by :func:`detect`, as one.
"""

from jaxdet.reference._align import align
from jaxdet.reference._cells import cells
from jaxdet.reference._cluster import cluster
from jaxdet.reference._detect import detect, surface_pairs
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
    "footprint",
    "ground",
    "surface_pairs",
]
