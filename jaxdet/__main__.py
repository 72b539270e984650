"""``python -m jaxdet`` and ``jaxdet`` are the same command."""

import os
import sys
from contextlib import suppress
from typing import NoReturn

from jaxdet.signals import end_guard, guard_process


def command() -> NoReturn:
    """Run the command, and end the process at once.

    All files are whole when it returns, and what JAX, CUDA and Warp do to take themselves down
    takes a second or two.
    """
    guard_process()
    from jaxdet.cli import main  # guarded

    _open_streams()
    code = main(sys.argv[1:])
    end_guard()
    _remove_temporary()
    try:
        sys.stdout.flush()
    except OSError:  # whoever read it has gone, or the disk is full
        code = code or 1
    with suppress(OSError):  # progress and warnings that nobody reads cost nothing
        sys.stderr.flush()
    os._exit(code)


def _open_streams() -> None:
    """Make closed standard streams lead to the null device, before a file gets their number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


def _remove_temporary() -> None:
    """Remove the folder of the fork server's socket, as Python would at its end."""
    if used := sys.modules.get("multiprocessing.util"):
        used._run_finalizers()


if __name__ == "__main__":
    command()
