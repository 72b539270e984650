"""What goes on before anything can be shown; loads nothing."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from jaxdet.cli.tell import on_terminal

_FRAMES = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
_EVERY_S = 0.1
_ERASE = "\r\x1b[2K"


class Spinner:
    """A line on standard error, where that is a terminal, until :meth:`stop`."""

    def __init__(self) -> None:
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self.text = ""
        """What it shows; may change meanwhile."""

    def start(self, text: str) -> None:
        """Shows the text."""
        self.stop()
        self.text = text
        if on_terminal():
            self._stopped.clear()
            self._thread = threading.Thread(target=self._turn, daemon=True)
            self._thread.start()

    @contextmanager
    def shown(self, text: str) -> Iterator[None]:
        """Shows the text while something is done that says nothing."""
        self.start(text)
        try:
            yield
        finally:
            self.stop()

    def stop(self) -> None:
        """Takes the line away."""
        if self._thread is not None:
            self._stopped.set()
            self._thread.join()
            self._thread = None

    def _turn(self) -> None:
        number = 0
        with suppress(OSError):  # the terminal is gone
            while True:
                sys.stderr.write(f"{_ERASE}{_FRAMES[number % len(_FRAMES)]} {self.text}")
                sys.stderr.flush()
                number += 1
                if self._stopped.wait(_EVERY_S):
                    break
            sys.stderr.write(_ERASE)
            sys.stderr.flush()


SPINNER = Spinner()
"""There is one terminal."""
