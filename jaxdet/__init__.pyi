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

__version__: str

from .config import Config
from .detector import BatchResult, Detector, FrameResult, Obstacle
from .engine import Runner, run
from .errors import FrameStatus, JaxdetError
from .floor.mount import Mount
from .floor.plane import flat_plane
from .io import LogOptions, find_logs, open_log
from .pipeline import detect, estimate_plane, find_floors
from .presets import PRESETS, preset
from .results.metric import extents, rectangles, to_world
from .results.reading import Results, open_results
from .results.summary import LogSummary, Summary
from .types import (
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
