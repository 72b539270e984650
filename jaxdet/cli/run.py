"""``jaxdet run``: detects obstacles in logs and writes a folder of results."""

import logging
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from jaxdet.cli.flags import parse_flags, read_defaults
from jaxdet.cli.fleet import FleetOptions, run_on_machines
from jaxdet.cli.report import summary_lines
from jaxdet.cli.terminal import LOGGER, SPINNER, show_log, tell
from jaxdet.config import Config
from jaxdet.engine.settings import RunOptions
from jaxdet.errors import ConfigError, Interrupted
from jaxdet.fleet.place import is_url
from jaxdet.io.options import LogOptions
from jaxdet.presets import DEFAULT_PRESET

if TYPE_CHECKING:
    from jaxdet.engine.startup import Caches
    from jaxdet.results.summary import Summary

DESCRIPTION = """\
Finds the obstacles in every frame of logs and writes a folder per log with tables, pictures and a
map. Finished logs are skipped: the same command resumes an interrupted run.

Examples:
  jaxdet run drive.mcap --output results
  jaxdet run bags/ --output results --preset d435 --config mine.toml --ground.step-height-m 0.03
  jaxdet run drive.mcap --output results --ground.camera-height-m 0.3 --ground.camera-pitch 10deg

Flags override the file of --config (section [ground], key max_depth_m), which overrides the
preset. M is in metres, S in seconds; ANGLE is a number with its unit: 10deg or 0.17rad.
"""

COMMON = (
    "run",
    "fleet.on",
    "fleet.share",
    "ground.camera_height_m",
    "ground.camera_pitch_rad",
    "ground.camera_roll_rad",
    "ground.max_depth_m",
    "ground.step_height_m",
    "ground.max_height_m",
    "obstacle.min_size_m",
    "log.color",
    "log.depth",
)
"""Settings listed by ``--help``."""
GROUPS = {
    "input": (
        "--camera",
        "--start",
        "--stop",
        "--every",
        "--log.color",
        "--log.depth",
        "--join",
    ),
    "floor": (
        "--ground.camera-height-m",
        "--ground.camera-pitch",
        "--ground.camera-roll",
    ),
    "what counts": (
        "--preset",
        "--config",
        "--ground.max-depth-m",
        "--ground.step-height-m",
        "--ground.max-height-m",
        "--obstacle.min-size-m",
    ),
    "output": (
        "--output",
        "--pictures",
        "--map",
        "--tracks",
        "--truth",
        "--overwrite",
        "--update",
        "--verbose",
        "--debug",
        "--quiet",
        "--json",
    ),
    "machine": ("--backend", "--batch-size", "--workers", "--memory", "--on", "--share"),
}
"""Flags by heading of ``--help``."""


@dataclass(frozen=True)
class RunCommand:
    """Arguments of ``jaxdet run``."""

    logs: tuple[str, ...] = field(metadata={"positional": True, "takes": "LOG..."})
    """MCAP, .bag or .db3 files, folders of such files or of images, globs, or s3://BUCKET/PATH."""
    output: Path = field(metadata={"takes": "DIR"})
    """Folder or s3://BUCKET/PATH for the results, one subfolder per log."""
    run: RunOptions = field(default_factory=RunOptions, metadata={"short": True})
    fleet: FleetOptions = field(default_factory=FleetOptions, metadata={"short": True})
    preset: str = DEFAULT_PRESET
    """Initial configuration: wheeled, tabletop, paper, d435, d455, oak-d, zed, azure-kinect,
    orbbec. wheeled is for wheeled robots, tabletop for a camera above a table, paper detects
    clusters of corner features. Each of the others is wheeled with the depth range of the camera it
    is named after."""
    config: Path | None = field(default=None, metadata={"takes": "FILE"})
    """TOML file with sections as below, or the config.json of results."""
    truth: Path | None = field(default=None, metadata={"takes": "TRUTH"})
    """Compare with the truth of a simulated log, or with labelled boxes; see jaxdet help tuning.
    Boxes are read from a JSON file (COCO or a list)."""
    join: bool = True
    """Join split files into one log per recording."""
    tracks: bool = False
    """Link obstacles over time, as jaxdet track does."""
    verbose: bool = False
    """Report each finished log. Level INFO of Python's logging."""
    debug: bool = False
    """Report each step of each log. Level DEBUG of Python's logging."""
    quiet: bool = False
    """Print errors only."""
    json: bool = False
    """Print the summary as JSON on standard output, and nothing else there."""
    method: Config = field(default_factory=Config, metadata={"short": True})
    log: LogOptions = field(default_factory=LogOptions)


def parse(args: list[str]) -> RunCommand:
    """Parse the arguments; they override the TOML file, which overrides the preset."""
    config, log, name = read_defaults(args)
    start = {"preset": name, "method": config, "log": log}
    return parse_flags(RunCommand, args, "jaxdet run", DESCRIPTION, COMMON, start, GROUPS)


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    SPINNER.stop()  # before errors about the arguments are printed
    command = parse(args)
    show_log(_level(command))
    if not (command.quiet or command.json):
        SPINNER.start("loading")
    return _run(command)


def _level(command: RunCommand) -> int:
    """Return the minimum level of the log records that are shown."""
    if command.quiet or command.json:
        return logging.ERROR
    return logging.DEBUG if command.debug else logging.INFO if command.verbose else logging.WARNING


def _run(command: RunCommand) -> int:
    """Process the logs; return the exit code."""
    from jaxdet.engine.startup import cache_folders, start_cuda

    options, fleet = command.run, command.fleet
    if fleet.on or fleet.share or any(map(is_url, [*command.logs, command.output])):
        return _run_on_machines(command)
    if options.backend == "jax":
        start_cuda()
    from jaxdet.cli.progress import reporting
    from jaxdet.engine import Runner
    from jaxdet.io import find_logs
    from jaxdet.results.json_files import to_json

    logs = find_logs(command.logs, join=command.join)
    observers = {}
    if command.truth:
        from jaxdet.cli.truth import score_against  # imports the simulator

        observers["score"] = score_against(command.truth, command.method, len(logs))
    silent = command.quiet or command.json
    if options.backend == "jax" and not silent and (text := first_time(cache_folders())):
        LOGGER.warning("%s", text)
        SPINNER.start("loading")
    with reporting(silent) as progress, Runner(**vars(options)) as runner:
        summary = runner.run(
            logs,
            command.output,
            command.method,
            log=command.log,
            progress=progress,
            observers=observers,
            preset=command.preset,
        )
    if command.json:
        print(to_json(summary.to_dict()), end="")
    elif not command.quiet:
        every = command.verbose or command.debug
        print("\n".join(summary_lines(summary, command.output, every=every)))
    code = _exit_code(summary, updated=options.update)
    if command.tracks and summary.whole:
        _link(command)
    return code


def _run_on_machines(command: RunCommand) -> int:
    """Process the logs with :mod:`jaxdet.fleet`: from buckets, on a cluster, or a share of them."""
    from jaxdet.results.json_files import plain

    if command.truth:
        remedy = "run without --on, --share and bucket addresses"
        raise ConfigError("--truth needs local logs", remedy=remedy)
    how = {"config": plain(command.method), "log": plain(command.log)}
    how |= {"preset": command.preset, "tracks": command.tracks}
    shown = {"quiet": command.quiet, "as_json": command.json}
    where = command.output, command.run, command.fleet
    return run_on_machines(command.logs, *where, how, join=command.join, **shown)


def first_time(caches: "Caches") -> str:
    """Return a note that kernels are compiled first, or can't be cached; else an empty string."""
    from jaxdet.engine.startup import NOT_KEPT, UNSAFE, is_writable, unsafe_caches

    folder = caches.jax
    if unsafe := unsafe_caches():
        place = f"; {folder} is used instead" if folder else ""
        return f"{unsafe[0]} {UNSAFE}{place}"
    if folder is None:
        return ""
    if not is_writable(folder):
        return (
            "kernels are compiled in this run (up to half a minute), and not cached: "
            f"{folder} {NOT_KEPT}"
        )
    if any(folder.iterdir()):
        return ""
    return f"compiling kernels for this machine (up to half a minute, once); cached in {folder}"


def _exit_code(summary: "Summary", *, updated: bool) -> int:
    """Report the problems of a run; return the exit code."""
    from jaxdet.results.summary import problems

    errors = problems(summary.to_dict())
    for error in errors:
        tell(f"jaxdet: error: {error}")
    again = any(log.error or log.lost for log in summary.logs if log.log in summary.kept)
    if again and not updated:
        tell("jaxdet: pass --update to process failed and incomplete logs again")
    return 1 if errors else 0


def _link(command: RunCommand) -> None:
    """Link the obstacles of logs without tracks, and print a summary."""
    from jaxdet.cli.track import track_lines
    from jaxdet.tracks import track_results

    try:
        found = track_results(command.output, missing=True)
    except KeyboardInterrupt as stop:
        text = "interrupted while linking; run the same command again to resume"
        raise Interrupted(getattr(stop, "signal", signal.SIGINT), text) from None
    if not (command.quiet or command.json):
        print("\n".join(track_lines(found)))
