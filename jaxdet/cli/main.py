"""Entry point of the command line: calls a command and converts errors to exit codes."""

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from io import TextIOWrapper
from tempfile import NamedTemporaryFile

import jaxdet
from jaxdet.cli.terminal import SPINNER, tell
from jaxdet.errors import ConfigError, Interrupted, JaxdetError, meant, printable
from jaxdet.results.versions import crash_report
from jaxdet.signals import stops_raised

COMMANDS = {
    "run": "find the obstacles in every frame of logs; write tables and pictures",
    "track": "link obstacles over time: trajectories, speeds, which objects move",
    "export": "convert results for other programs: foxglove, ros2, nav2, html, ...",
    "verify": "check results: every file, frame and table, and a sample against the reference",
    "diff": "compare two runs on the same logs, as a table and as pictures side by side",
    "info": "describe a log, and what a run would use of it and why",
    "config": "write all parameters with comments, as a file for run --config",
    "sim": "simulate a log with known obstacles",
    "help": "show a page of the documentation; without a name, list all pages",
    "doctor": "check this installation: versions, devices, agreement of the backends",
}

HELP = """\
usage: jaxdet COMMAND [ARGUMENTS]

Finds obstacles in recorded logs of depth cameras: MCAP, ROS bags, folders of images.

commands:
{commands}

examples:
  jaxdet info drive.mcap                       contents of the log
  jaxdet run drive.mcap --output results       obstacles in every frame
  jaxdet export results --to html --output report.html    an HTML report
  jaxdet sim sim.mcap                          a simulated log for a first try
  jaxdet run --help                            options of run; --help-all lists all
  jaxdet help calibration                      how the calibration is found or passed

options:
  -h, --help   this text
  --version    the version

tab completion, in the start-up file of bash, zsh (after compinit), fish:
  eval "$(jaxdet complete bash)"
  eval "$(jaxdet complete zsh)"
  jaxdet complete fish | source

exit codes: 0 success, 1 some inputs failed, 2 usage error, 130 interrupted (143 by SIGTERM)
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: Arguments; by default those of the process.

    Returns:
        0 on success, 1 if some inputs failed, 2 for a usage error, 130 if interrupted.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        # escape characters that the terminal or pipe can't encode
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with stops_raised():  # so that partly written output is removed
            return _guarded(_do, args)
    except Interrupted as stop:  # the signal arrived while an error was being reported
        return _fail(str(stop), 128 + stop.signal)
    finally:
        SPINNER.stop()


def _do(args: list[str]) -> int:
    """Run the command named by the first argument."""
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
        return _fail(f"unknown command {args[0]!r}; {remedy}", 2)
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
        # for example a full disk
        return _fail(f"{error.filename or 'input or output'}: {error.strerror or error}", 1)
    except SystemExit as exit:
        return exit.code if isinstance(exit.code, int) else int(exit.code is not None)


def _reported(error: Exception) -> str:
    """Write a crash report to a file; return an error message that names it."""
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
