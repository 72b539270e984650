"""``jaxdet export``: converts results to the formats of other programs."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.terminal import SPINNER, tell
from jaxdet.errors import ConfigError
from jaxdet.export import FORMATS

if TYPE_CHECKING:
    from jaxdet.export.nav2 import KnownMap
    from jaxdet.results.reading import Results

DESCRIPTION = """\
Converts the results of jaxdet run for another program.

{formats}

Examples:
  jaxdet export results --to foxglove --output scenes
  jaxdet export results --to rerun --output recordings --log drive.mcap
  jaxdet export results --to nav2 --output maps
  jaxdet export results --to nav2 --output maps --map building.yaml --clear
  jaxdet export results --to html --output report.html
"""

MOST_LINES = 12
"""Maximum number of warnings that are printed."""


@dataclass(frozen=True)
class ExportCommand:
    """Arguments of ``jaxdet export``."""

    results: Path = field(metadata={"positional": True, "takes": "RESULTS"})
    """Folder written by jaxdet run, or the folder of one log in it."""
    to: Literal["foxglove", "ros2", "nav2", "html", "rerun", "coco"]
    """Format, see above."""
    output: Path = field(metadata={"takes": "PATH"})
    """File or folder to write; must not exist yet."""
    log: tuple[str, ...] = field(default=(), metadata={"takes": "LOG..."})
    """The logs of the results, for formats that use them, see above."""
    map: Path | None = field(default=None, metadata={"takes": "FILE"})
    """YAML file of a map for nav2's map_server; nav2 adds the obstacles missing from it."""
    map_frame: str | None = field(default=None, metadata={"takes": "NAME"})
    """TF frame of the map; by default the world frame of the poses."""
    clear: bool = False
    """Clear cells of the map of --map that the cameras saw as free floor."""


def _format_lines() -> Iterator[str]:
    for name, form in FORMATS.items():
        yield f"  {name:<10}{form.writes}"
        if form.of_logs:
            yield f"  {'':<10}  with --log {form.of_logs}"


def _known_map(command: ExportCommand, results: "Results") -> "KnownMap | None":
    if command.map is None:
        if command.clear or command.map_frame:
            raise ConfigError("--clear and --map-frame need a map", remedy="pass it as --map FILE")
        return None
    from jaxdet.export.nav2 import KnownMap
    from jaxdet.results.map_file import read_map
    from jaxdet.tracks.folder import check_frame

    check_frame(results, command.map_frame)
    return KnownMap(read_map(command.map), command.clear)


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    description = DESCRIPTION.format(formats="\n".join(_format_lines()))
    command = parse_flags(ExportCommand, args, "jaxdet export", description)
    with SPINNER.shown("writing"):
        from jaxdet.export import export
        from jaxdet.export.recordings import find
        from jaxdet.results.reading import Results

        with Results(command.results) as results:
            recordings = find(results, command.log)
            known = _known_map(command, results)
            left_out = export(results, command.to, command.output, recordings, known)
            left_out += [f"{name} has results of another configuration" for name in results.stale]
    more = len(left_out) - MOST_LINES
    for line in left_out[:MOST_LINES] + ([f"and {more} more logs"] if more > 0 else []):
        tell(f"jaxdet: warning: {line}")
    tell(f"written: {command.output}")
    tell(f"to view it: {FORMATS[command.to].seen(command.output)}")
    return 0
