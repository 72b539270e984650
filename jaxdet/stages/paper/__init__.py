"""JAX and Warp implementation of :mod:`jaxdet.reference.paper`, on batches.

Alignment and corners are Warp kernels; floor removal, sorting, cluster labels and outlines are
array programs of segmented scans in JAX.
"""

from jaxdet.stages.paper._align import align
from jaxdet.stages.paper._cluster import cluster
from jaxdet.stages.paper._detect import detect
from jaxdet.stages.paper._features import features
from jaxdet.stages.paper._footprint import footprint
from jaxdet.stages.paper._ground import ground

__all__ = ["align", "cluster", "detect", "features", "footprint", "ground"]
