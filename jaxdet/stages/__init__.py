"""JAX and Warp implementation of the functions of :mod:`jaxdet.reference`, on batches.

Names are imported when they are used, so that :func:`find_floors_on_cpu` runs without JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.stages._align import align
    from jaxdet.stages._check import check_kernels
    from jaxdet.stages._cluster import cluster
    from jaxdet.stages._detect import detect, find_floors
    from jaxdet.stages._features import features
    from jaxdet.stages._floors import find_floors_on_cpu
    from jaxdet.stages._footprint import footprint
    from jaxdet.stages._ground import ground

_MODULES = {
    "align": "_align",
    "check_kernels": "_check",
    "cluster": "_cluster",
    "detect": "_detect",
    "features": "_features",
    "find_floors": "_detect",
    "find_floors_on_cpu": "_floors",
    "footprint": "_footprint",
    "ground": "_ground",
}
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


def __getattr__(name: str) -> Any:
    """Load a public name with its module."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"jaxdet.stages.{_MODULES[name]}"), name)
