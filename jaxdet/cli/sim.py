"""``jaxdet sim``: a simulated log with its truth beside it."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from jaxdet.cli.flags import parse_flags
from jaxdet.errors import InputError
from jaxdet.sim import SimConfig

DESCRIPTION = """\
Simulates a robot with a depth camera in a furnished room and writes a ROS 2 log (MCAP). The
truth goes beside it as PATH.truth.npz; jaxdet run --truth PATH compares with it.

Example:
  jaxdet sim sim.mcap --scene demo --frames 60
"""


@dataclass(frozen=True)
class SimCommand:
    """What ``jaxdet sim`` takes."""

    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PATH")]
    """The log to write, for instance sim.mcap; replaced when it is there."""
    sim: Annotated[SimConfig, tyro.conf.arg(name="")] = field(default_factory=SimConfig)
    quiet: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Say nothing but errors."""


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    missing: Any = tyro.MISSING
    command = parse_flags(SimCommand(missing), args, "jaxdet sim", DESCRIPTION)
    from jaxdet.engine import start_up
    from jaxdet.sim import truth_path, write_log

    start_up()
    try:
        command.path.parent.mkdir(parents=True, exist_ok=True)
        truth = write_log(command.path, command.sim)
    except OSError as error:
        reason = f"can't be written ({error.strerror})"
        raise InputError(reason, path=str(command.path)) from error
    if not command.quiet:
        objects = int((~truth.is_wall).sum())
        print(f"{command.path}: {len(truth.stamp_ns)} frames, {objects} obstacles", file=sys.stderr)
        print(f"{truth_path(command.path)}: the truth", file=sys.stderr)
    return 0
