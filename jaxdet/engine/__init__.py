"""Runs the method over logs and writes a folder of results for each.

A run goes one way, each module calling those below it::

    runner, single_log          arguments; worker processes that outlive a run
    settings                    what all logs of the run share, and its record
    scheduler, output           which logs are done, in which order, and where results go
    resources, memory           how many processes and frames fit in memory
    process_log, log_per_worker a log, from its files to its folder: by this process, or by a worker
    executors, plan, floors     the plan of a log and who works on its units
    pool, worker, tasks         processes that do units or logs, and what happens if one dies
    unit, device                a unit of frames: read, compute, make rows
    device_server, device_queue, shared_slots   with GPUs: this process computes for all workers
    unit_result                 results of units, joined in the order of the frames

Names are loaded when they are used, so that options alone cost no import of JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.engine.floors import GroundRecord, Planes, decide_planes
    from jaxdet.engine.options import RunOptions
    from jaxdet.engine.plan import Observer
    from jaxdet.engine.progress import Progress, ProgressCallback
    from jaxdet.engine.runner import Runner, run
    from jaxdet.engine.single_log import run_one
    from jaxdet.engine.startup import start_up, use_caches

_MODULES = {
    "GroundRecord": "engine.floors",
    "Observer": "engine.plan",
    "Planes": "engine.floors",
    "Progress": "engine.progress",
    "ProgressCallback": "engine.progress",
    "RunOptions": "engine.options",
    "Runner": "engine.runner",
    "decide_planes": "engine.floors",
    "run": "engine.runner",
    "run_one": "engine.single_log",
    "start_up": "engine.startup",
    "use_caches": "engine.startup",
}
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


def __getattr__(name: str) -> Any:
    """Loads a public name with its module."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"jaxdet.{_MODULES[name]}"), name)
