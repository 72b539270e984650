"""A log's tracks, from its obstacles a window of frames after the other."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.links import link_frames, link_tracklets
from jaxdet.tracks.motion import motion_of
from jaxdet.tracks.outlines import Outlines
from jaxdet.tracks.pairs import chain_starts
from jaxdet.tracks.things import Things, join_things, whole_things

CUT = 0.5
"""Weight of an outline that the image's left or right border cuts off."""
BORDER_PX = 1
"""So near to it [pixel]."""
NOISE_M = 3.0
"""Where the noise of depth, which grows with its square, is as large as that near by [m]."""


class Track(NamedTuple):
    """One thing over time."""

    in_world: bool
    """Whether its path is in the world, else in the camera's ground frame."""
    first_frame: int
    last_frame: int
    first_stamp_ns: int
    last_stamp_ns: int
    frames: int
    """In which it was seen."""
    obstacles: int
    """Rows of ``obstacles.parquet`` that show it."""
    moving: bool
    mean_speed_mps: float
    """0 where it does not move [m/s]."""
    max_speed_mps: float
    """[m/s]."""
    length_m: float
    """The longer side of its outline, median [m]."""
    width_m: float
    """The shorter side [m]."""
    top_m: float
    """Its highest point above the floor, median; NaN where that is not known [m]."""
    path: np.ndarray
    """``(P, 2)`` float32, the outline's middle in each frame from the first to the last; one point
    where it does not move [m]."""
    speed: np.ndarray
    """``(P,)`` float32, at each point of the path [m/s]."""


class Tracker:
    """Links the obstacles of a log.

    Keeps the sightings of tracks that may go on, the frames' stamps, and of each obstacle the
    track.

    Args:
        config: What links obstacles.
    """

    def __init__(self, config: TrackConfig) -> None:
        self.config = config
        self.things: Things | None = None
        self.number = np.zeros(0, np.int64)
        """Numbers of the things that are kept, in the log."""
        self.before = np.zeros(0, np.int64)
        self.stamps: list[np.ndarray] = []
        self.thing_of: list[np.ndarray] = []
        self.count = 0
        self.tracks: list[tuple[int, Track, np.ndarray]] = []

    def add(self, stamps: np.ndarray, seen: Things, size: np.ndarray) -> None:
        """Takes the next frames of the log in.

        Args:
            stamps: Their stamps, of all frames, with or without obstacles [ns].
            seen: ``N`` obstacles; frames are numbered from the log's first.
            size: ``(N,)``, the obstacles' cells in the image.
        """
        self.stamps.append(stamps)
        things, thing = whole_things(seen, size, self.config)
        self.thing_of.append(thing + self.count)
        first, new = len(self.before), len(things.frame)
        self.number = np.concatenate([self.number, self.count + np.arange(new)])
        self.count += new
        self.things = things if self.things is None else join_things(self.things, things)
        before = np.concatenate([self.before, np.full(new, -1)])
        before = link_frames(self.things, before, first, self.config)
        self.before = link_tracklets(self.things, before, first, self.config)
        if len(stamps):
            self._close(int(stamps[-1]) - round(self.config.max_gap_s * 1e9))

    def finish(self) -> tuple[list[Track], np.ndarray]:
        """The log's tracks, by their first obstacle, and the track of each obstacle, or -1."""
        self._close(None)
        self.tracks.sort(key=lambda track: track[0])
        track_of = np.full(self.count, -1, np.int32)
        for number, (_, _, things) in enumerate(self.tracks):
            track_of[things] = number
        rows = np.concatenate(self.thing_of) if self.thing_of else np.zeros(0, np.int64)
        return [track for _, track, _ in self.tracks], track_of[rows]

    def _close(self, until_ns: int | None) -> None:
        """Makes tracks of the chains that end before a stamp, all without one; forgets them."""
        things = self.things
        if things is None or not len(self.before):
            return
        start, chain = np.unique(chain_starts(self.before), return_inverse=True)
        last = np.full(len(start), np.iinfo(np.int64).min)
        np.maximum.at(last, chain, things.stamp_ns)
        ended = np.ones(len(start), bool) if until_ns is None else last < until_ns
        seen = np.bincount(chain, minlength=len(start))
        self._keep(chain, ended & (seen >= self.config.min_frames))
        left = ~ended[chain]
        row = np.cumsum(left) - 1
        before = self.before[left]
        self.before = np.where(before >= 0, row[before], -1)
        self.things, self.number = things.take(left), self.number[left]

    def _keep(self, chain: np.ndarray, kept: np.ndarray) -> None:
        """Makes tracks of some chains."""
        assert self.things is not None
        rows = np.flatnonzero(kept[chain])
        if not len(rows):
            return
        rows = rows[np.argsort(chain[rows], kind="stable")]
        first = np.flatnonzero(np.diff(chain[rows], prepend=-1))
        things, number = self.things.take(rows), self.number[rows]
        stamps = np.concatenate(self.stamps)
        self.stamps = [stamps]
        motion = motion_of(things, first, stamps, self.config)
        points = np.split(motion.place.astype(np.float32), motion.first[1:])
        speeds = np.split(np.hypot(*motion.velocity.T), motion.first[1:])
        parts = np.split(np.arange(len(rows)), first[1:])
        for points_of, speed, moving, part in zip(
            points, speeds, motion.moving, parts, strict=True
        ):
            track = _track(things.take(part), points_of, speed, bool(moving))
            self.tracks.append((int(number[part[0]]), track, number[part]))


def _track(seen: Things, points: np.ndarray, speed: np.ndarray, moving: bool) -> Track:
    # Which side of an outline is its first one changes from frame to frame.
    shorter, longer = 2 * np.median(np.sort(seen.outline.half, axis=1), axis=0)
    top = seen.top_m[~np.isnan(seen.top_m)]
    return Track(
        bool(seen.in_world[0]),
        int(seen.frame[0]),
        int(seen.frame[-1]),
        int(seen.stamp_ns[0]),
        int(seen.stamp_ns[-1]),
        len(seen.frame),
        int(seen.obstacles.sum()),
        moving,
        float(speed.mean()),
        float(speed.max()),
        float(longer),
        float(shorter),
        float(np.median(top)) if len(top) else float("nan"),
        points if moving else np.median(points, axis=0)[None],
        (speed if moving else speed[:1]).astype(np.float32),
    )


def obstacles_seen(
    frame: np.ndarray,
    stamp_ns: np.ndarray,
    columns: Mapping[str, np.ndarray],
    width: int | None,
) -> Things:
    """Obstacles as things: in the world where a pose is known, else in the camera's ground frame.

    Args:
        frame: ``(N,)``.
        stamp_ns: ``(N,)``.
        columns: Of ``obstacles.parquet``: ``corners_ground``, ``corners_world`` (NaN without a
            pose), ``bottom_m``, ``top_m``, ``distance_m``, ``u_min``, ``u_max``.
        width: Of the colour image, None where that is not known [pixel].
    """
    world = columns["corners_world"]
    known = np.asarray(np.isfinite(world).all(axis=1))
    outline = Outlines.of_corners(np.where(known[:, None], world, columns["corners_ground"]))
    right = np.inf if width is None else width - 1 - BORDER_PX
    side = (columns["u_max"] >= right) - (columns["u_min"] <= BORDER_PX).astype(np.float64)
    cut = side[:, None] * _rightwards(columns["corners_ground"], world, known)
    noise = 1 + (columns["distance_m"].astype(np.float64) / NOISE_M) ** 4
    weight = np.where(side != 0, CUT, 1.0) / noise
    bottom, top = (columns[name].astype(np.float64) for name in ("bottom_m", "top_m"))
    one = np.ones(len(frame), np.int64)
    return Things(frame, stamp_ns, outline, bottom, top, weight, cut, known, one)


def _rightwards(ground: np.ndarray, world: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``(N, 2)``, the camera's right in the frame of the outlines, from their diagonals."""
    one, other = (c.astype(np.float64)[:, 4:6] - c[:, :2] for c in (ground, world))
    length = np.maximum((one * one).sum(axis=1), 1e-12)
    # The ground frame is right-handed with x right, y forward: the turn takes one to the other.
    cos = (one * other).sum(axis=1) / length
    sin = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / length
    return np.where(known[:, None], np.stack([cos, sin], axis=1), (1.0, 0.0))
