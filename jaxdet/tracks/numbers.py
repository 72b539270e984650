"""Numbers of tracks, given as soon as it is certain which chains of sightings are tracks."""

from collections import deque
from collections.abc import Iterable

import numpy as np


class Numbers:
    """Numbers the tracks of a log in the order of their first sightings.

    A chain is a track once it has enough sightings, and none if it ends with fewer; it is told by
    its first sighting. Keeps what has no number yet, and the chains that may go on.

    Args:
        least: A track has so many sightings.
    """

    def __init__(self, least: int) -> None:
        self.least, self.next = least, 0
        self.of: dict[int, int] = {}
        """The number of a chain, -1 where it is none."""
        self._seen: dict[int, int] = {}
        """Sightings of chains that may go on, or have no number yet."""
        self._open: deque[int] = deque()
        """Chains without a number, ascending."""
        self._rows: deque[np.ndarray] = deque()
        self._taken = 0
        self._ended: deque[tuple[int, int]] = deque()

    def add(self, things: np.ndarray, obstacles: np.ndarray) -> None:
        """Takes sightings in.

        Args:
            things: ``(N,)`` int64, the chain of each.
            obstacles: ``(M,)`` int64, the chain of each obstacle of these frames.
        """
        chains, counts = np.unique(things, return_counts=True)
        for chain, count in zip(chains.tolist(), counts.tolist(), strict=True):
            if chain not in self._seen:
                self._open.append(chain)
            self._seen[chain] = self._seen.get(chain, 0) + count
        self._rows.append(obstacles)
        self._number()

    def join(self, chain: int, earlier: int) -> None:
        """Makes a chain without a number, and all its sightings, part of an earlier one."""
        self._open.remove(chain)
        self._seen[earlier] += self._seen.pop(chain)
        for rows in self._rows:
            rows[rows == chain] = earlier

    def is_track(self, chain: int) -> bool:
        """Whether a chain has enough sightings."""
        return self._seen[chain] >= self.least

    def end(self, chains: Iterable[int]) -> None:
        """These have no more sightings than they have."""
        for chain in chains:
            if not self.is_track(chain):
                self.of[chain] = -1
            self._ended.append((self._taken + len(self._rows), chain))
        self._number()

    def take(self) -> list[np.ndarray]:
        """For each :meth:`add` that is decided, the track of each obstacle, int32, -1 for none."""
        found = []
        while self._rows and (not self._open or self._rows[0].max(initial=-1) < self._open[0]):
            rows = self._rows.popleft()
            chains, which = np.unique(rows, return_inverse=True)
            numbers = np.array([self.of[chain] for chain in chains.tolist()], np.int32)
            found.append(numbers[which])
            self._taken += 1
        while self._ended and self._ended[0][0] <= self._taken:
            chain = self._ended.popleft()[1]
            del self.of[chain], self._seen[chain]
        return found

    def _number(self) -> None:
        while self._open:
            chain = self._open[0]
            if chain not in self.of:
                if not self.is_track(chain):
                    return
                self.of[chain], self.next = self.next, self.next + 1
            self._open.popleft()
