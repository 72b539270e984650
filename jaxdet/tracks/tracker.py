"""Multi-object tracking of a log, window by window."""

from collections.abc import Iterator

import numpy as np

from jaxdet.elementary import hypot
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.links import end_pieces, link_frames, link_tracklets
from jaxdet.tracks.merge import merge_overlapping
from jaxdet.tracks.motion import motion_of
from jaxdet.tracks.observations import Observations, concatenate
from jaxdet.tracks.occlusion import mark_hidden_sides
from jaxdet.tracks.pairs import chain_starts
from jaxdet.tracks.track import Piece, Track, piece_of, track_of
from jaxdet.tracks.track_ids import TrackIds

PIECE_FRAMES = 1024
"""Minimum number of frames of a piece. Tracks with more than twice as many frames are split into
pieces. The number affects the results, as size and motion are determined per piece."""


class Tracker:
    """Multi-object tracker of a log.

    In memory are the observations of the last 2048 frames and a window, the paths of open moving
    tracks, and results not yet returned by :meth:`take`. Memory therefore grows only with the paths
    of open moving tracks, not with the log.

    Args:
        config: Tracking parameters.
    """

    def __init__(self, config: TrackConfig) -> None:
        self.config = config
        self.observations: Observations | None = None
        """Observations in memory; their ``frame`` is an index into the log's frames."""
        self.chain = np.zeros(0, np.int64)
        """Chain of each observation, identified by the index in the log of its first observation.
        """
        self.before = np.zeros(0, np.int64)
        """Row of the previous observation in the chain, -1 = none."""
        self.count = 0
        """Number of observations so far."""
        self.start = 0
        """Index of the first frame in memory."""
        self.frames = np.zeros(0, np.int64)
        """Numbers of the frames in memory."""
        self.stamps = np.zeros(0, np.int64)
        """Timestamps of the frames in memory [ns]."""
        self.pieces: dict[int, list[Piece]] = {}
        """Pieces fitted so far, by open chain."""
        self.begin: dict[int, int] = {}
        """Index of the first frame after these pieces, by chain."""
        self.track_ids = TrackIds(config.min_frames)
        self.done: list[tuple[int, list[Piece]]] = []
        """Chains that have ended and are tracks."""

    def add(
        self, frames: np.ndarray, stamps: np.ndarray, obs: Observations, size: np.ndarray
    ) -> None:
        """Add the next frames of the log.

        Args:
            frames: Numbers of all frames, with or without obstacles, ``(F,)`` int64.
            stamps: Timestamps of these frames, ``(F,)`` int64 [ns].
            obs: ``N`` obstacles; their ``frame`` is an index into the log's frames.
            size: Number of depth cells of each obstacle, ``(N,)``.
        """
        late = self._late_singles()
        self.frames = np.concatenate([self.frames, frames])
        self.stamps = np.concatenate([self.stamps, stamps])
        merged, group = merge_overlapping(obs, size, self.config)
        new = mark_hidden_sides(merged)
        first, count = len(self.before), len(new.frame)
        kept = self.observations
        kept = self.observations = new if kept is None else concatenate(kept, new)
        before = np.concatenate([self.before, np.full(count, -1)])
        before = link_frames(kept, before, first, self.config)
        before = end_pieces(kept, before, first, self.config)
        self.before = link_tracklets(kept, before, first, self.config, late)
        chain = np.concatenate([self.chain, self.count + np.arange(count)])
        self.chain = chain[chain_starts(self.before)]
        for row in late[self.before[late] >= 0].tolist():
            self.track_ids.join(int(chain[row]), int(self.chain[row]))
        self.count += count
        own = self.chain[first:]
        self.track_ids.add(own, own[group])
        if len(stamps):
            self._close(int(stamps[-1]) - round(self.config.max_gap_s * 1e9))
            self._fold()

    def _late_singles(self) -> np.ndarray:
        """Return the rows of recent chains with one observation, which may still continue."""
        if self.observations is None:
            return np.zeros(0, np.int64)
        _, row, count = np.unique(self.chain, return_index=True, return_counts=True)
        end = self.start + len(self.frames)
        late = self.observations.frame[row] >= end - self.config.max_gap_frames
        rows = row[(count == 1) & late]
        tracks = [self.track_ids.is_track(chain) for chain in self.chain[rows].tolist()]
        return rows[~np.array(tracks, bool)]

    def finish(self) -> None:
        """End the log; the next :meth:`take` returns the remaining results."""
        self._close(None)

    def take(self) -> tuple[list[Track], list[np.ndarray]]:
        """Return the results decided since the last call.

        Returns:
            Tracks that have ended, and the track of each obstacle for each :meth:`add`, int32, -1
            for none.
        """
        number, waiting = self.track_ids.ids, []
        tracks = []
        for chain, pieces in self.done:
            if chain in number:
                tracks.append(track_of(number[chain], pieces))
            else:
                waiting.append((chain, pieces))
        self.done = waiting
        return tracks, self.track_ids.take()

    def _close(self, until_ns: int | None) -> None:
        """End and drop chains last observed before a timestamp; None: all chains."""
        obs = self.observations
        if obs is None:
            return
        chains, chain = np.unique(self.chain, return_inverse=True)
        last = np.full(len(chains), np.iinfo(np.int64).min)
        np.maximum.at(last, chain, obs.stamp_ns)
        ended = np.ones(len(chains), bool) if until_ns is None else last < until_ns
        kept = ended & np.array([self.track_ids.is_track(c) for c in chains.tolist()], bool)
        for number, piece in self._fitted_pieces(kept[chain]):
            self.begin.pop(number, None)
            self.done.append((number, [*self.pieces.pop(number, ()), piece]))
        self.track_ids.end(chains[ended].tolist())
        self._forget(ended[chain])

    def _fold(self) -> None:
        """Fit the older part of long chains.

        Its observations are dropped, except those needed by the next fit.
        """
        obs, end = self.observations, self.start + len(self.frames)
        if obs is None or not len(self.before):
            return
        chains, chain = np.unique(self.chain, return_inverse=True)
        oldest = np.full(len(chains), end)
        np.minimum.at(oldest, chain, obs.frame)
        begin = np.array([self.begin.get(c, 0) for c in chains.tolist()], np.int64)
        long = np.maximum(oldest, begin) < end - 2 * PIECE_FRAMES
        long &= np.array([self.track_ids.is_track(c) for c in chains.tolist()], bool)
        recent = obs.frame >= end - PIECE_FRAMES
        later = np.full(len(chains), end)
        np.minimum.at(later, chain[recent], obs.frame[recent])
        long &= later < end
        if not long.any():
            return
        stop = {c: int(at) for c, at in zip(chains[long].tolist(), later[long], strict=True)}
        for number, piece in self._fitted_pieces(long[chain], stop):
            self.pieces.setdefault(number, []).append(piece)
        self.begin |= stop
        cut = self.stamps[np.minimum(later - self.start, len(self.stamps) - 1)]
        reach = round((self.config.smooth_s + self.config.max_gap_s) * 1e9)
        self._forget(long[chain] & (obs.stamp_ns < cut[chain] - reach))

    def _fitted_pieces(
        self, chosen: np.ndarray, stop: dict[int, int] | None = None
    ) -> Iterator[tuple[int, Piece]]:
        """Fit the remaining frames of some chains, and yield their pieces.

        Args:
            chosen: Observations of these chains, ``(N,)`` bool.
            stop: Index of the first frame to exclude, by chain; None: all frames are fitted.
        """
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        assert self.observations is not None
        rows = rows[np.argsort(self.chain[rows], kind="stable")]
        first = np.flatnonzero(np.diff(self.chain[rows], prepend=-1))
        obs = self.observations.take(rows)
        motion = motion_of(obs, first, self.stamps, self.start, self.config)
        speed = hypot(*motion.velocity.T)
        lasts = np.append(first[1:], len(rows))
        for k, chain in enumerate(self.chain[rows[first]].tolist()):
            frame = obs.frame[first[k] : lasts[k]]
            begin = self.begin.get(chain, int(frame[0]))
            end = int(frame[-1]) + 1 if stop is None else stop[chain]
            points = motion.first[k] + np.arange(begin, end) - frame[0]
            shown = first[k] + np.flatnonzero((frame >= begin) & (frame < end))
            inside = slice(begin - self.start, end - self.start)
            about = self.frames[inside], self.stamps[inside]
            yield chain, piece_of(obs.take(shown), *about, motion.position[points], speed[points])

    def _forget(self, gone: np.ndarray) -> None:
        """Drop observations, given by a mask ``(N,)``, and frames before all remaining ones."""
        assert self.observations is not None
        left = ~gone
        row = np.append(np.where(left, np.cumsum(left) - 1, -1), -1)
        self.before = row[self.before[left]]
        self.chain, self.observations = self.chain[left], self.observations.take(left)
        end = self.start + len(self.frames)
        kept = int(self.observations.frame.min(initial=end)) - self.start
        self.frames, self.stamps = self.frames[kept:], self.stamps[kept:]
        self.start += kept
