"""Lines, log records and an activity indicator on standard error; imports no heavy package."""

import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from jaxdet.errors import printable

LOGGER = logging.getLogger("jaxdet")
_FRAMES = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
_EVERY_S = 0.1
_ERASE = "\r\x1b[2K"


def on_terminal() -> bool:
    """Return whether standard error is a terminal that can overwrite lines."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def tell(text: str) -> None:
    """Write a line to stderr, ignoring write errors."""
    with suppress(OSError):  # a closed or full stderr must not stop the command
        print(text, file=sys.stderr, flush=True)


class Spinner:
    """A spinning character with a text on standard error, shown only on a terminal."""

    def __init__(self) -> None:
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self.text = ""
        """Text next to the character; may be changed at any time."""

    def start(self, text: str) -> None:
        """Show the text until :meth:`stop`."""
        self.stop()
        self.text = text
        if on_terminal():
            self._stopped.clear()
            self._thread = threading.Thread(target=self._turn, daemon=True)
            self._thread.start()

    @contextmanager
    def shown(self, text: str) -> Iterator[None]:
        """Show the text during the ``with`` block."""
        self.start(text)
        try:
            yield
        finally:
            self.stop()

    def stop(self) -> None:
        """Erase the line."""
        if self._thread is not None:
            self._stopped.set()
            self._thread.join()
            self._thread = None

    def _turn(self) -> None:
        number = 0
        with suppress(OSError):  # the terminal may be closed
            while True:
                sys.stderr.write(f"{_ERASE}{_FRAMES[number % len(_FRAMES)]} {self.text}")
                sys.stderr.flush()
                number += 1
                if self._stopped.wait(_EVERY_S):
                    break
            sys.stderr.write(_ERASE)
            sys.stderr.flush()


SPINNER = Spinner()
"""The only instance, since there is one terminal."""


class _Lines(logging.Handler):
    """Handler that writes one line per record."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record as a line."""
        SPINNER.stop()
        tell(f"jaxdet: {printable(record.getMessage())}")


def show_log(level: int) -> None:
    """Show log records of the given level and above."""
    LOGGER.setLevel(level)
    if not any(isinstance(handler, _Lines) for handler in LOGGER.handlers):
        LOGGER.addHandler(_Lines())
