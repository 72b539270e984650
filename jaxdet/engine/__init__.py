"""Runs the pipeline over whole logs and writes the results.

The names are loaded when they are used, so that options alone cost no import of JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.engine.floors import GroundRecord, Planes, decide_planes
    from jaxdet.engine.one_log import run_one
    from jaxdet.engine.options import RunOptions
    from jaxdet.engine.plan import Observer
    from jaxdet.engine.progress import Progress, ProgressCallback
    from jaxdet.engine.runner import Runner, run
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
    "run_one": "engine.one_log",
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
