__all__ = ["check_kernels", "detect", "find_floors", "find_floors_on_cpu", "paper"]

from . import paper
from ._check import check_kernels
from ._detect import detect, find_floors
from ._floors import find_floors_on_cpu
