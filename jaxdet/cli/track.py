"""``jaxdet track``: links the obstacles of results over time."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import MANY_LOGS
from jaxdet.cli.terminal import SPINNER
from jaxdet.errors import ConfigError
from jaxdet.tracks.config import TrackConfig

if TYPE_CHECKING:
    from jaxdet.tracks import LogTracks

DESCRIPTION = """\
Links the obstacles of each log over time: in the world frame if the log has poses, else in the
camera's ground frame. Writes tracks.parquet (one row per track: path, speed, whether it moves),
track_links.parquet (the track of each row of obstacles.parquet, in the same order) and a picture of
the map with the paths into the folder of each log; existing tracks are replaced.

Examples:
  jaxdet track results
  jaxdet track results --map building.yaml
"""


COMMON = tuple(f"track.{name}" for name in ("max_speed_mps", "max_gap_s", "min_frames", "moving_m"))
"""Settings listed by ``--help``."""


@dataclass(frozen=True)
class TrackCommand:
    """Arguments of ``jaxdet track``."""

    results: Path = field(metadata={"positional": True, "takes": "RESULTS"})
    """Folder written by jaxdet run, or the folder of one log in it."""
    map: Path | None = field(default=None, metadata={"takes": "FILE"})
    """YAML file of a map for nav2's map_server. The column in_map marks obstacles and tracks in it.
    """
    map_frame: str | None = field(default=None, metadata={"takes": "NAME"})
    """TF frame of the map; by default the world frame of the poses."""
    track: TrackConfig = field(default_factory=TrackConfig, metadata={"short": True})
    quiet: bool = False
    """Print errors only."""


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    command = parse_flags(TrackCommand, args, "jaxdet track", DESCRIPTION, COMMON)
    with SPINNER.shown("linking"):
        from jaxdet.results.map_file import read_map
        from jaxdet.tracks import track_results

        if command.map is None and command.map_frame:
            raise ConfigError("--map-frame needs a map", remedy="pass it as --map FILE")
        known = None if command.map is None else read_map(command.map)
        config, frame = command.track, command.map_frame
        found = track_results(command.results, config, known=known, frame=frame)
    if not command.quiet:
        print("\n".join(track_lines(found)))
    return 0


def track_lines(found: Sequence["LogTracks"]) -> list[str]:
    """Return a line per log about its tracks, or one line for many logs."""
    if len(found) > MANY_LOGS:
        tracks, moving = sum(log.tracks for log in found), sum(log.moving for log in found)
        linked, obstacles = sum(log.linked for log in found), sum(log.obstacles for log in found)
        text = f"{len(found)} logs: {tracks} tracks, {moving} moving"
        return [f"{text}; {linked} of {obstacles} obstacles linked"]
    lines = []
    for log in found:
        blind = log.tracks - log.in_world
        which = "" if blind == log.tracks else f"{blind} of them "
        why = ", ".join(log.blind)
        where = f", {which}in the camera's frame ({why})" if blind else ""
        new = "" if log.new is None else f", {log.new} not in the map"
        lines.append(
            f"{log.log}: {log.tracks} tracks, {log.moving} moving{new}{where}; "
            f"{log.linked} of {log.obstacles} obstacles linked"
        )
    return lines
