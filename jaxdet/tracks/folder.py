"""A results folder gets its tracks: tables beside its own, which stay as they are.

The track of each obstacle is a table of its own, ``track_links.parquet``, whose rows are those of
``obstacles.parquet`` in the same order: so the tables of a run stay the bytes that it wrote, and
tracking again with other settings replaces two small files.
"""

import dataclasses
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.errors import InputError
from jaxdet.render import draw_map, write_png
from jaxdet.results.arrow import open_file
from jaxdet.results.commit import JOURNAL, commit, settle
from jaxdet.results.durable import writing
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import MANIFEST, WORKING, changed_manifest
from jaxdet.results.reading import Chunk, ResultLog, Results
from jaxdet.results.writer import write_json
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.schemas import LINKS_SCHEMA, TRACKS_SCHEMA
from jaxdet.tracks.tracker import Track, Tracker, obstacles_seen

WINDOW_FRAMES = 1024
"""Frames that are linked together; part of the method, as it may decide a link. Memory grows with
it and with the square of the obstacles in a frame: 0.2 GB with 30 of them, 1.6 with 100."""
TRACKING_KEY = "jaxdet.tracking"
TRACKS, LINKS = "tracks.parquet", "track_links.parquet"

_COLUMNS = ("bottom_m", "top_m", "distance_m", "u_min", "u_max")
_READ = ("obstacle", "num_points", "corners_ground", "corners_world", *_COLUMNS)


class LogTracks(NamedTuple):
    """What was found in a log."""

    log: str
    """Its name, and the camera's where it has several."""
    tracks: int
    moving: int
    obstacles: int
    linked: int
    """Obstacles that are in a track."""
    in_world: int
    """Tracks in the world; the others are in the camera's ground frame."""


def track_results(folder: Path, config: TrackConfig | None = None) -> list[LogTracks]:
    """Links the obstacles of each log of a results folder over time.

    Writes ``tracks.parquet`` and ``track_links.parquet`` (:mod:`jaxdet.tracks.schemas`) and, where
    there are maps, ``tracks_LOG.png``: all of them or none, whatever ends the process.

    Args:
        folder: What ``jaxdet run`` wrote; tracks that are there are replaced.
        config: What links obstacles.

    Returns:
        What was found, by log.

    Raises:
        InputError: It is no whole results folder, or can't be written to.
        ConfigError: A run or another tracking works there.
        OutputError: The disk is full or broken.
    """
    config, found = config or TrackConfig(), []
    with _staging(folder) as staging, Results(folder) as results:
        metadata = _metadata(results, config)
        with (
            _Writer(staging / TRACKS, TRACKS_SCHEMA, metadata) as table,
            _Writer(staging / LINKS, LINKS_SCHEMA, metadata) as links,
        ):
            for log in results.logs:
                tracks, numbers, rows = _log_tracks(results, log, config)
                table.write(_track_table(log, tracks, numbers))
                links.write(rows)
                found.append(_summary(log.label, tracks, rows))
                image = results.map(log)
                if image is not None:
                    paths = [(t.path, t.moving) for t in tracks if t.in_world]
                    picture = draw_map(image, log.label, paths)
                    write_png(staging / f"tracks_{log.file_name}.png", picture)
        _commit(staging, folder)
    return found


def _log_tracks(
    results: Results, log: ResultLog, config: TrackConfig
) -> tuple[list[Track], np.ndarray, pa.Table]:
    """The tracks of a log, the numbers of its frames, and its rows of ``track_links.parquet``."""
    color = (log.summary["calibration"] or {}).get("color") or {}
    tracker, start = Tracker(config), 0
    numbers: list[np.ndarray] = [np.zeros(0, np.int64)]
    keys = pa.schema(list(LINKS_SCHEMA)[:-1])
    rows = [keys.empty_table()]
    for chunk in results.chunks(log, ("frame", "stamp_ns"), _READ, WINDOW_FRAMES):
        numbers.append(chunk.frames["frame"].to_numpy())
        stamps, first = chunk.frames["stamp_ns"].to_numpy(), chunk.first
        frame = np.repeat(np.arange(len(stamps)), np.diff(first))
        columns = {name: chunk.obstacles[name].to_numpy() for name in _COLUMNS}
        columns |= {name: _corners(chunk, name) for name in ("corners_ground", "corners_world")}
        seen = obstacles_seen(start + frame, stamps[frame], columns, color.get("width"))
        tracker.add(stamps, seen, chunk.obstacles["num_points"].to_numpy())
        rows.append(chunk.obstacles.select(keys.names).cast(keys))
        start += len(stamps)
    tracks, track_of = tracker.finish()
    labels = pa.array(track_of, pa.int32(), mask=track_of < 0)
    links = pa.concat_tables(rows).append_column(LINKS_SCHEMA.field("track"), labels)
    return tracks, np.concatenate(numbers), links


def _corners(chunk: Chunk, name: str) -> np.ndarray:
    """``(N, 8)`` float32, NaN where null."""
    column = chunk.obstacles[name].combine_chunks()
    column = column.chunk(0) if isinstance(column, pa.ChunkedArray) else column
    values = column.values.to_numpy(zero_copy_only=False).reshape(-1, 8)
    values = values[column.offset : column.offset + len(column)]
    known = column.is_valid().to_numpy(zero_copy_only=False)
    return np.where(known[:, None], values, np.float32(np.nan))


def _track_table(log: ResultLog, tracks: list[Track], numbers: np.ndarray) -> pa.Table:
    first = numbers[[t.first_frame for t in tracks]] if tracks else []
    last = numbers[[t.last_frame for t in tracks]] if tracks else []
    columns = [
        [log.name] * len(tracks), [log.camera] * len(tracks), range(len(tracks)),
        [t.in_world for t in tracks], first, last,
        [t.first_stamp_ns for t in tracks], [t.last_stamp_ns for t in tracks],
        [t.frames for t in tracks], [t.obstacles for t in tracks], [t.moving for t in tracks],
        [t.mean_speed_mps for t in tracks], [t.max_speed_mps for t in tracks],
        [t.length_m for t in tracks], [t.width_m for t in tracks],
        [None if np.isnan(t.top_m) else t.top_m for t in tracks],
        [t.path.ravel() for t in tracks], [t.speed for t in tracks],
    ]  # fmt: skip
    arrays = [pa.array(c, f.type) for c, f in zip(columns, TRACKS_SCHEMA, strict=True)]
    return pa.Table.from_arrays(arrays, schema=TRACKS_SCHEMA)


def _summary(log: str, tracks: list[Track], rows: pa.Table) -> LogTracks:
    linked = rows.num_rows - rows["track"].null_count
    moving, world = (sum(getattr(t, name) for t in tracks) for name in ("moving", "in_world"))
    return LogTracks(log, len(tracks), moving, rows.num_rows, linked, world)


class _Writer:
    """A Parquet file whose bytes are a function of its rows and of the metadata."""

    def __init__(self, path: Path, schema: pa.Schema, metadata: dict[str, str]) -> None:
        self.sink = open_file(path, "wb")
        self.file = pq.ParquetWriter(
            self.sink,
            schema.with_metadata(metadata),
            compression="zstd",
            compression_level=3,
            write_page_checksum=True,
            use_dictionary=["log", "camera"],  # pyright: ignore[reportArgumentType]
        )

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()
        self.sink.close()

    def write(self, table: pa.Table) -> None:
        """Appends the rows of a log."""
        self.file.write_table(table.replace_schema_metadata(self.file.schema.metadata))


def _metadata(results: Results, config: TrackConfig) -> dict[str, str]:
    """What the tables are made of: the obstacles' own metadata, and how they were linked."""
    tracking = json.dumps(dataclasses.asdict(config), sort_keys=True, separators=(",", ":"))
    return results.metadata | {TRACKING_KEY: tracking}


@contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """Locks a results folder; gives one for new files, in the working folder.

    What another process left half moved is in its place then. An unfinished run stays.
    """
    if not folder.is_dir():
        raise InputError("no such folder", path=str(folder))
    working = folder.absolute() / WORKING
    staging, lock = working / "tracks", Lock(working / "lock")
    try:
        settle(working)
        shutil.rmtree(staging, ignore_errors=True)
        with writing(staging):
            staging.mkdir()
        yield staging
    finally:
        if not (working / JOURNAL).exists():
            shutil.rmtree(staging, ignore_errors=True)
        lock.release()
        with suppress(OSError):
            working.rmdir()  # where nothing is in it


def _commit(staging: Path, folder: Path) -> None:
    """Makes the new files those of the folder."""
    names = TRACKS, LINKS, *(path.name for path in folder.glob("tracks_*.png"))
    old = [name for name in names if (folder / name).is_file()]
    new = {path.name: path for path in staging.iterdir()}
    new |= write_json(staging / MANIFEST, changed_manifest(folder, old, new))
    commit(staging.parent, new, (*old, MANIFEST), [staging.name])
