"""Runs the pipeline over whole logs and writes the results."""

from jaxdet.engine.ground import GroundRecord, Planes
from jaxdet.engine.loop import Progress, ProgressCallback, RunOptions, run
from jaxdet.engine.many import Workers
from jaxdet.engine.planes import decide_planes
from jaxdet.engine.startup import start_up, use_caches
from jaxdet.results.summary import LogSummary, Summary, plain, versions

__all__ = [
    "GroundRecord",
    "LogSummary",
    "Planes",
    "Progress",
    "ProgressCallback",
    "RunOptions",
    "Summary",
    "Workers",
    "decide_planes",
    "plain",
    "run",
    "start_up",
    "use_caches",
    "versions",
]
