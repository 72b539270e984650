"""Obstacle detection with RGB-D cameras: ``Detector`` for frames, ``run`` for logs.

Names are imported on first use, so that ``import jaxdet`` imports no heavy package.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxdet.config import Config
    from jaxdet.detector import BatchResult, Detector, FrameResult, Obstacle
    from jaxdet.engine import Runner, run
    from jaxdet.errors import FrameStatus, JaxdetError
    from jaxdet.floor.mount import Mount
    from jaxdet.floor.plane import flat_plane
    from jaxdet.io import LogOptions, find_logs, open_log
    from jaxdet.pipeline import detect, estimate_plane, find_floors
    from jaxdet.presets import PRESETS, preset
    from jaxdet.results.metric import extents, rectangles, to_world
    from jaxdet.results.reading import Results, open_results
    from jaxdet.results.summary import LogSummary, Summary
    from jaxdet.types import (
        Calibration,
        Detections,
        Distortion,
        Extrinsics,
        Features,
        Frames,
        GroundPlane,
        Intrinsics,
        Labels,
        Obstacles,
    )

__version__ = "0.1.0"

_HOMES = {
    "jaxdet.config": ("Config",),
    "jaxdet.presets": ("PRESETS", "preset"),
    "jaxdet.engine": ("Runner", "run"),
    "jaxdet.errors": ("FrameStatus", "JaxdetError"),
    "jaxdet.detector": ("BatchResult", "Detector", "FrameResult", "Obstacle"),
    "jaxdet.floor.mount": ("Mount",),
    "jaxdet.io": ("LogOptions", "find_logs", "open_log"),
    "jaxdet.results.metric": ("extents", "rectangles", "to_world"),
    "jaxdet.results.reading": ("Results", "open_results"),
    "jaxdet.results.summary": ("LogSummary", "Summary"),
    "jaxdet.pipeline": ("detect", "estimate_plane", "find_floors"),
    "jaxdet.floor.plane": ("flat_plane",),
    "jaxdet.types": (
        "Calibration",
        "Detections",
        "Distortion",
        "Extrinsics",
        "Features",
        "Frames",
        "GroundPlane",
        "Intrinsics",
        "Labels",
        "Obstacles",
    ),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "PRESETS",
    "BatchResult",
    "Calibration",
    "Config",
    "Detections",
    "Detector",
    "Distortion",
    "Extrinsics",
    "Features",
    "FrameResult",
    "FrameStatus",
    "Frames",
    "GroundPlane",
    "Intrinsics",
    "JaxdetError",
    "Labels",
    "LogOptions",
    "LogSummary",
    "Mount",
    "Obstacle",
    "Obstacles",
    "Results",
    "Runner",
    "Summary",
    "__version__",
    "detect",
    "estimate_plane",
    "extents",
    "find_floors",
    "find_logs",
    "flat_plane",
    "open_log",
    "open_results",
    "preset",
    "rectangles",
    "run",
    "to_world",
]


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'jaxdet' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return __all__
