__all__ = [
    "align",
    "check_kernels",
    "cluster",
    "detect",
    "features",
    "find_floors",
    "find_floors_on_cpu",
    "footprint",
    "ground",
]

from ._align import align
from ._check import check_kernels
from ._cluster import cluster
from ._detect import detect, find_floors
from ._features import features
from ._floors import find_floors_on_cpu
from ._footprint import footprint
from ._ground import ground
