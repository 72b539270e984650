__all__ = ["check_kernels", "detect", "detect_on_cpu", "find_floors", "paper"]

from . import paper
from ._check import check_kernels
from ._detect import detect
from ._on_cpu import detect_on_cpu, find_floors
