"""Tracking of the obstacles of a log. :func:`track_results` implements ``jaxdet track``."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.tracks.config import TrackConfig
    from jaxdet.tracks.folder import LogTracks, track_results
    from jaxdet.tracks.track import Track
    from jaxdet.tracks.tracker import Tracker

_HOMES = {
    "LogTracks": "folder",
    "Track": "track",
    "TrackConfig": "config",
    "Tracker": "tracker",
    "track_results": "folder",
}

__all__ = ["LogTracks", "Track", "TrackConfig", "Tracker", "track_results"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
