"""Runs the pipeline over whole logs and writes the results."""

from jaxdet.engine.loop import Progress, ProgressCallback, RunOptions, run
from jaxdet.engine.planes import GroundRecord, Planes, decide_planes
from jaxdet.engine.summary import LogSummary, Summary, plain, versions

__all__ = [
    "GroundRecord",
    "LogSummary",
    "Planes",
    "Progress",
    "ProgressCallback",
    "RunOptions",
    "Summary",
    "decide_planes",
    "plain",
    "run",
    "versions",
]
