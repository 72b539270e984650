"""Logs of depth cameras: MCAP files to arrays, and arrays to files.

``find_logs`` turns what the user names into logs, ``open_log`` finds everything in one but its
images, and :class:`Log` gives these in batches.
"""

from jaxdet.io.description import LogDescription
from jaxdet.io.files import LogFiles, find_logs
from jaxdet.io.log import Batch, Log, open_log
from jaxdet.io.options import LogOptions

__all__ = [
    "Batch",
    "Log",
    "LogDescription",
    "LogFiles",
    "LogOptions",
    "find_logs",
    "open_log",
]
