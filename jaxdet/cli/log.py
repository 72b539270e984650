"""Output of the logger ``jaxdet`` as lines on standard error."""

import logging

from jaxdet.cli.spinner import SPINNER
from jaxdet.cli.tell import tell
from jaxdet.errors import printable

LOGGER = logging.getLogger("jaxdet")


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
