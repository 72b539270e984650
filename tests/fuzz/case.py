"""Fuzz cases and their verdicts, for all subjects."""

import time
import traceback
import warnings
from collections.abc import Callable
from typing import NamedTuple, Protocol

from jaxdet.errors import JaxdetError

MOST_S = 10.0
"""Maximum CPU time of a case, summed over all threads [s]; unlike wall time it is independent of
other processes."""
FAILURES = {
    "wrong pixels",
    "silently lost",
    "wrong results",
    "crash",
    "hang",
    "bad message",
    "swallowed",
    "denied",
}


class Verdict(NamedTuple):
    """Verdict on a case: how it ended."""

    kind: str
    """``clean``, ``error``, another acceptable end, or one of :data:`FAILURES`."""
    text: str = ""

    @property
    def failed(self) -> bool:
        """Whether the case is a failure."""
        return self.kind in FAILURES


class Case(NamedTuple):
    """A random input and its verdict."""

    title: str
    verdict: Verdict
    files: dict[str, bytes]
    """Contents of the files that are kept if the case fails, by file name."""


class Subject(Protocol):
    """A part of jaxdet that is fuzzed with an input for each seed."""

    def one(self, seed: int) -> Case:
        """Process the input of a seed."""
        ...


def ended(
    function: Callable[[], Verdict], allowed: tuple[type[Exception], ...] = (JaxdetError,)
) -> Verdict:
    """Call a function; return its verdict, or one on its exception or on too much CPU time."""
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # users would see such warnings
            verdict = function()
    except allowed as error:
        verdict = Verdict("error" if str(error).isprintable() else "bad message", str(error))
    except Exception as error:
        verdict = Verdict("crash", "".join(traceback.format_exception(error)))
    seconds = time.process_time() - start
    return Verdict("hang", f"{seconds:.1f} s; {verdict}") if seconds > MOST_S else verdict
