"""Lines for the user on standard error; imports no heavy package."""

import os
import sys
from contextlib import suppress


def on_terminal() -> bool:
    """Return whether standard error is a terminal that can overwrite lines."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def tell(text: str) -> None:
    """Write a line to stderr, ignoring write errors."""
    with suppress(OSError):  # a closed or full stderr must not stop the command
        print(text, file=sys.stderr, flush=True)
