"""The logger ``jaxdet`` shown as lines on standard error."""

import logging

from jaxdet.cli.spinner import SPINNER
from jaxdet.cli.tell import tell
from jaxdet.errors import printable

LOGGER = logging.getLogger("jaxdet")


class _Lines(logging.Handler):
    """Writes a line for each record."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write the line."""
        SPINNER.stop()
        tell(f"jaxdet: {printable(record.getMessage())}")


def show_log(level: int) -> None:
    """Show the records from a level on."""
    LOGGER.setLevel(level)
    if not any(isinstance(handler, _Lines) for handler in LOGGER.handlers):
        LOGGER.addHandler(_Lines())
