"""The published method in plain NumPy (preset ``paper``), one file per stage.

Depth is aligned to colour at corners of the colour image; corners on the floor are removed, the
others are clustered by gaps in depth and then sideways, and the clusters are outlined on the floor.
"""

from jaxdet.reference.paper._align import align
from jaxdet.reference.paper._cluster import cluster
from jaxdet.reference.paper._detect import detect
from jaxdet.reference.paper._features import features
from jaxdet.reference.paper._footprint import footprint
from jaxdet.reference.paper._ground import ground

__all__ = ["align", "cluster", "detect", "features", "footprint", "ground"]
