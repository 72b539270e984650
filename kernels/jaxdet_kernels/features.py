"""Stage features on CUDA: Canny edges and Shi-Tomasi corners of a batch of frames.

The bodies are CUDA, because they live from what Warp's language does not have: shared tiles, warp
votes and shuffles, and arithmetic that is fused here and not there. Each kernel says how many
threads its blocks have; launch a multiple of that.
"""

from jaxdet_kernels.features_candidates import (
    CANDIDATES_BLOCK,
    corners_check,
    corners_strongest,
)
from jaxdet_kernels.features_canny import (
    SUPPRESS_BLOCK,
    SUPPRESS_COLUMNS,
    SUPPRESS_ROWS,
    canny_suppress,
)
from jaxdet_kernels.features_corners import EIGENVALUE_BLOCK, corners_eigenvalue
from jaxdet_kernels.features_has_depth import ground_has_depth
from jaxdet_kernels.features_hysteresis import HYSTERESIS_BLOCK, canny_hysteresis
from jaxdet_kernels.features_lookup import LOOKUP_BLOCK, corners_lookup
from jaxdet_kernels.features_maxima import MAXIMA_BLOCK, corners_maxima
from jaxdet_kernels.features_select import SPREAD_BLOCK, corners_spread

__all__ = [
    "CANDIDATES_BLOCK",
    "EIGENVALUE_BLOCK",
    "HYSTERESIS_BLOCK",
    "LOOKUP_BLOCK",
    "MAXIMA_BLOCK",
    "SPREAD_BLOCK",
    "SUPPRESS_BLOCK",
    "SUPPRESS_COLUMNS",
    "SUPPRESS_ROWS",
    "canny_hysteresis",
    "canny_suppress",
    "corners_check",
    "corners_eigenvalue",
    "corners_lookup",
    "corners_maxima",
    "corners_spread",
    "corners_strongest",
    "ground_has_depth",
]
