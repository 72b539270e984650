"""``jaxdet sim``: simulates a log with its ground truth."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.terminal import SPINNER, tell
from jaxdet.errors import ConfigError, InputError
from jaxdet.sim import SimConfig

DESCRIPTION = """\
Simulates a robot with a depth camera and writes a ROS 2 log (MCAP), with its ground truth in
PATH.truth.npz, for jaxdet run --truth PATH. --help-all lists more scenes.

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
"""Settings of the simulator listed by ``--help``."""


@dataclass(frozen=True)
class SimCommand:
    """Arguments of ``jaxdet sim``."""

    path: Path = field(metadata={"positional": True, "takes": "PATH"})
    """Log to write, for instance sim.mcap."""
    sim: SimConfig = field(default_factory=SimConfig, metadata={"short": True})
    overwrite: bool = False
    """Replace the log if it exists."""
    quiet: bool = False
    """Print errors only."""


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    command = parse_flags(SimCommand, args, "jaxdet sim", DESCRIPTION, COMMON)
    if command.path.exists() and not command.overwrite:
        remedy = "pass --overwrite to replace it"
        raise ConfigError("the file exists already", path=str(command.path), remedy=remedy)
    try:
        with SPINNER.shown("simulating; the first run compiles the kernels"):
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
        tell(f"{truth_path(command.path)}: ground truth")
    return 0


def _progress(frames: int) -> Callable[[int], None]:
    """Return a callback that shows the number of frames written."""

    def show(done: int) -> None:
        SPINNER.text = f"simulating, {done} of {frames} frames"

    return show
