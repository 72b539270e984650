__all__ = [
    "align",
    "check_kernels",
    "cluster",
    "detect",
    "detect_on_cpu",
    "features",
    "find_floors",
    "footprint",
    "ground",
]

from ._align import align
from ._check import check_kernels
from ._cluster import cluster
from ._detect import detect
from ._features import features
from ._footprint import footprint
from ._ground import ground
from ._on_cpu import detect_on_cpu, find_floors
