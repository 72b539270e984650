"""Tracks in the folder of a log, as separate tables next to those of the run.

The track of each obstacle is in ``track_links.parquet``, whose rows correspond to those of
``obstacles.parquet``. The tables of the run thus remain unchanged, and tracking again with other
settings replaces two small files.
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
from jaxdet.results.durable import finish, flush_folder, link_folder, publish, remove, writing
from jaxdet.results.layout import LINKS, MANIFEST, TRACKS, WORKING, check_folder, is_complete
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import read_manifest, write_manifest
from jaxdet.results.map_file import Grid, read_map, write_map
from jaxdet.results.occupancy import MapImage, OccupancyMap
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.schemas import LINKS_SCHEMA, TRACKS_SCHEMA
from jaxdet.results.tables import Tables, open_file, vectors
from jaxdet.results.writer import parquet_writer
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.observations import observations_of
from jaxdet.tracks.places import PlaceRows, Places, is_lasting, with_outlines
from jaxdet.tracks.rows import TrackRows
from jaxdet.tracks.sightings import OBSTACLE_COLUMNS, POSE_COLUMNS
from jaxdet.tracks.tracker import Tracker

WINDOW_FRAMES = 1024
"""Number of frames linked together. It affects the results, as it may decide whether obstacles are
linked. The memory needed grows with it and with the square of the number of obstacles per frame:
0.2 GB for 30 obstacles, 1.6 GB for 100."""
TRACKING_KEY = "jaxdet.tracking"
KNOWN = "known_map"
"""Name, without suffix, of the copy of the map with which obstacles were compared."""
_STAGING = "tracks"
"""Subfolder of the working folder for copies of logs with their new tracks."""

_COLUMNS = ("bottom_m", "top_m", "distance_m", "z_min", "u_min", "u_max", "x_min", "x_max")
_PLACE = ("floor_source", "camera_position_world")
_FRAME = tuple(dict.fromkeys(("stamp_ns", "camera_roll_rad", *_PLACE, *POSE_COLUMNS)))
_READ = ("obstacle", "num_points", "corners_ground", "corners_world", *_COLUMNS)
_OBSTACLE = tuple(dict.fromkeys((*_READ, *OBSTACLE_COLUMNS)))


class LogTracks(NamedTuple):
    """Summary of the tracks of a log."""

    log: str
    """Name of the log, with the camera if it has several."""
    tracks: int
    """Number of tracks."""
    moving: int
    """Number of tracks of moving objects."""
    in_world: int
    """Number of tracks in the world frame; the others are in the camera's ground frame."""
    obstacles: int
    """Number of obstacles of the log."""
    linked: int
    """Number of obstacles in tracks."""
    blind: tuple[str, ...]
    """Reasons why obstacles have no position in the world, the most common first; empty if all have
    one."""
    new: int | None = None
    """Number of tracks that are not in the known map; None without a map."""


def track_results(
    folder: Path,
    config: TrackConfig | None = None,
    *,
    missing: bool = False,
    known: Grid | None = None,
    frame: str | None = None,
) -> list[LogTracks]:
    """Link the obstacles of each log of results over time.

    Writes ``tracks.parquet`` and ``track_links.parquet`` (:mod:`jaxdet.results.schemas`) and, if
    there is a map, ``tracks.png`` into the folder of each log, atomically. Logs are processed one
    by one, so after an interruption only some may have new tracks.

    Args:
        folder: Results of ``jaxdet run``, or the folder of one log in them; existing tracks are
            replaced.
        config: Tracking parameters.
        missing: Whether to skip logs that have tracks.
        known: Known map with which obstacles are compared (``in_map``); a copy is stored with the
            tracks.
        frame: TF frame of the map, which must be the world frame of all logs with poses; None: no
            check.

    Returns:
        Summaries of all logs.

    Raises:
        InputError: The folder has no complete results, or can't be written to.
        ConfigError: A run or another tracking process uses the folder.
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
    """Check that the frame of a map is the world frame of all logs with poses.

    Raises:
        ConfigError: A log has another world frame.
    """
    for log in results.logs if frame else ():
        if (world := results.world_frame(log)) not in ("", frame):
            remedy = f"run jaxdet run again with --log.world-frame {frame}"
            problem = f"the poses are in {world}, but the map is in {frame}"
            raise ConfigError(problem, path=log.label, remedy=remedy)


def add_tracks(folder: Path, config: TrackConfig, known: Grid | None = None) -> list[LogTracks]:
    """Write the tracks of a log and a new manifest into its folder.

    No other process may use the folder.

    Args:
        folder: Complete folder of a log.
        config: Tracking parameters.
        known: Known map with which obstacles are compared.
    """
    manifest = read_manifest(folder)
    about = {key: value for key, value in manifest.items() if key not in ("files", "sha256")}
    paths = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    others = [name for name in paths if name not in manifest["files"]]
    for path in [*folder.rglob("*")]:  # includes broken links, which are not in the manifest
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
    """Write the files of :func:`track_results` for one log into a folder.

    Args:
        results: Results of one log; if they contain a known map, obstacles are compared with it.
        config: Tracking parameters.
        folder: Folder for the files.
    """
    parameters = json.dumps(dataclasses.asdict(config), sort_keys=True, separators=(",", ":"))
    about = results.metadata(results.logs[0]) if results.logs else {}
    about[TRACKING_KEY] = parameters
    found = []
    known = known_map(results.folder)
    if known is not None and folder != results.folder:
        _write_known(results, known, folder)
    with (
        open_file(folder / TRACKS, "wb") as track_file,
        open_file(folder / LINKS, "wb") as link_file,
        parquet_writer(track_file, TRACKS_SCHEMA.with_metadata(about)) as table,
        parquet_writer(link_file, LINKS_SCHEMA.with_metadata(about)) as links,
    ):
        for log in results.logs:
            image, paths, new = results.map(log), [], 0
            places = Places(results, log, config.most_floor, known)
            with TrackRows(folder / "rows.arrow", log) as rows:
                one = _track_log(results, log, config, rows, links, places)
                for part in places.tracks(rows):
                    table.write_table(part.cast(table.schema))
                    new += part["in_map"].to_pylist().count(False)
                    paths += _paths(part, config.most_floor) if image is not None else ()
            found.append(one._replace(new=None if known is None else new))
            if image is not None:
                picture = draw_map(places.lasting_map(image), log.label, paths)
                write_png(folder / f"tracks{log.suffix}.png", picture)
    return found


def lasting_map(results: Results, log: ResultLog) -> MapImage | None:
    """Return the map of a log, with only the lasting obstacles if ``jaxdet track`` was run.

    Raises:
        InputError: The map or the tracks can't be read.
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
    """Return the known map with which a log's obstacles were compared; None if there is none.

    Raises:
        InputError: The map can't be read.
    """
    path = folder / f"{KNOWN}.yaml"
    return read_map(path) if path.exists() else None


def _write_known(results: Results, known: Grid, folder: Path) -> None:
    frame = next((f for log in results.logs if (f := results.world_frame(log))), "")
    write_map(folder / f"{KNOWN}.png", known, "known map", frame)


def tracking(folder: Path) -> TrackConfig:
    """Return the tracking parameters of a results folder, from ``tracks.parquet``.

    Raises:
        InputError: The file does not contain valid parameters.
    """
    path = folder / TRACKS
    try:
        with open_file(path, "rb") as file:
            parameters = pq.read_schema(file).metadata[TRACKING_KEY.encode()]
        return TrackConfig(**json.loads(parameters))
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException, ConfigError) as error:
        problem = "the tracking parameters are missing or invalid"
        raise InputError(problem, path=str(path), remedy="run jaxdet track again") from error


def is_track_file(name: str) -> bool:
    """Return whether a file in a results folder is written by ``jaxdet track``."""
    own = (TRACKS, LINKS, "tracks.png", f"{KNOWN}.yaml", f"{KNOWN}.png")
    return name in own or fnmatch(name, "tracks_*.png")


def _track_log(
    results: Results,
    log: ResultLog,
    config: TrackConfig,
    rows: TrackRows,
    links: pq.ParquetWriter,
    places: Places,
) -> LogTracks:
    """Track the obstacles of a log; write its rows of ``track_links.parquet``; return a summary."""
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
            links.write_table(obstacles.cast(links.schema))
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
    """Yield the reason why each of these frames has no position in the world."""
    for source, place in zip(*(chunk.frames[name].to_pylist() for name in _PLACE), strict=True):
        floor = "no floor" if source == "none" else "the world's z is not up"
        yield floor if place else "no poses"


def _paths(tracks: pa.Table, most_floor: float) -> list[tuple[np.ndarray, bool]]:
    """Return the world paths ``(P, 2)`` [m] of lasting tracks, and whether the objects move."""
    columns = (tracks[name].to_pylist() for name in ("in_world", "moving"))
    paths = [np.reshape(path.values.to_numpy(), (-1, 2)) for path in tracks["path"]]
    lasting = is_lasting(tracks["floor_seen"].to_numpy(), most_floor).tolist()
    kept = zip(*columns, paths, lasting, strict=True)
    return [(path, moving) for in_world, moving, path, lasts in kept if in_world and lasts]


@contextmanager
def _locked(root: Path) -> Iterator[Path]:
    """Lock a results folder, after completing file moves that another process left unfinished."""
    lock = Lock(root / WORKING / "lock")
    try:
        finish(root)
        yield root
    finally:
        remove(root / WORKING / _STAGING)
        lock.release()
