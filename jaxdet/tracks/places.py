"""Places of obstacles and tracks in a log: their persistence, and whether a map contains them."""

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from jaxdet.elementary import arctan2, hypot
from jaxdet.results.free_floor import RAY_RAD, FreeFloor
from jaxdet.results.map_file import Grid, KnownPlaces
from jaxdet.results.metric import world_angle
from jaxdet.results.occupancy import MapImage, OccupancyMap
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.schemas import LINKS_SCHEMA, TRACKS_SCHEMA
from jaxdet.results.tables import Tables, TracksInFrames, vectors
from jaxdet.tracks.rows import TrackRows
from jaxdet.tracks.sightings import (
    CHUNK_FRAMES,
    FRAME_COLUMNS,
    OBSTACLE_COLUMNS,
    Lines,
    Sightings,
    contours,
    free_floor,
    poses,
    shares,
)
from jaxdet.types import RAYS

COLUMNS = ("persistence", "floor_seen", "in_map")
MAP_NEAR_M, MAP_PER_M = 0.10, 0.015
"""Maximum distance of a contour point from an occupied cell of the map [m], and its increase with
the square of the obstacle's distance [1/m]."""
BEHIND_M = 0.4
"""Maximum distance from an occupied cell at which an unknown cell counts as occupied [m]: a lidar
maps the visible outline of furniture, and the cells behind the outline stay unknown."""
EDGE_POINTS = 9
"""Number of points on the edge AB of an obstacle without a contour (preset ``paper``)."""
IN_MAP = 0.5
"""Minimum fraction of points of its visible edge for an obstacle to be in the map, and minimum
fraction of its obstacles for a track."""


class PlaceRows(NamedTuple):
    """Places of ``N`` obstacles."""

    sightings: np.ndarray
    """Sightings of each place, ``(N, 3)`` int64, see :meth:`jaxdet.tracks.sightings.Sightings.of`.
    """
    in_map: np.ndarray
    """Fraction of the points of the visible edge that are in the map, ``(N,)`` float64, NaN without
    a map or a position in the world."""

    def columns(self) -> list[pa.Array]:
        """Return the columns :data:`COLUMNS` of ``track_links.parquet``."""
        return _columns(*shares(self.sightings), self.in_map)


class Places:
    """Places of obstacles and tracks in a log. Memory grows with the area seen.

    Args:
        results: Results with the log.
        log: Log whose frames are read.
        most_floor: Maximum fraction of frames that show floor at the place of an obstacle drawn on
            maps.
        known: Known map with which obstacles are compared.
    """

    def __init__(
        self, results: Results, log: ResultLog, most_floor: float, known: Grid | None
    ) -> None:
        self._results, self._log, self._most_floor = results, log, most_floor
        self._known = None if known is None else KnownPlaces(known)
        self._sightings, self._lasting = Sightings(), OccupancyMap()
        self._of_tracks = np.zeros((0, 5), np.int64)
        """Per track: sightings by kind, obstacles compared with the map, and obstacles in the map.
        """
        self._floor_of_moving: Counter[int] = Counter()
        for chunk in results.chunks(log, FRAME_COLUMNS, OBSTACLE_COLUMNS, CHUNK_FRAMES):
            self._sightings.add(chunk)

    def of(self, chunk: Tables, corners_world: np.ndarray) -> PlaceRows:
        """Return the places of the obstacles of a chunk.

        Args:
            chunk: Tables with ``POSE_COLUMNS`` and ``OBSTACLE_COLUMNS`` of
                :mod:`jaxdet.tracks.sightings`, and with ``corners_world``.
            corners_world: Outlines ``(N, 8)`` [m], NaN if unknown.
        """
        sightings = self._sightings.of(chunk)
        self._lasting.add(corners_world[is_lasting(shares(sightings)[1], self._most_floor)])
        if self._known is None:
            return PlaceRows(sightings, np.full(len(sightings), np.nan))
        return PlaceRows(sightings, shares_in_map(chunk, self._known))

    def count(self, tracks: np.ndarray, places: PlaceRows) -> None:
        """Add the sightings and map comparisons of obstacles to the counts of their tracks.

        Args:
            tracks: Track number of each obstacle, ``(N,)``, -1 for none.
            places: Places of these obstacles.
        """
        if (more := int(tracks.max(initial=-1)) + 1 - len(self._of_tracks)) > 0:
            self._of_tracks = np.concatenate([self._of_tracks, np.zeros((more, 5), np.int64)])
        compared = np.stack([~np.isnan(places.in_map), places.in_map >= IN_MAP], axis=1)
        linked = tracks >= 0
        each = np.concatenate([places.sightings, compared], axis=1)
        np.add.at(self._of_tracks, tracks[linked], each[linked])

    def follow(self, rows: TrackRows) -> None:
        """Count the frames in which floor is visible where a moving track is in that frame."""
        tracks = TracksInFrames(row for part in rows.ordered() for row in part.to_pylist())
        for chunk in self._results.chunks(self._log, FRAME_COLUMNS, (), CHUNK_FRAMES):
            frames, numbers, places = [], [], []
            for f, number in enumerate(chunk.frames["frame"].to_pylist()):
                for track in tracks.at(number):
                    if track.moving and track.in_world:
                        frames.append(f)
                        numbers.append(track.track)
                        places.append(track.path[-1])
            if frames:
                T, free = poses(chunk.frames), free_floor(chunk.frames)
                seen = _shows_floor(free, np.array(frames), T[frames], np.stack(places))
                self._floor_of_moving.update(np.array(numbers)[seen].tolist())

    def tracks(self, rows: TrackRows) -> Iterator[pa.Table]:
        """Yield the rows of ``tracks.parquet`` with the columns :data:`COLUMNS`."""
        if rows.moving:
            self.follow(rows)
        for part in rows.ordered():
            number, moving, frames, in_world = (
                part[name].to_numpy() for name in ("track", "moving", "num_frames", "in_world")
            )
            sums = self._of_tracks[number]
            floor = np.array([self._floor_of_moving[n] for n in number.tolist()], np.int64)
            along = np.stack([frames, floor, np.zeros_like(floor)], axis=1)
            sightings = np.where(moving[:, None], along, sums[:, :3])
            sightings[~in_world | (sums[:, 0] == 0)] = 0
            with np.errstate(invalid="ignore"):
                in_map = sums[:, 4] / sums[:, 3]
            columns = zip(COLUMNS, _columns(*shares(sightings), in_map), strict=True)
            for name, column in columns:
                part = part.set_column(
                    part.schema.get_field_index(name), TRACKS_SCHEMA.field(name), column
                )
            yield part

    def lasting_map(self, image: MapImage) -> MapImage:
        """Return the map of the run with only the outlines of lasting obstacles."""
        return with_outlines(image, self._lasting)


def shares_in_map(chunk: Tables, known: KnownPlaces) -> np.ndarray:
    """Return the fraction of the points of each visible edge that a map contains.

    The map contains a point if there is an occupied cell near it, or, if the cell of the point is
    unknown, within :data:`BEHIND_M` of the point.

    Args:
        chunk: Tables with ``POSE_COLUMNS`` and ``OBSTACLE_COLUMNS`` of
            :mod:`jaxdet.tracks.sightings`, and with ``corners_world``.
        known: Known map.

    Returns:
        Fractions ``(N,)`` float64, NaN without a position in the world; an obstacle is in the map
        from :data:`IN_MAP` on.
    """
    count = chunk.obstacles.num_rows
    lines = visible_edges(chunk)
    distance = chunk.obstacles["distance_m"].to_numpy().astype(np.float64)
    reach = MAP_NEAR_M + MAP_PER_M * (distance * distance)
    obstacle = np.repeat(np.arange(count), lines.lengths)
    placed = np.isfinite(lines.points).all(axis=1)
    behind = known.near(lines.points, np.full(len(lines.points), BEHIND_M))
    behind &= known.is_unknown(lines.points)
    mapped = known.near(lines.points, reach[obstacle]) | behind
    total, inside = (np.bincount(obstacle[rows], minlength=count) for rows in (placed, mapped))
    return np.where(total > 0, inside / np.maximum(total, 1), np.nan)


def visible_edges(chunk: Tables) -> Lines:
    """Return the contours of all obstacles; an obstacle without one has points on its edge AB."""
    lines = contours(chunk, poses(chunk.frames))
    bare = lines.lengths == 0
    count = np.where(bare, EDGE_POINTS, lines.lengths)
    a, b = np.split(vectors(chunk.obstacles["corners_world"], 8)[:, None, :4], 2, axis=-1)
    edges = a + (b - a) * np.linspace(0, 1, EDGE_POINTS)[:, None]
    points, has_none = np.zeros((count.sum(), 2)), np.repeat(bare, count)
    points[has_none], points[~has_none] = edges[bare].reshape(-1, 2), lines.points
    return Lines(points, count)


def is_lasting(floor_seen: np.ndarray, most_floor: float) -> np.ndarray:
    """Return whether obstacles are drawn on maps.

    An obstacle is drawn if the fraction of frames that show floor at its place, ``floor_seen``, is
    at most ``most_floor``, or NaN because it has no position in the world.

    Example:
        >>> is_lasting(np.array([0.1, 0.9, np.nan]), 0.3).tolist()
        [True, False, True]
    """
    return ~(floor_seen > most_floor)


def with_outlines(image: MapImage, outlines: OccupancyMap) -> MapImage:
    """Return a map with its counts replaced by those of other outlines."""
    counts, own = np.zeros_like(image.counts), outlines.image()
    if own is not None:
        shift = np.subtract(own.origin, image.origin) / image.cell_m
        x, y = np.rint(shift).astype(np.int64).tolist()
        rows, columns = counts.shape
        part = own.counts[max(-y, 0) : max(rows - y, 0), max(-x, 0) : max(columns - x, 0)]
        top, left = max(y, 0), max(x, 0)
        counts[top : top + part.shape[0], left : left + part.shape[1]] = part
    return image._replace(counts=counts)


def _shows_floor(
    free: FreeFloor, frame: np.ndarray, T: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Return whether frames show floor at places in the world, False without a pose.

    Args:
        free: Free floor of all frames.
        frame: Rows of the frames, ``(N,)`` integers.
        T: Camera poses of these frames, ``(N, 4, 4)`` float64.
        place: Places ``(N, 2)`` float64 [m].
    """
    sin, cos = world_angle(T)
    x, y = (place - T[:, :2, 3]).T
    right, forward = x * cos - y * sin, x * sin + y * cos
    known = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(place).all(axis=1)
    angle = np.where(known, arctan2(right, forward), 0.0)
    ray = (np.rint(angle / RAY_RAD).astype(np.int64) + RAYS // 2) % RAYS
    distance = hypot(right, forward)
    return known & (free.from_m[frame, ray] <= distance) & (distance <= free.to_m[frame, ray])


def _columns(persistence: np.ndarray, floor_seen: np.ndarray, in_map: np.ndarray) -> list[pa.Array]:
    """Return Arrow columns of ``(N,)`` values, with null for NaN."""
    types = [LINKS_SCHEMA.field(name).type for name in COLUMNS]
    values = (persistence.astype(np.float32), floor_seen.astype(np.float32), in_map >= IN_MAP)
    nulls = (np.isnan(persistence), np.isnan(floor_seen), np.isnan(in_map))
    return [pa.array(v, t, mask=n) for v, t, n in zip(values, types, nulls, strict=True)]
