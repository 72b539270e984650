"""Track numbers, assigned once it is certain which chains of observations are tracks."""

from collections import deque
from collections.abc import Iterable

import numpy as np


class TrackIds:
    """Number the tracks of a log in the order of their first observations.

    A chain is identified by its first observation. It becomes a track when it has enough
    observations, and is dropped if it ends with fewer. Chains that are undecided or open are kept
    in memory.

    Args:
        min_observations: Minimum number of observations of a track.
    """

    def __init__(self, min_observations: int) -> None:
        self.min_observations, self.next = min_observations, 0
        self.ids: dict[int, int] = {}
        """Track number by chain, -1 for a chain that is not a track."""
        self._counts: dict[int, int] = {}
        """Number of observations of chains that are open or not numbered yet."""
        self._open: deque[int] = deque()
        """Chains without a track number, ascending."""
        self._rows: deque[np.ndarray] = deque()
        """Chains passed as ``obstacles`` to calls of :meth:`add` that are not taken yet."""
        self._taken = 0
        """Number of calls of :meth:`add` that are taken."""
        self._ended: deque[tuple[int, int]] = deque()
        """Pairs for ended chains: number of calls of :meth:`add` before the end, and chain."""

    def add(self, observed: np.ndarray, obstacles: np.ndarray) -> None:
        """Add the observations of the next frames.

        Args:
            observed: Chain of each observation, ``(N,)`` int64.
            obstacles: Chain of each obstacle of these frames, ``(M,)`` int64.
        """
        chains, counts = np.unique(observed, return_counts=True)
        for chain, count in zip(chains.tolist(), counts.tolist(), strict=True):
            if chain not in self._counts:
                self._open.append(chain)
            self._counts[chain] = self._counts.get(chain, 0) + count
        self._rows.append(obstacles)
        self._number()

    def join(self, chain: int, earlier: int) -> None:
        """Append a chain without a track number to an earlier one."""
        self._open.remove(chain)
        self._counts[earlier] += self._counts.pop(chain)
        for rows in self._rows:
            rows[rows == chain] = earlier

    def is_track(self, chain: int) -> bool:
        """Return whether a chain has enough observations."""
        return self._counts[chain] >= self.min_observations

    def end(self, chains: Iterable[int]) -> None:
        """End the given chains: they get no further observations."""
        for chain in chains:
            if not self.is_track(chain):
                self.ids[chain] = -1
            self._ended.append((self._taken + len(self._rows), chain))
        self._number()

    def take(self) -> list[np.ndarray]:
        """Return the track of each obstacle, ``(M,)`` int32, -1 = none, per call of :meth:`add`.

        The calls returned are those after the last :meth:`take` whose chains are all decided.
        """
        decided = []
        while self._rows and (not self._open or self._rows[0].max(initial=-1) < self._open[0]):
            rows = self._rows.popleft()
            chains, which = np.unique(rows, return_inverse=True)
            numbers = np.array([self.ids[chain] for chain in chains.tolist()], np.int32)
            decided.append(numbers[which])
            self._taken += 1
        while self._ended and self._ended[0][0] <= self._taken:
            chain = self._ended.popleft()[1]
            del self.ids[chain], self._counts[chain]
        return decided

    def _number(self) -> None:
        while self._open:
            chain = self._open[0]
            if chain not in self.ids:
                if not self.is_track(chain):
                    return
                self.ids[chain], self.next = self.next, self.next + 1
            self._open.popleft()
