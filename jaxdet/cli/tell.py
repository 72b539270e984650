"""Lines for people, on standard error; loads nothing."""

import os
import sys
from contextlib import suppress


def on_terminal() -> bool:
    """Whether standard error is a terminal on which lines can be written anew."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def tell(text: str) -> None:
    """Write a line to stderr, ignoring write errors."""
    with suppress(OSError):  # nobody reads it, or its disk is full: what the command does goes on
        print(text, file=sys.stderr, flush=True)
