"""Entry point of ``jaxdet`` and ``python -m jaxdet``."""

import os
import sys
from contextlib import suppress
from typing import NoReturn

from jaxdet.signals import end_guard, guard_process


def command() -> NoReturn:
    """Run the command, then exit immediately.

    All files are complete by then, and the regular shutdown of JAX, CUDA and Warp takes a second or
    two.
    """
    guard_process()
    from jaxdet.cli import main  # after guard_process(), as it takes long

    _open_streams()
    code = main(sys.argv[1:])
    end_guard()
    _remove_temporary()
    try:
        sys.stdout.flush()
    except OSError:  # the pipe is closed, or the disk is full
        code = code or 1
    with suppress(OSError):  # a closed stderr is not an error
        sys.stderr.flush()
    os._exit(code)


def _open_streams() -> None:
    """Redirect closed standard streams to the null device, before a file gets their descriptor."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


def _remove_temporary() -> None:
    """Remove the fork server's socket folder, as Python does at exit."""
    if used := sys.modules.get("multiprocessing.util"):
        used._run_finalizers()


if __name__ == "__main__":
    command()
