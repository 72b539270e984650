"""Says that a process which works alone makes no progress; workers are ended then, see the pool."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_LOOKS = 20
"""So many in the time that is allowed."""


@contextmanager
def watched(limit_s: float, late: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """Calls a function, in a thread, once for each time that nothing is heard for long.

    Time in which this process was stopped, or the machine asleep, is not counted.

    Args:
        limit_s: How long [s].
        late: The function.

    Returns:
        What is to be called when there is progress.
    """
    heard, ended = threading.Event(), threading.Event()

    def watch() -> None:
        looks = 0  # since something was heard
        while not ended.wait(limit_s / _LOOKS):
            looks = 0 if heard.is_set() else looks + 1
            heard.clear()
            if looks == _LOOKS:
                late()

    threading.Thread(target=watch, name="jaxdet-watch", daemon=True).start()
    try:
        yield heard.set
    finally:
        ended.set()
