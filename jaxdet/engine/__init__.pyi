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
from .options import RunOptions
from .progress import Progress, ProgressCallback
from .runner import Runner, run
from .settings import Observer
from .single_log import run_one
from .startup import start_up, use_caches
