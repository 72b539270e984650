"""Lines for people, on standard error; loads nothing."""

import sys
from contextlib import suppress


def tell(text: str) -> None:
    """Writes a line, if it can."""
    with suppress(OSError):  # nobody reads it, or its disk is full: what the command does goes on
        print(text, file=sys.stderr, flush=True)
