"""Runs the method over logs and writes a folder of results for each.

Each module calls those below it::

    runner, single_log           arguments of a run; worker processes that outlive it
    settings, options            configuration and options of a run, and their record in run.json
    scheduler, output            order of the logs; which are done already; where results go
    resources, memory            numbers of processes and frames that fit into memory
    process_log, log_per_worker  a log, from its files to its folder, in any process
    executors, plan, floors      floors and plan of a log, and the processes that do its units
    pool, worker, tasks          worker processes, which do tasks of a job: units of a log, or logs
    unit, unit_result            a unit: frames are read, computed and made into rows
    device                       where a batch is computed: in this process, or by the device server
    device_server, device_queue, shared_slots   the process with the GPUs, which serves all workers

A small log is done by one worker, a large one by all of them::

    scheduler > pool > worker > LogJob  > process_log > InProcess > UnitProcessor
    scheduler > process_log > InPool > pool > worker > UnitJob > UnitProcessor

Names are loaded on first use, so that options alone cost no import of JAX.
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
