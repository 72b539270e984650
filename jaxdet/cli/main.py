"""Which command is meant, and how each ending becomes an exit code."""

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from io import TextIOWrapper
from tempfile import NamedTemporaryFile

import jaxdet
from jaxdet.cli.spinner import SPINNER
from jaxdet.cli.tell import tell
from jaxdet.errors import ConfigError, Interrupted, JaxdetError, meant, printable
from jaxdet.results.versions import crash_report
from jaxdet.signals import stops_raised

COMMANDS = {
    "run": "find the obstacles in every frame of logs, and write tables and pictures",
    "track": "link the obstacles of results over time: paths, speeds, what moves",
    "export": "write results for other programs, or as a page: foxglove, ros2, html ...",
    "verify": "check results: every file, frame and table, and a sample against the reference",
    "diff": "compare two runs on the same logs, as a table and as pictures side by side",
    "info": "say what is in a log, and what would be used of it and why",
    "config": "write all parameters with their meaning, as a file for run --config",
    "sim": "simulate a log with known obstacles",
    "help": "show a page: logs, calibration, tuning, recipes, ...; without a name their list",
    "doctor": "check this installation: versions, devices, and a small comparison",
}

HELP = """\
usage: jaxdet COMMAND [ARGUMENTS]

Finds obstacles in recorded logs of depth cameras: MCAP, ROS bags, folders of images.

commands:
{commands}

examples:
  jaxdet info drive.mcap                       what the log holds
  jaxdet run drive.mcap --output results       obstacles of every frame
  jaxdet export results --to html --output report.html    a page to look at
  jaxdet sim sim.mcap                          a simulated log to try it on
  jaxdet run --help                            its options; --help-all has every setting
  jaxdet help calibration                      how the camera's calibration is found or given

options:
  -h, --help   this text
  --version    the version

tab completion, in the start-up file of bash, zsh (after compinit), fish:
  eval "$(jaxdet complete bash)"
  eval "$(jaxdet complete zsh)"
  jaxdet complete fish | source

exit codes: 0 all fine, 1 some inputs failed, 2 bad usage, 130 interrupted (143 by SIGTERM)
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        argv: The arguments; by default those of this process.

    Returns:
        0 all fine, 1 some inputs failed, 2 bad usage, 130 interrupted.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # whatever a terminal or a pipe can show
            stream.reconfigure(errors="backslashreplace")
    try:
        with stops_raised():  # so that what a command has begun to write is removed
            return _guarded(_do, args)
    except Interrupted as stop:  # while an error was reported
        return _fail(str(stop), 128 + stop.signal)
    finally:
        SPINNER.stop()


def _do(args: list[str]) -> int:
    """The command that the first argument names."""
    if not args or args[0] in ("-h", "--help"):
        lines = (f"  {name:<8} {text}" for name, text in COMMANDS.items())
        print(HELP.format(commands="\n".join(lines)), end="")
        return 0 if args else 2
    if args[0] in ("--version", "-V"):
        print(f"jaxdet {jaxdet.__version__}")
        return 0
    if args[0] not in (*COMMANDS, "complete"):
        near = meant(args[0], [*COMMANDS, "--version"])
        remedy = f"{near}use one of {', '.join(COMMANDS)}, see jaxdet --help"
        return _fail(f"no command {args[0]!r}; {remedy}", 2)
    silent = {"-h", "--help", "--help-all", "-q", "--quiet", "--json"}
    if args[0] == "run" and not silent & set(args):
        SPINNER.start("loading")
    command: Callable[[list[str]], int] = import_module(f"jaxdet.cli.{args[0]}").main
    return command(args[1:])


def _guarded(command: Callable[[list[str]], int], args: list[str]) -> int:
    try:
        return command(args)
    except ConfigError as error:
        return _fail(str(error), 2)
    except JaxdetError as error:
        return _fail(str(error), 1)
    except Interrupted as stop:
        return _fail(str(stop), 128 + stop.signal)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if not isinstance(error, OSError):
            return _fail(_reported(error), 1)
        # a full or failing disk
        return _fail(f"{error.filename or 'input or output'}: {error.strerror or error}", 1)
    except SystemExit as exit:
        return exit.code if isinstance(exit.code, int) else int(exit.code is not None)


def _reported(error: Exception) -> str:
    """A line about an error of our own, and a file with the rest."""
    kind = type(error).__name__
    try:
        with NamedTemporaryFile(
            "w", prefix="jaxdet-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(crash_report(error))
    except OSError:
        return f"an error in jaxdet itself ({kind}: {error})"
    return f"an error in jaxdet itself ({kind}); please report it with the file {file.name}"


def _fail(message: str, code: int) -> int:
    SPINNER.stop()
    tell(f"jaxdet: error: {printable(' '.join(message.split()))}")
    return code
