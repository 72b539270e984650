"""``jaxdet track``: the obstacles of results linked over time."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import MANY_LOGS
from jaxdet.cli.spinner import SPINNER
from jaxdet.errors import ConfigError
from jaxdet.tracks.config import TrackConfig

if TYPE_CHECKING:
    from jaxdet.tracks import LogTracks

DESCRIPTION = """\
Links the obstacles of each log over time: in the world where the log has poses, else in the
camera's floor frame. Writes tracks.parquet (one row a track: path, speed, whether it moves),
track_links.parquet (the track of each row of obstacles.parquet, in its order) and a picture of
the map with the paths, into the folder of each log; tracks that are there are replaced.

Examples:
  jaxdet track results
  jaxdet track results --map building.yaml
"""


COMMON = tuple(f"track.{name}" for name in ("max_speed_mps", "max_gap_s", "min_frames", "moving_m"))
"""What ``--help`` shows of the settings."""


@dataclass(frozen=True)
class TrackCommand:
    """What ``jaxdet track`` takes."""

    results: Path = field(metadata={"positional": True, "takes": "RESULTS"})
    """Folder that jaxdet run wrote, or that of one log in it."""
    map: Path | None = field(default=None, metadata={"takes": "FILE"})
    """YAML file of a map for nav2's map_server: says which obstacles and tracks it has (in_map)."""
    map_frame: str | None = field(default=None, metadata={"takes": "NAME"})
    """Frame that the map is in; unset: the world that the poses are in."""
    track: TrackConfig = field(default_factory=TrackConfig, metadata={"short": True})
    quiet: bool = False
    """Say nothing but errors."""


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    command = parse_flags(TrackCommand, args, "jaxdet track", DESCRIPTION, COMMON)
    with SPINNER.shown("linking"):
        from jaxdet.results.map_file import read_map
        from jaxdet.tracks import track_results

        if command.map is None and command.map_frame:
            raise ConfigError("--map-frame is of a map", remedy="give it by --map")
        known = None if command.map is None else read_map(command.map)
        config, frame = command.track, command.map_frame
        found = track_results(command.results, config, known=known, frame=frame)
    if not command.quiet:
        print("\n".join(track_lines(found)))
    return 0


def track_lines(found: Sequence["LogTracks"]) -> list[str]:
    """Return what is said of the tracks: a line for each log, or one for many."""
    if len(found) > MANY_LOGS:
        tracks, moving = sum(log.tracks for log in found), sum(log.moving for log in found)
        linked, obstacles = sum(log.linked for log in found), sum(log.obstacles for log in found)
        text = f"{len(found)} logs: {tracks} tracks, {moving} moving"
        return [f"{text}; {linked} of {obstacles} obstacles are in one"]
    lines = []
    for log in found:
        blind = log.tracks - log.in_world
        which = "" if blind == log.tracks else f"{blind} of them "
        why = ", ".join(log.blind)
        where = f", {which}in the camera's frame ({why})" if blind else ""
        new = "" if log.new is None else f", {log.new} not in the map"
        lines.append(
            f"{log.log}: {log.tracks} tracks, {log.moving} moving{new}{where}; "
            f"{log.linked} of {log.obstacles} obstacles are in one"
        )
    return lines
