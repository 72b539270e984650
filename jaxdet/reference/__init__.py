"""Reference implementation (specification) in plain NumPy, one file per step.

It is written to be read and checked, not to be fast. :func:`detect` is the complete method;
:mod:`jaxdet.reference.paper` has the stages of the published one, the preset ``paper``.
:mod:`jaxdet.stages` returns equal arrays.
"""

from jaxdet.reference import paper
from jaxdet.reference._cells import cells
from jaxdet.reference._detect import detect, find_floors, surface_pairs
from jaxdet.reference._floor import FloorFit, find_floor

__all__ = ["FloorFit", "cells", "detect", "find_floor", "find_floors", "paper", "surface_pairs"]
