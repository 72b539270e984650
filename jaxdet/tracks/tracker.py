"""A log's tracks, from its obstacles a window of frames after the other."""

from collections.abc import Iterator

import numpy as np

from jaxdet.elementary import hypot
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.hidden import hide_sides
from jaxdet.tracks.links import end_pieces, link_frames, link_tracklets
from jaxdet.tracks.motion import motion_of
from jaxdet.tracks.numbers import Numbers
from jaxdet.tracks.pairs import chain_starts
from jaxdet.tracks.things import Things, join_things, whole_things
from jaxdet.tracks.track import Piece, Track, piece_of, track_of

PIECE_FRAMES = 1024
"""The way of a track that lasts longer than twice this is fitted in pieces of at least so many
frames; part of the method, as sizes and what moves are decided piece by piece."""


class Tracker:
    """Links the obstacles of a log.

    Keeps the sightings of the last 2048 frames and a window, of tracks that may go on also their
    paths where they moved, and what was not taken yet. So memory does not grow with the log, but
    with the paths of things in sight that move.

    Args:
        config: What links obstacles.
    """

    def __init__(self, config: TrackConfig) -> None:
        self.config = config
        self.things: Things | None = None
        """Sightings that are kept, by frame, which are numbered by the log's rows."""
        self.chain = np.zeros(0, np.int64)
        """The first sighting of each one's chain, by its place in the log."""
        self.before = np.zeros(0, np.int64)
        self.count = 0
        """Sightings so far."""
        self.start = 0
        """Row of the first frame that is kept."""
        self.frames = np.zeros(0, np.int64)
        """Numbers of the frames that are kept."""
        self.stamps = np.zeros(0, np.int64)
        """Their stamps [ns]."""
        self.pieces: dict[int, list[Piece]] = {}
        """Of chains in sight, without what is kept of them."""
        self.begin: dict[int, int] = {}
        """Row of the first frame after those."""
        self.numbers = Numbers(config.min_frames)
        self.done: list[tuple[int, list[Piece]]] = []
        """Chains that ended and are tracks."""

    def add(self, frames: np.ndarray, stamps: np.ndarray, seen: Things, size: np.ndarray) -> None:
        """Takes the next frames of the log in.

        Args:
            frames: ``(F,)`` int64, numbers of all frames, with or without obstacles.
            stamps: ``(F,)`` int64, their stamps [ns].
            seen: ``N`` obstacles; their ``frame`` counts the frames from the log's first, 0.
            size: ``(N,)``, the obstacles' cells in the image.
        """
        late = self._glimpsed()
        self.frames = np.concatenate([self.frames, frames])
        self.stamps = np.concatenate([self.stamps, stamps])
        things, thing = whole_things(seen, size, self.config)
        things = hide_sides(things)
        first, new = len(self.before), len(things.frame)
        self.things = things if self.things is None else join_things(self.things, things)
        before = np.concatenate([self.before, np.full(new, -1)])
        before = link_frames(self.things, before, first, self.config)
        before = end_pieces(self.things, before, first, self.config)
        self.before = link_tracklets(self.things, before, first, self.config, late)
        chain = np.concatenate([self.chain, self.count + np.arange(new)])
        self.chain = chain[chain_starts(self.before)]
        for row in late[self.before[late] >= 0].tolist():
            self.numbers.join(int(chain[row]), int(self.chain[row]))
        self.count += new
        own = self.chain[first:]
        self.numbers.add(own, own[thing])
        if len(stamps):
            self._close(int(stamps[-1]) - round(self.config.max_gap_s * 1e9))
            self._fold()

    def _glimpsed(self) -> np.ndarray:
        """Rows of things that were seen once, so late that more may come of them."""
        if self.things is None:
            return np.zeros(0, np.int64)
        _, row, count = np.unique(self.chain, return_index=True, return_counts=True)
        end = self.start + len(self.frames)
        late = self.things.frame[row] >= end - self.config.max_gap_frames
        rows = row[(count == 1) & late]
        tracks = [self.numbers.is_track(chain) for chain in self.chain[rows].tolist()]
        return rows[~np.array(tracks, bool)]

    def finish(self) -> None:
        """Ends the log: what is taken after this is the rest."""
        self._close(None)

    def take(self) -> tuple[list[Track], list[np.ndarray]]:
        """What is decided since the last time.

        Returns:
            Tracks that ended, each with its number, and for each :meth:`add`, in their order, the
            track of each obstacle, -1 for none, int32.
        """
        number, waiting = self.numbers.of, []
        tracks = []
        for chain, pieces in self.done:
            if chain in number:
                tracks.append(track_of(number[chain], pieces))
            else:
                waiting.append((chain, pieces))
        self.done = waiting
        return tracks, self.numbers.take()

    def _close(self, until_ns: int | None) -> None:
        """Ends the chains that were seen last before a stamp, all without one; forgets them."""
        things = self.things
        if things is None:
            return
        chains, chain = np.unique(self.chain, return_inverse=True)
        last = np.full(len(chains), np.iinfo(np.int64).min)
        np.maximum.at(last, chain, things.stamp_ns)
        ended = np.ones(len(chains), bool) if until_ns is None else last < until_ns
        kept = ended & np.array([self.numbers.is_track(c) for c in chains.tolist()], bool)
        for number, piece in self._fitted(kept[chain]):
            self.begin.pop(number, None)
            self.done.append((number, [*self.pieces.pop(number, ()), piece]))
        self.numbers.end(chains[ended].tolist())
        self._forget(ended[chain])

    def _fold(self) -> None:
        """Fits the older part of long chains.

        Its sightings are forgotten but for the last, which the fit of what follows needs.
        """
        things, end = self.things, self.start + len(self.frames)
        if things is None or not len(self.before):
            return
        chains, chain = np.unique(self.chain, return_inverse=True)
        oldest = np.full(len(chains), end)
        np.minimum.at(oldest, chain, things.frame)
        begin = np.array([self.begin.get(c, 0) for c in chains.tolist()], np.int64)
        long = np.maximum(oldest, begin) < end - 2 * PIECE_FRAMES
        long &= np.array([self.numbers.is_track(c) for c in chains.tolist()], bool)
        recent = things.frame >= end - PIECE_FRAMES
        later = np.full(len(chains), end)
        np.minimum.at(later, chain[recent], things.frame[recent])
        long &= later < end
        if not long.any():
            return
        stop = {c: int(at) for c, at in zip(chains[long].tolist(), later[long], strict=True)}
        for number, piece in self._fitted(long[chain], stop):
            self.pieces.setdefault(number, []).append(piece)
        self.begin |= stop
        cut = self.stamps[np.minimum(later - self.start, len(self.stamps) - 1)]
        reach = round((self.config.smooth_s + self.config.max_gap_s) * 1e9)
        self._forget(long[chain] & (things.stamp_ns < cut[chain] - reach))

    def _fitted(
        self, chosen: np.ndarray, stop: dict[int, int] | None = None
    ) -> Iterator[tuple[int, Piece]]:
        """The pieces of some chains that were not fitted yet.

        Args:
            chosen: ``(N,)`` bool, their sightings.
            stop: Row of the first frame that is left, by chain; None: none is.
        """
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        assert self.things is not None
        rows = rows[np.argsort(self.chain[rows], kind="stable")]
        first = np.flatnonzero(np.diff(self.chain[rows], prepend=-1))
        things = self.things.take(rows)
        motion = motion_of(things, first, self.stamps, self.start, self.config)
        speed = hypot(*motion.velocity.T)
        lasts = np.append(first[1:], len(rows))
        for k, chain in enumerate(self.chain[rows[first]].tolist()):
            frame = things.frame[first[k] : lasts[k]]
            begin = self.begin.get(chain, int(frame[0]))
            end = int(frame[-1]) + 1 if stop is None else stop[chain]
            points = motion.first[k] + np.arange(begin, end) - frame[0]
            shown = first[k] + np.flatnonzero((frame >= begin) & (frame < end))
            inside = slice(begin - self.start, end - self.start)
            about = self.frames[inside], self.stamps[inside]
            yield chain, piece_of(things.take(shown), *about, motion.place[points], speed[points])

    def _forget(self, gone: np.ndarray) -> None:
        """Forgets some sightings ``(N,)`` bool, and frames before all that are kept."""
        assert self.things is not None
        left = ~gone
        row = np.append(np.where(left, np.cumsum(left) - 1, -1), -1)
        self.before = row[self.before[left]]
        self.chain, self.things = self.chain[left], self.things.take(left)
        end = self.start + len(self.frames)
        kept = int(self.things.frame.min(initial=end)) - self.start
        self.frames, self.stamps = self.frames[kept:], self.stamps[kept:]
        self.start += kept
