"""Logs of depth cameras: recordings to arrays, and arrays to files.

``find_logs`` turns what the user names into logs, ``open_log`` finds in one what its index and
first messages tell, and :class:`Log` gives its frames in batches. The names are loaded when they
are used, so that the options alone cost no import of a decoder.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.errors import RescanError
    from jaxdet.io.description import LogDescription
    from jaxdet.io.files import LogFiles, find_logs
    from jaxdet.io.log import Batch, Log, open_log
    from jaxdet.io.log_frame import LogFrame
    from jaxdet.io.notes import Notes
    from jaxdet.io.options import LogOptions

_MODULES = {
    "Batch": "io.log",
    "Log": "io.log",
    "LogDescription": "io.description",
    "LogFiles": "io.files",
    "LogFrame": "io.log_frame",
    "LogOptions": "io.options",
    "Notes": "io.notes",
    "RescanError": "errors",
    "find_logs": "io.files",
    "open_log": "io.log",
}
__all__ = [
    "Batch",
    "Log",
    "LogDescription",
    "LogFiles",
    "LogFrame",
    "LogOptions",
    "Notes",
    "RescanError",
    "find_logs",
    "open_log",
]


def __getattr__(name: str) -> Any:
    """Loads a public name with its module."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"jaxdet.{_MODULES[name]}"), name)
