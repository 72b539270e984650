__all__ = [
    "Batch",
    "Log",
    "LogDescription",
    "LogFiles",
    "LogFrame",
    "LogOptions",
    "Notes",
    "find_logs",
    "open_log",
]

from .batch import Batch, LogFrame
from .description import LogDescription
from .files import LogFiles, find_logs
from .log import Log
from .opening import open_log
from .options import LogOptions
from .timeline import Notes
