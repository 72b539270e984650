"""Says that a process which works alone makes no progress; workers are ended then, see the pool."""

import threading
from collections.abc import Callable

_LOOKS = 20
"""So many in the time that is allowed."""


class Watch:
    """Calls a function, in a thread, once for each time that nothing is heard for long.

    A context manager. Time in which this process was stopped, or the machine asleep, is not
    counted.

    Args:
        limit_s: How long [s].
        late: The function.
    """

    def __init__(self, limit_s: float, late: Callable[[], None]) -> None:
        self._look_s, self._late = limit_s / _LOOKS, late
        self._looks = 0
        """Since something was heard."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="jaxdet-watch", daemon=True)

    def alive(self) -> None:
        """There is progress."""
        self._looks = 0

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def _watch(self) -> None:
        while not self._ended.wait(self._look_s):
            self._looks += 1
            if self._looks == _LOOKS:
                self._late()
