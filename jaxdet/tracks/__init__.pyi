__all__ = [
    "LogTracks",
    "Track",
    "TrackConfig",
    "Tracker",
    "track_results",
]

from .config import TrackConfig
from .folder import LogTracks, track_results
from .track import Track
from .tracker import Tracker
