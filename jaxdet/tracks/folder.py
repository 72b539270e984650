"""The folder of a log gets its tracks: tables beside its own, which stay as they are.

The track of each obstacle is a table of its own, ``track_links.parquet``, whose rows are those of
``obstacles.parquet`` in the same order: so the tables of a run stay the bytes that it wrote, and
tracking again with other settings replaces two small files.
"""

import dataclasses
import json
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.errors import ConfigError, InputError
from jaxdet.render import draw_map, write_png
from jaxdet.results.arrow import open_file, vectors
from jaxdet.results.durable import writing
from jaxdet.results.layout import MANIFEST, WORKING, check_folder, is_complete
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import read_manifest, write_manifest
from jaxdet.results.map_file import Grid, read_map, write_map
from jaxdet.results.occupancy import MapImage, OccupancyMap
from jaxdet.results.publish import finish, flush_folder, link_folder, publish, remove
from jaxdet.results.reading import LINKS, TRACKS, ResultLog, Results
from jaxdet.results.schemas import LINKS_SCHEMA, TRACKS_SCHEMA
from jaxdet.results.tables import Tables
from jaxdet.results.writer import parquet_writer
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.looks import OBSTACLE_COLUMNS, POSE_COLUMNS
from jaxdet.tracks.observations import observations_of
from jaxdet.tracks.places import PlaceRows, Places, is_lasting, with_outlines
from jaxdet.tracks.rows import TrackRows
from jaxdet.tracks.tracker import Tracker

WINDOW_FRAMES = 1024
"""Frames that are linked together; part of the method, as it may decide a link. Memory grows with
it and with the square of the obstacles in a frame: 0.2 GB with 30 of them, 1.6 with 100."""
TRACKING_KEY = "jaxdet.tracking"
KNOWN = "known_map"
"""Name of the copy of the map that obstacles were compared with, without its suffix."""
_STAGING = "tracks"
"""Folder in the working folder, for folders of logs with their new tracks."""

_COLUMNS = ("bottom_m", "top_m", "distance_m", "z_min", "u_min", "u_max", "x_min", "x_max")
_PLACE = ("floor_source", "camera_position_world")
_FRAME = tuple(dict.fromkeys(("stamp_ns", "camera_roll_rad", *_PLACE, *POSE_COLUMNS)))
_READ = ("obstacle", "num_points", "corners_ground", "corners_world", *_COLUMNS)
_OBSTACLE = tuple(dict.fromkeys((*_READ, *OBSTACLE_COLUMNS)))


class LogTracks(NamedTuple):
    """What was found in a log."""

    log: str
    """Its name, and the camera's where it has several."""
    tracks: int
    moving: int
    in_world: int
    """Tracks in the world; the others are in the camera's ground frame."""
    obstacles: int
    linked: int
    """Obstacles that are in a track."""
    blind: tuple[str, ...]
    """Why obstacles have no place in the world, the commonest first; empty: all have one."""
    new: int | None = None
    """Number of tracks that are not in the known map; None without one."""


def track_results(
    folder: Path,
    config: TrackConfig | None = None,
    *,
    missing: bool = False,
    known: Grid | None = None,
    frame: str | None = None,
) -> list[LogTracks]:
    """Link the obstacles of each log of results over time.

    Writes ``tracks.parquet`` and ``track_links.parquet`` (:mod:`jaxdet.results.schemas`) and,
    where there is a map, ``tracks.png`` into the folder of each log: all of them or none, whatever
    ends the process. Logs are done one after the other, so some may have new tracks after a stop.

    Args:
        folder: What ``jaxdet run`` wrote, or the folder of one log in it; tracks that are there
            are replaced.
        config: What links obstacles.
        missing: Leave logs as they are that have tracks.
        known: Map that obstacles are compared with (``in_map``); a copy is kept with the tracks.
        frame: Frame that it is in, which must be the world of all logs with poses; None: it is.

    Returns:
        What was found, by log.

    Raises:
        InputError: It holds no complete results, or can't be written to.
        ConfigError: A run or another tracking works there.
        OutputError: The disk is full or broken.
    """
    check_folder(folder)
    place = folder.absolute()
    found = []
    with _locked(place.parent if is_complete(folder) else place) as root:
        with Results(folder) as results:
            folders = list(results.manifests)
            check_frame(results, frame)
        for one in folders:
            if missing and TRACKS in read_manifest(one)["files"]:
                continue
            staged = root / WORKING / _STAGING
            remove(staged)
            with writing(staged, "make room"):
                link_folder(one, staged)
                found += add_tracks(staged, config or TrackConfig(), known)
            publish(staged, root, one.absolute().name)
    return found


def check_frame(results: Results, frame: str | None) -> None:
    """Make sure that the world of all logs with poses is the frame of a map.

    Raises:
        ConfigError: That of a log is another.
    """
    for log in results.logs if frame else ():
        if (world := results.world_frame(log)) not in ("", frame):
            remedy = f"run jaxdet run again with --log.world-frame {frame}"
            problem = f"its poses are in {world}, the map is in {frame}"
            raise ConfigError(problem, path=log.label, remedy=remedy)


def add_tracks(folder: Path, config: TrackConfig, known: Grid | None = None) -> list[LogTracks]:
    """Write the tracks of a log into its folder, in which nobody else works, and its manifest.

    Args:
        folder: Complete folder of a log.
        config: What links obstacles.
        known: Map that obstacles are compared with.
    """
    manifest = read_manifest(folder)
    about = {key: value for key, value in manifest.items() if key not in ("files", "sha256")}
    paths = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    others = [name for name in paths if name not in manifest["files"]]
    for path in [*folder.rglob("*")]:  # not those of the manifest, which lists no broken link
        is_folder = path.is_dir() and not path.is_symlink()
        if not is_folder and is_track_file(path.relative_to(folder).as_posix()):
            path.unlink()
    with Results(folder) as results:
        if known is not None:
            _write_known(results, known, folder)
        found = write_tracks(results, config, folder)
    (folder / MANIFEST).unlink()
    write_manifest(folder, about, others)
    with writing(folder):
        flush_folder(folder)
    return found


def write_tracks(results: Results, config: TrackConfig, folder: Path) -> list[LogTracks]:
    """Write the files of :func:`track_results` into a folder, and nothing else there.

    Args:
        results: Those of one log; if they hold a known map, obstacles are compared with it.
        config: What links obstacles.
        folder: Gets the files.
    """
    metadata, found = _metadata(results, config), []
    known = known_map(results.folder)
    if known is not None and folder != results.folder:
        _write_known(results, known, folder)
    with (
        _Writer(folder / TRACKS, TRACKS_SCHEMA, metadata) as table,
        _Writer(folder / LINKS, LINKS_SCHEMA, metadata) as links,
    ):
        for log in results.logs:
            image, paths, new = results.map(log), [], 0
            places = Places(results, log, config.most_floor, known)
            with TrackRows(folder / "rows.arrow", log) as rows:
                one = _track_log(results, log, config, rows, links, places)
                for part in places.tracks(rows):
                    table.write(part)
                    new += part["in_map"].to_pylist().count(False)
                    paths += _paths(part, config.most_floor) if image is not None else ()
            found.append(one._replace(new=None if known is None else new))
            if image is not None:
                picture = draw_map(places.lasting_map(image), log.label, paths)
                write_png(folder / f"tracks{log.suffix}.png", picture)
    return found


def lasting_map(results: Results, log: ResultLog) -> MapImage | None:
    """Return the map of a log, after ``jaxdet track`` with the outlines of lasting obstacles only.

    Raises:
        InputError: Map or tracks can't be read.
    """
    image = results.map(log)
    if image is None or not results.tracked(log):
        return image
    most_floor, outlines = tracking(log.folder).most_floor, OccupancyMap()
    for chunk in results.chunks(log, (), ("corners_world", "floor_seen")):
        lasting = is_lasting(chunk.obstacles["floor_seen"].to_numpy(), most_floor)
        outlines.add(vectors(chunk.obstacles["corners_world"], 8)[lasting])
    return with_outlines(image, outlines)


def known_map(folder: Path) -> Grid | None:
    """Return the map that the obstacles of a log's folder were compared with; None: with none.

    Raises:
        InputError: It can't be read.
    """
    path = folder / f"{KNOWN}.yaml"
    return read_map(path) if path.exists() else None


def _write_known(results: Results, known: Grid, folder: Path) -> None:
    frame = next((f for log in results.logs if (f := results.world_frame(log))), "")
    write_map(folder / f"{KNOWN}.png", known, "what was known", frame)


def tracking(folder: Path) -> TrackConfig:
    """What linked the obstacles of a results folder, as ``tracks.parquet`` says.

    Raises:
        InputError: It doesn't say.
    """
    path = folder / TRACKS
    try:
        with open_file(path, "rb") as file:
            told = pq.read_schema(file).metadata[TRACKING_KEY.encode()]
        return TrackConfig(**json.loads(told))
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException, ConfigError) as error:
        problem = "doesn't say what linked the obstacles"
        raise InputError(problem, path=str(path), remedy="run jaxdet track again") from error


def is_track_file(name: str) -> bool:
    """Whether a result of this name is of ``jaxdet track``."""
    own = (TRACKS, LINKS, "tracks.png", f"{KNOWN}.yaml", f"{KNOWN}.png")
    return name in own or fnmatch(name, "tracks_*.png")


def _track_log(
    results: Results,
    log: ResultLog,
    config: TrackConfig,
    rows: TrackRows,
    links: "_Writer",
    places: Places,
) -> LogTracks:
    """Finds the tracks of a log, and writes its rows of ``track_links.parquet``."""
    cameras = log.summary["calibration"] or {}
    image = cameras.get("color") or cameras.get("depth") or {}
    keys = list(LINKS_SCHEMA.names[:4])
    tracker, start, linked = Tracker(config), 0, 0
    waiting: deque[tuple[pa.Table, PlaceRows]] = deque()

    def take() -> int:
        tracks, tracks_of = tracker.take()
        rows.add(tracks)
        for of in tracks_of:
            obstacles, place = waiting.popleft()
            columns = [pa.array(of, pa.int32(), mask=of < 0), *place.columns()]
            for field, column in zip(list(LINKS_SCHEMA)[4:], columns, strict=True):
                obstacles = obstacles.append_column(field, column)
            links.write(obstacles)
            places.count(of, place)
        return sum(int((of >= 0).sum()) for of in tracks_of)

    blind = Counter[str]()
    for chunk in results.chunks(log, _FRAME, _OBSTACLE, WINDOW_FRAMES):
        stamps, roll = (chunk.frames[name].to_numpy() for name in _FRAME[:2])
        first = chunk.first
        frame = np.repeat(np.arange(len(stamps)), np.diff(first))
        columns = {name: chunk.obstacles[name].to_numpy() for name in _COLUMNS}
        outlines = "corners_ground", "corners_world"
        columns |= {name: vectors(chunk.obstacles[name], 8) for name in outlines}
        nowhere = np.isnan(columns["corners_world"]).any(axis=1)
        blind.update(_blind(chunk.take(np.unique(frame[nowhere]))))
        width = image.get("width")
        seen = observations_of(start + frame, stamps[frame], roll[frame], columns, width)
        obstacles = chunk.obstacles.select(keys).cast(pa.schema(list(LINKS_SCHEMA)[:4]))
        waiting.append((obstacles, places.of(chunk, columns["corners_world"])))
        size = chunk.obstacles["num_points"].to_numpy()
        tracker.add(chunk.frames["frame"].to_numpy(), stamps, seen, size)
        start += len(stamps)
        linked += take()
    tracker.finish()
    linked += take()
    why = tuple(reason for reason, _ in blind.most_common())
    found = len(rows), rows.moving, rows.in_world, log.num_obstacles, linked
    return LogTracks(log.label, *found, why)


def _blind(chunk: Tables) -> Iterator[str]:
    """Why each of these frames has no place in the world."""
    for source, place in zip(*(chunk.frames[name].to_pylist() for name in _PLACE), strict=True):
        floor = "no floor" if source == "none" else "the world's z is not up"
        yield floor if place else "no poses"


def _paths(tracks: pa.Table, most_floor: float) -> list[tuple[np.ndarray, bool]]:
    """Paths in the world ``(P, 2)`` [m], and whether the things move, of lasting tracks."""
    columns = (tracks[name].to_pylist() for name in ("in_world", "moving"))
    paths = [np.reshape(path.values.to_numpy(), (-1, 2)) for path in tracks["path"]]
    lasting = is_lasting(tracks["floor_seen"].to_numpy(), most_floor).tolist()
    kept = zip(*columns, paths, lasting, strict=True)
    return [(path, moving) for in_world, moving, path, lasts in kept if in_world and lasts]


class _Writer:
    """A Parquet file whose bytes are a function of its rows and of the metadata."""

    def __init__(self, path: Path, schema: pa.Schema, metadata: dict[str, str]) -> None:
        self.sink = open_file(path, "wb")
        self.file = parquet_writer(self.sink, schema.with_metadata(metadata))

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()
        self.sink.close()

    def write(self, table: pa.Table) -> None:
        """Appends the rows of a log."""
        self.file.write_table(table.cast(self.file.schema))


def _metadata(results: Results, config: TrackConfig) -> dict[str, str]:
    """What the tables are made of: the obstacles' own metadata, and how they were linked."""
    tracking = json.dumps(dataclasses.asdict(config), sort_keys=True, separators=(",", ":"))
    about = results.metadata(results.logs[0]) if results.logs else {}
    return about | {TRACKING_KEY: tracking}


@contextmanager
def _locked(root: Path) -> Iterator[Path]:
    """Lock a results folder; what another process left half moved is in its place then."""
    lock = Lock(root / WORKING / "lock")
    try:
        finish(root)
        yield root
    finally:
        remove(root / WORKING / _STAGING)
        lock.release()
