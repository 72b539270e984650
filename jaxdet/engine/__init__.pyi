__all__ = [
    "GroundRecord",
    "Observer",
    "Planes",
    "Progress",
    "ProgressCallback",
    "RunOptions",
    "Runner",
    "decide_planes",
    "run",
    "run_one",
    "start_up",
    "use_caches",
]

from .floors import GroundRecord, Planes, decide_planes
from .runner import Runner, run, run_one
from .settings import Observer, Progress, ProgressCallback, RunOptions
from .startup import start_up, use_caches
