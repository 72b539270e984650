"""``jaxdet run``: logs in, a results folder out."""

import json
import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import summary_lines
from jaxdet.cli.settings import defaults, given
from jaxdet.cli.spinner import SPINNER
from jaxdet.cli.tell import tell
from jaxdet.config import Config
from jaxdet.engine.options import RunOptions
from jaxdet.errors import Interrupted, ResultsError
from jaxdet.io.options import LogOptions
from jaxdet.presets import DEFAULT_PRESET

if TYPE_CHECKING:
    from jaxdet.engine.startup import Caches

DESCRIPTION = """\
Finds the obstacles in every frame of logs and writes frames.parquet, obstacles.parquet,
config.json, summary.json, pictures and, where a log has poses, a map of it.

Examples:
  jaxdet run drive.mcap --output results
  jaxdet run bags/ --output results --preset d435 --config mine.toml --ground.step-height-m 0.03
  jaxdet run drive.mcap --output results --ground.camera-height-m 0.3 --ground.camera-pitch 10deg

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
    "ground.max_height_m",
    "obstacle.min_size_m",
    "log.color",
    "log.depth",
    "log.color_from_depth",
)
"""What ``--help`` shows of the settings."""


@dataclass(frozen=True)
class RunCommand:
    """What ``jaxdet run`` takes."""

    logs: tuple[str, ...] = field(metadata={"positional": True, "takes": "LOG..."})
    """MCAP, .bag or .db3 files, folders of them or of images, or globs; the split files of one
    recording are one log."""
    run: RunOptions = field(metadata={"short": True})
    preset: str = DEFAULT_PRESET
    """Configuration to start from: wheeled, tabletop, paper, d435, d455, oak-d, zed, azure-kinect,
    orbbec. wheeled is for robots on wheels, tabletop for a camera over a table; paper has clusters
    of corners; the others are wheeled with the depth range of a camera."""
    config: Path | None = field(default=None, metadata={"takes": "FILE"})
    """TOML file with sections as below, or the config.json of results."""
    truth: Path | None = field(default=None, metadata={"takes": "LOG"})
    """A simulated log whose truth the results are compared with."""
    tracks: bool = False
    """Link the obstacles over time, as jaxdet track does."""
    quiet: bool = False
    """Say nothing but errors."""
    json: bool = False
    """Print the summary as JSON on standard output, and nothing else there."""
    method: Config = field(default_factory=Config, metadata={"short": True})
    log: LogOptions = field(default_factory=LogOptions)


def parse(args: list[str]) -> RunCommand:
    """The command with preset, TOML file and flags resolved, in that order."""
    config, log, name = defaults(args)
    start = {"preset": name, "method": config, "log": log}
    return parse_flags(RunCommand, args, "jaxdet run", DESCRIPTION, COMMON, start)


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    SPINNER.stop()  # whatever is said of the arguments
    command = parse(args)
    if not (command.quiet or command.json):
        SPINNER.start("loading")
    try:
        return _run(command)
    except ResultsError as error:
        if not error.same:
            raise
        return _there(command)


def _run(command: RunCommand) -> int:
    """Makes the results."""
    from jaxdet.engine.startup import cache_folders, start_cuda

    if command.run.backend == "jax":
        start_cuda()
    from jaxdet.cli.progress import reporting
    from jaxdet.engine import run
    from jaxdet.io import find_logs
    from jaxdet.results.summary import to_json

    logs = find_logs(given(command.logs))
    observers = {}
    if command.truth:
        from jaxdet.cli.truth import TruthScore  # which loads the simulator

        observers["score"] = TruthScore(command.truth, command.method)
        observers["score"].check()
    silent = command.quiet or command.json
    if command.run.backend == "jax" and not silent and (text := first_time(cache_folders())):
        _say(text)
        SPINNER.start("loading")
    tracks = command.run.output / "tracks.parquet"
    had_tracks = tracks.exists()
    with reporting(silent) as progress:
        how = command.log, command.run, progress, observers, command.preset
        summary = run(logs, command.method, *how, say=(lambda text: None) if silent else _say)
    if command.json:
        print(to_json(summary.to_dict()), end="")
    elif not (command.quiet or command.run.share):
        print("\n".join(summary_lines(summary, command.run.output)))
    code = _exit_code(summary.to_dict())
    if command.tracks and summary.whole and not command.run.share:
        _link(command)
    elif had_tracks and not (tracks.exists() or silent):
        _say("tracks were of the old tables and are gone: jaxdet track makes them again")
    return code


def first_time(caches: "Caches") -> str:
    """Return what to say where no compiled programs are kept yet, or can't be; else nothing."""
    from jaxdet.engine.startup import NOT_KEPT, UNSAFE, is_writable, unsafe_caches

    folder = caches.jax
    if unsafe := unsafe_caches():
        place = f"; {folder} is used instead" if folder else ""
        return f"{unsafe[0]} {UNSAFE}{place}"
    if folder is None:
        return ""
    if not is_writable(folder):
        return f"this run compiles, up to half a minute, and keeps nothing: {folder} {NOT_KEPT}"
    if any(folder.iterdir()):
        return ""
    return f"the first run compiles for this machine, up to half a minute; kept in {folder}"


def _there(command: RunCommand) -> int:
    """The results that the command makes are there; whoever repeats it wants to know no more."""
    text = (command.run.output / "summary.json").read_text(encoding="utf-8")
    if command.json:
        print(text, end="")
    elif not command.quiet:
        _say(f"{command.run.output} holds the results of this command already")
    code = _exit_code(json.loads(text))
    again = any(log["error"] or log["lost"] for log in json.loads(text)["logs"])
    if again and not (command.run.update or command.run.parts):
        tell("jaxdet: --update does again what failed or was lost")
    if command.tracks:
        _link(command)
    return code


def _exit_code(told: Mapping[str, Any]) -> int:
    """Says what went wrong in a run, whose summary this is."""
    from jaxdet.results.summary import problems

    errors = problems(told)
    for error in errors:
        tell(f"jaxdet: error: {error}")
    return 1 if errors else 0


def _link(command: RunCommand) -> None:
    """Makes the tracks, if they are not there."""
    from jaxdet.cli.track import track_lines
    from jaxdet.tracks import track_results

    if (command.run.output / "tracks.parquet").exists():
        return
    try:
        found = track_results(command.run.output)
    except KeyboardInterrupt as stop:
        text = "interrupted while linking; the results are whole, and the same command goes on"
        raise Interrupted(getattr(stop, "signal", signal.SIGINT), text) from None
    if not (command.quiet or command.json):
        print("\n".join(track_lines(found)))


def _say(text: str) -> None:
    SPINNER.stop()
    tell(f"jaxdet: {text}")
