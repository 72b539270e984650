"""What may come of something hostile, whatever it is."""

import time
import traceback
import warnings
from collections.abc import Callable
from typing import NamedTuple, Protocol

from jaxdet.errors import JaxdetError

MOST_S = 10.0
"""Of all of the process's threads together, so that a busy machine makes no difference."""
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
    """What came of it."""

    kind: str
    """``clean``, ``error``, another word for what is right, or one of :data:`FAILURES`."""
    text: str = ""

    @property
    def failed(self) -> bool:
        """Whether it must not be so."""
        return self.kind in FAILURES


class Case(NamedTuple):
    """Something hostile that was tried."""

    title: str
    verdict: Verdict
    files: dict[str, bytes]
    """What is kept of a failure, by name."""


class Subject(Protocol):
    """What is tried again and again, with what a seed makes."""

    def one(self, seed: int) -> Case:
        """Tries what a seed makes."""
        ...


def ended(
    function: Callable[[], Verdict], allowed: tuple[type[Exception], ...] = (JaxdetError,)
) -> Verdict:
    """What comes of a function: its own verdict, a clean error, or a failure."""
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # a user would see it
            verdict = function()
    except allowed as error:
        verdict = Verdict("error" if str(error).isprintable() else "bad message", str(error))
    except Exception as error:
        verdict = Verdict("crash", "".join(traceback.format_exception(error)))
    seconds = time.process_time() - start
    return Verdict("hang", f"{seconds:.1f} s; {verdict}") if seconds > MOST_S else verdict
