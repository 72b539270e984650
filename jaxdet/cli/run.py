"""``jaxdet run``: logs in, a results folder out."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import summary_lines
from jaxdet.cli.settings import defaults, given
from jaxdet.cli.spinner import SPINNER
from jaxdet.config import (
    ClusterConfig,
    Config,
    FeaturesConfig,
    FloorConfig,
    FootprintConfig,
    GroundConfig,
    ObstacleConfig,
    SurfaceConfig,
)
from jaxdet.engine.options import Flag, RunOptions
from jaxdet.io.options import LogOptions
from jaxdet.presets import DEFAULT_PRESET

DESCRIPTION = """\
Finds the obstacles in every frame of logs and writes frames.parquet, obstacles.parquet,
config.json, summary.json, pictures and a map of each log.

Examples:
  jaxdet run drive.mcap --output results
  jaxdet run bags/ --output results --preset d435 --config mine.toml --ground.step-height-m 0.03
  jaxdet run drive.mcap --output results --ground.camera-height-m 0.3 --ground.camera-pitch 10deg
  jaxdet run drive.mcap --output again --config results/config.json

A value comes from the flag, else from the file of --config (section [ground], key max_depth_m),
else from the preset. M are metres, S seconds, ANGLE is a number with its unit: 10deg or 0.17rad.
"""

COMMON = (
    "run",
    "ground.camera_height_m",
    "ground.camera_pitch_rad",
    "ground.camera_roll_rad",
    "ground.max_depth_m",
    "ground.step_height_m",
    "obstacle.min_size_m",
    "log.color",
    "log.depth",
    "log.color_from_depth",
)
"""What ``--help`` shows of the settings."""


@dataclass(frozen=True)
class RunCommand:
    """What ``jaxdet run`` takes."""

    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG...")]
    """MCAP, .bag or .db3 files, folders of them or of images, or globs; the split files of one
    recording are one log."""
    run: Annotated[RunOptions, tyro.conf.arg(name="")]
    preset: str = DEFAULT_PRESET
    """Configuration to start from: wheeled, tabletop, paper, d435, d455, oak-d, zed, azure-kinect,
    orbbec. wheeled is for robots on wheels, tabletop for a camera over a table; paper has clusters
    of corners; the others are wheeled with the depth range of a camera."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file with sections as below, or the config.json of earlier results."""
    truth: Annotated[Path | None, tyro.conf.arg(metavar="LOG")] = None
    """A simulated log whose truth the results are compared with."""
    tracks: Flag = False
    """Link the obstacles over time when all logs are done, as jaxdet track does."""
    quiet: Flag = False
    """Say nothing but errors."""
    json: Flag = False
    """Print the summary as JSON on standard output, and nothing else there."""
    ground: GroundConfig = field(default_factory=GroundConfig)
    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    cluster: ClusterConfig = field(default_factory=ClusterConfig)
    footprint: FootprintConfig = field(default_factory=FootprintConfig)
    floor: FloorConfig = field(default_factory=FloorConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    obstacle: ObstacleConfig = field(default_factory=ObstacleConfig)
    log: LogOptions = field(default_factory=LogOptions)


def parse(args: list[str]) -> RunCommand:
    """The command with preset, TOML file and flags resolved, in that order."""
    config, log, name = defaults(args)
    missing: Any = tyro.MISSING
    start = RunCommand(
        logs=missing,
        run=RunOptions(missing),
        preset=name,
        ground=config.ground,
        features=config.features,
        cluster=config.cluster,
        footprint=config.footprint,
        floor=config.floor,
        surface=config.surface,
        obstacle=config.obstacle,
        log=log,
    )
    return parse_flags(start, args, "jaxdet run", DESCRIPTION, COMMON)


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    SPINNER.stop()  # whatever is said of the arguments
    command = parse(args)
    if not (command.quiet or command.json):
        SPINNER.start("loading")
    from jaxdet.cli.progress import reporting
    from jaxdet.engine import run
    from jaxdet.io import find_logs
    from jaxdet.results.summary import to_json

    logs = find_logs(given(command.logs))
    config = Config(
        ground=command.ground,
        features=command.features,
        cluster=command.cluster,
        footprint=command.footprint,
        floor=command.floor,
        surface=command.surface,
        obstacle=command.obstacle,
    )
    observers = {}
    if command.truth:
        from jaxdet.cli.truth import TruthScore  # which loads the simulator

        observers["score"] = TruthScore(command.truth, config)
    silent = command.quiet or command.json
    with reporting(silent) as progress:
        how = config, command.log, command.run, progress, observers, command.preset
        summary = run(logs, *how, say=(lambda text: None) if silent else _say)
    if command.json:
        print(to_json(summary.to_dict()), end="")
    elif not command.quiet:
        print("\n".join(summary_lines(summary, command.run.output)))
    if command.tracks and len(summary.failed) < len(summary.logs):
        from jaxdet.cli.track import track_lines
        from jaxdet.tracks import track_results

        found = track_results(command.run.output)
        if not silent:
            print("\n".join(track_lines(found)))
    errors = [log.error for log in summary.failed]
    errors += [log.unusable for log in summary.whole if log.unusable]
    errors += [lost for log in summary.whole for lost in log.lost]
    for error in errors:
        print(f"jaxdet: error: {error}", file=sys.stderr)
    return 1 if errors else 0


def _say(text: str) -> None:
    SPINNER.stop()
    print(f"jaxdet: {text}", file=sys.stderr, flush=True)
