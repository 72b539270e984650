"""``jaxdet sim``: a simulated log with its truth beside it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.spinner import SPINNER
from jaxdet.cli.tell import tell
from jaxdet.errors import ConfigError, InputError
from jaxdet.sim import SimConfig

DESCRIPTION = """\
Simulates a robot with a depth camera and writes a ROS 2 log (MCAP), with the truth beside it as
PATH.truth.npz, for jaxdet run --truth PATH. More scenes (rooms, ramps, moving): --help-all.

Example:
  jaxdet sim sim.mcap --scene demo --frames 60
"""


COMMON = tuple(
    f"sim.{name}"
    for name in (
        *("scene", "frames", "seed", "rate_hz", "width", "height", "depth_form", "compression"),
        *("camera_height_m", "camera_pitch_rad", "camera_roll_rad", "depth_error", "light"),
    )
)
"""What ``--help`` shows of the simulator's settings."""


@dataclass(frozen=True)
class SimCommand:
    """What ``jaxdet sim`` takes."""

    path: Path = field(metadata={"positional": True, "takes": "PATH"})
    """The log to write, for instance sim.mcap."""
    sim: SimConfig = field(default_factory=SimConfig, metadata={"short": True})
    overwrite: bool = False
    """Replace the log when it is there."""
    quiet: bool = False
    """Say nothing but errors."""


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    command = parse_flags(SimCommand, args, "jaxdet sim", DESCRIPTION, COMMON)
    if command.path.exists() and not command.overwrite:
        remedy = "give --overwrite to replace it"
        raise ConfigError("there is a file already", path=str(command.path), remedy=remedy)
    try:
        with SPINNER.shown("simulating; the first time it is compiled"):
            from jaxdet.engine import start_up
            from jaxdet.sim import truth_path, write_log

            start_up()
            place = command.path.parent
            place.mkdir(parents=True, exist_ok=True)
            with TemporaryDirectory(prefix=".jaxdet-sim-", dir=place) as folder:
                log = Path(folder) / command.path.name
                truth = write_log(log, command.sim, _progress(command.sim.frames))
                truth_path(log).replace(truth_path(command.path))
                log.replace(command.path)
    except OSError as error:
        reason = f"can't be written ({error.strerror})"
        raise InputError(reason, path=str(command.path)) from error
    if not command.quiet:
        objects = int((~truth.is_wall).sum())
        tell(f"{command.path}: {len(truth.stamp_ns)} frames, {objects} obstacles")
        tell(f"{truth_path(command.path)}: the truth")
    return 0


def _progress(frames: int) -> Callable[[int], None]:
    """Shows how many frames of all are written."""

    def show(done: int) -> None:
        SPINNER.text = f"simulating, {done} of {frames} frames"

    return show
