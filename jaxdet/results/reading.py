"""Reader of the results of ``jaxdet run``, which holds only a part of the rows in memory."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import cached_property
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.config import Config
from jaxdet.config_changes import changed
from jaxdet.errors import InputError, JaxdetError, printable
from jaxdet.io.options import LogOptions
from jaxdet.results.json_files import (
    AGAIN,
    SUMMARY_SHAPE,
    check_shape,
    entries_of,
    leads_out,
    read_json,
    unread,
)
from jaxdet.results.layout import (
    CONFIG,
    FAILED,
    FRAMES,
    LINKS,
    MANIFEST,
    OBSTACLES,
    RUN,
    SUMMARY,
    TRACKS,
    check_folder,
    is_complete,
    is_run,
    log_folders,
)
from jaxdet.results.manifest import read_manifest
from jaxdet.results.names import camera_name, export_name
from jaxdet.results.occupancy import MapImage, load_map
from jaxdet.results.record import digest
from jaxdet.results.schemas import FRAMES_SCHEMA, LINKS_SCHEMA, OBSTACLES_SCHEMA, TRACKS_SCHEMA
from jaxdet.results.tables import Frame, Tables, TracksInFrames, open_file
from jaxdet.results.writer import FORMAT, FORMAT_KEY

CHUNK_FRAMES = 1024
"""Number of frames read together, by default."""

LINKED = tuple(LINKS_SCHEMA.names[4:])
"""Columns of ``track_links.parquet`` that ``jaxdet track`` adds to obstacles."""
TABLES = {
    FRAMES: FRAMES_SCHEMA, OBSTACLES: OBSTACLES_SCHEMA, TRACKS: TRACKS_SCHEMA, LINKS: LINKS_SCHEMA
}  # fmt: skip
"""Schema of each table, by file name."""
MOST_NAMED = 6
"""Maximum number of logs that an error names."""


class ResultLog(NamedTuple):
    """A log, or a camera of a log, whose rows are in the tables."""

    name: str
    camera: str
    label: str
    """Name of the log, followed by the camera's name if the log has several cameras."""
    folder: Path
    """Folder of its results."""
    several: bool
    """Whether the log has several cameras in the tables."""
    summary: Mapping[str, Any]
    """Entry in ``summary.json``."""
    first_frame: int
    """Row of its first frame in ``frames.parquet``."""
    first_obstacle: int
    """Row of its first obstacle in ``obstacles.parquet``."""

    @property
    def file_name(self) -> str:
        """Prefix of the names of the log's files in an export, different for each log of a run."""
        return export_name(self.name, self.camera if self.several else "")

    @property
    def suffix(self) -> str:
        """Suffix of the file names of the log's map and of its picture of tracks."""
        return f"_{camera_name(self.camera)}" if self.several else ""

    @property
    def num_frames(self) -> int:
        """Number of the log's rows in ``frames.parquet``."""
        return self.summary["frames"]

    @property
    def num_obstacles(self) -> int:
        """Number of the log's rows in ``obstacles.parquet``."""
        return self.summary["obstacles"]

    @property
    def paths(self) -> tuple[Path, ...]:
        """Files that the log was read from, by their paths at that time."""
        return tuple(map(Path, self.summary["paths"]))

    @property
    def poses_from_tf(self) -> bool:
        """Whether the log itself has transforms from the camera to the world, for other readers.

        Poses of a folder of images come from ``groundtruth.txt`` instead.
        """
        about = self.summary["description"]
        return about and about["pose_source"].startswith("poses: TF") and not about["is_folder"]

    def topic(self, role: str) -> str:
        """Return the topic of the ``color`` or the ``depth`` images; empty if it is unknown."""
        topics = (self.summary["description"] or {}).get("topics", ())
        return next((t["topic"] for t in topics if role in t["chosen_as"].split()), "")


class LogFailure(NamedTuple):
    """Log without results."""

    log: str
    """Name of the log."""
    reason: str
    summary: Mapping[str, Any]
    """Entry as in ``summary.json``."""


def _failure(entry: Mapping[str, Any]) -> LogFailure:
    return LogFailure(entry["log"], entry["error"] or "", entry)


def open_results(folder: str | PathLike[str]) -> "Results":
    """Open results of ``jaxdet run``: all logs of a run, or one log.

    Only logs with a manifest are opened, so logs that a run has not completed are left out. Opening
    reads no rows.

    >>> with jaxdet.open_results("results") as results:           # doctest: +SKIP
    ...     frames, obstacles = results.tables()

    Args:
        folder: Folder that ``jaxdet run --output`` wrote, or the folder of a log in it.

    Raises:
        InputError: The folder holds no complete results, or results of another format.
    """
    return Results(folder)


class Results:
    """Results of logs, see :func:`open_results`.

    Args:
        folder: Folder of a run or of one log.

    Attributes:
        folder: Folder of the results, as a path.
        config: Content of ``config.json``, which is the same for all logs.
        logs: Logs with results, by name; a log with several cameras has an entry for each.
        failed: Logs, or single cameras of logs, that failed and have no rows.
        stale: Names of folders with results of another configuration or version than ``run.json``,
            which are left out; a run with --overwrite has not replaced them yet.
    """

    def __init__(self, folder: str | PathLike[str]) -> None:
        self.folder = folder = Path(folder)
        check_folder(folder)
        self.stale: list[str] = []
        self.manifests: dict[Path, dict[str, Any]] = {}
        """Content of ``manifest.json``, by the folder of each log with results."""
        self.summaries: dict[Path, dict[str, Any]] = {}
        """Content of ``summary.json``, by the folder of each log with results."""
        self.failed: list[LogFailure] = []
        self.logs = tuple(self._find())
        self.config = self._read_config()
        self.version = str(self.config_source.get("jaxdet", ""))
        """Version of jaxdet that made the results."""
        self._open: list[pq.ParquetFile] = []

    def __enter__(self) -> "Results":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the tables."""
        while self._open:
            self._open.pop().close(force=True)

    def _find(self) -> Iterator[ResultLog]:
        """Yield the logs with results; add other logs to ``failed`` and ``stale``."""
        if is_complete(self.folder):
            yield from self._logs_of(self.folder, read_manifest(self.folder))
            return
        if not is_run(self.folder):
            problem = f"holds no results ({MANIFEST} and {RUN} are missing)"
            raise InputError(problem, path=str(self.folder), remedy=AGAIN)
        run = digest(read_json(self.folder / RUN))
        found: list[ResultLog] = []
        for name, folder in log_folders(self.folder).items():
            if not is_complete(folder):
                content = read_json(folder / FAILED)
                self.failed += map(_failure, entries_of(content, folder / FAILED))
            elif (manifest := read_manifest(folder)).get("run") != run:
                self.stale.append(name)
            else:
                found += self._logs_of(folder, manifest)
        yield from sorted(found, key=lambda log: (log.name, log.camera))

    def _logs_of(self, folder: Path, manifest: dict[str, Any]) -> Iterator[ResultLog]:
        """Yield the cameras of a log with results."""
        summary = read_json(folder / SUMMARY)
        if read_json(folder / MANIFEST) != manifest:
            problem = "the results were replaced while they were opened"
            raise InputError(problem, path=str(folder), remedy="read them again")
        self.manifests[folder], self.summaries[folder] = manifest, summary
        entries = entries_of(summary, folder / SUMMARY)
        check_shape(summary, SUMMARY_SHAPE, folder / SUMMARY)
        frame = obstacle = 0
        for entry in entries:
            name, camera = entry["log"], entry["camera"]
            if entry["error"]:
                self.failed.append(_failure(entry))
                continue
            several = "@" in str(entry.get("file_name"))
            label = f"{name}, {camera}" if several else name
            yield ResultLog(name, camera, label, folder, several, entry, frame, obstacle)
            frame, obstacle = frame + entry["frames"], obstacle + entry["obstacles"]

    def _read_config(self) -> dict[str, Any]:
        """Return the configuration of the logs; set ``config_source``, which names the version."""
        if self.manifests:
            folder, self.config_source = next(iter(self.manifests.items()))
            return read_json(folder / CONFIG)
        record = read_json(self.folder / RUN)
        self.config_source = record.get("about", {})
        return record.get("config", {})

    def tables(self, log: ResultLog | None = None) -> Tables:
        """Return the rows of a log, or of all logs one after the other, in memory.

        Raises:
            InputError: The tables can't be read.
        """
        frames, obstacles = [], []
        for chunk in self.chunks(log, size=1 << 16):
            frames.append(chunk.frames)
            obstacles.append(chunk.obstacles)
        if not frames:
            return Tables(FRAMES_SCHEMA.empty_table(), OBSTACLES_SCHEMA.empty_table())
        # Logs without tracks get null in the columns of tracks.
        return Tables(
            pa.concat_tables(frames), pa.concat_tables(obstacles, promote_options="default")
        )

    def metadata(self, log: ResultLog, table: str = OBSTACLES) -> dict[str, str]:
        """Return the metadata of a table of a log, see :mod:`jaxdet.results.writer`."""
        with self._table(log, table) as file:
            return _metadata(file)

    def tracked(self, log: ResultLog) -> bool:
        """Return whether ``jaxdet track`` linked the obstacles of a log."""
        files = self.manifests[log.folder]["files"]
        return TRACKS in files and LINKS in files

    def tracks(self, log: ResultLog) -> Iterator[dict[str, Any]]:
        """Yield the rows of ``tracks.parquet`` of a log; none if it has no tracks.

        Raises:
            InputError: The tracks can't be read, or belong to other results.
        """
        if not self.tracked(log):
            return
        with self._table(log, TRACKS) as file:
            for batch in file.iter_batches(CHUNK_FRAMES):
                points, numbers = (
                    batch[name].value_lengths().to_numpy() for name in ("speed_mps", "path")
                )
                if not np.all((points > 0) & (numbers == 2 * points)):
                    problem = "a path has not two numbers for each of its speeds"
                    raise InputError(problem, path=str(log.folder / TRACKS), remedy=_TRACK_AGAIN)
                yield from (row for row in batch.to_pylist() if row["camera"] == log.camera)

    @cached_property
    def method(self) -> Config:
        """Configuration that the obstacles were found with."""
        return Config(**{name: self._section(part, name) for name, part in vars(Config()).items()})

    @cached_property
    def log_options(self) -> LogOptions:
        """Options that the logs were read with."""
        return self._section(LogOptions(), "log")

    def _section(self, section: Any, name: str) -> Any:
        """Return a section of the configuration with its values in ``config.json``."""
        try:
            return changed(section, self.config[name], name, "")
        except (JaxdetError, AttributeError, ValueError, KeyError, OverflowError) as error:
            path = str(next(iter(self.manifests), self.folder) / CONFIG)
            problem = f"is not a configuration ({printable(str(error))[:200]})"
            raise InputError(problem, path=path, remedy=AGAIN) from error

    def options_of(self, log: ResultLog) -> LogOptions:
        """Return the options with which the log is opened again, for the same camera."""
        return dataclasses.replace(self.log_options, camera=log.camera)

    def log(self, name: str) -> ResultLog:
        """Return the log with a label, or with a name if only one of its cameras is in the tables.

        Raises:
            InputError: There is no such log.
        """
        found = [log for log in self.logs if name in (log.label, log.name)]
        if len(found) != 1:
            names = ", ".join(log.label for log in self.logs[:MOST_NAMED]) or "no log"
            names += ", ..." if len(self.logs) > MOST_NAMED else ""
            raise InputError(f"no log {name!r}; it holds {names}", path=str(self.folder))
        return found[0]

    def chunks(
        self,
        log: ResultLog | None = None,
        frames: Sequence[str] | None = None,
        obstacles: Sequence[str] | None = None,
        size: int = CHUNK_FRAMES,
    ) -> Iterator[Tables]:
        """Yield the rows of logs, some frames of one log at a time.

        The chosen columns of a row group are in memory, besides the rows that are yielded.

        Args:
            log: The log; by default all logs, one after the other.
            frames: Columns of the frames, by default all; ``log``, ``camera``, ``frame`` and
                ``num_obstacles`` are always included.
            obstacles: Columns of the obstacles, by default all, with :data:`LINKED` if the log is
                :meth:`tracked`; ``log``, ``camera`` and ``frame`` are always included.
            size: Maximum number of frames at a time.

        Raises:
            InputError: The tables can't be read, or don't belong together.
        """
        own = obstacles and [name for name in obstacles if name not in LINKED]
        wanted = LINKED if obstacles is None else [name for name in LINKED if name in obstacles]
        always = ("log", "camera", "frame")
        for one in self.logs if log is None else (log,):
            linked = self.tracked(one) and wanted
            with (
                self._table(one, FRAMES) as frame_file,
                self._table(one, OBSTACLES) as obstacle_file,
                self._table(one, LINKS) if linked else nullcontext() as link_file,
            ):
                rows = _Rows(frame_file, one.first_frame, frames, (*always, "num_obstacles"))
                parts = _Rows(obstacle_file, one.first_obstacle, own, always)
                links = link_file and _Rows(link_file, one.first_obstacle, wanted, ("frame",))
                left = one.num_frames
                while left:
                    taken = rows.take(min(size, left))
                    if not taken.num_rows:
                        problem = f"summary.json says more frames of {one.label} than there are"
                        raise InputError(problem, path=str(one.folder), remedy=AGAIN)
                    left -= taken.num_rows
                    count = taken["num_obstacles"].to_numpy()
                    chunk = Tables(taken, parts.take(int(count.sum(dtype=np.int64))))
                    _check(one, chunk, count)
                    yield chunk if links is None else _linked(one, chunk, links)

    def frames(
        self,
        log: ResultLog | None = None,
        frames: Sequence[str] | None = None,
        obstacles: Sequence[str] | None = None,
    ) -> Iterator[Frame]:
        """Yield the frames one by one, each with its obstacles; see :meth:`chunks`."""
        for one in self.logs if log is None else (log,):
            tracks = TracksInFrames(self.tracks(one))
            for chunk in self.chunks(one, frames, obstacles):
                for frame in chunk.each():
                    if self.tracked(one):
                        frame.row["tracks"] = tracks.at(frame.row["frame"])
                    yield frame

    def world_frame(self, log: ResultLog) -> str:
        """Return the frame of poses, outlines in the world and the map; empty without poses."""
        first = next(self.chunks(log, ["world_frame"], [], size=1), None)
        return (first.frames["world_frame"][0].as_py() or "") if first else ""

    def map(self, log: ResultLog) -> MapImage | None:
        """Return the map of a log; None if it has none."""
        return load_map(log.folder / f"map{log.suffix}.npz") if log.summary["map"] else None

    def pictures(self, log: ResultLog) -> dict[int, Path]:
        """Return the paths of a log's pictures, by frame number."""
        names = [name for name in log.summary["pictures"] if not leads_out(name)]
        paths = (log.folder / name for name in names)
        numbers = [(path.stem.rpartition("_")[2], path) for path in paths if path.is_file()]
        return {int(number): path for number, path in numbers if number.isdecimal()}

    @contextmanager
    def _table(self, log: ResultLog, name: str) -> Iterator[pq.ParquetFile]:
        """Open a table of a log, and check that it belongs to the other files.

        Errors that a damaged table causes in the ``with`` block are raised as InputError.
        """
        path = log.folder / name
        table = open_table(path)
        self._open.append(table)
        try:
            if name in (FRAMES, OBSTACLES):
                expected = self.summaries[log.folder][path.stem]
                if (found := table.metadata.num_rows) != expected:
                    problem = f"{found} rows, but summary.json says {expected}"
                    raise InputError(problem, path=str(path), remedy=AGAIN)
            elif not self.metadata(log).items() <= _metadata(table).items():
                problem = "belongs to other results than those in its folder"
                raise InputError(problem, path=str(path), remedy=_TRACK_AGAIN)
            yield table
        except (pa.ArrowException, OSError) as error:
            problem = f"the tables can't be read ({' '.join(str(error).split())})"
            raise InputError(problem, path=str(log.folder), remedy=AGAIN) from error
        finally:
            if table in self._open:
                self._open.remove(table)
            table.close(force=True)


_TRACK_AGAIN = "run jaxdet track again"


def open_table(path: Path) -> pq.ParquetFile:
    """Open a table of results.

    Raises:
        InputError: The table is missing, can't be read, or is of another format.
    """
    try:
        if path.exists() and not path.is_file():  # opening a pipe would block
            raise InputError("is not a file", path=str(path), remedy=AGAIN)
        table = pq.ParquetFile(open_file(path, "rb"), page_checksum_verification=True)
    except FileNotFoundError as error:
        problem = f"has no complete results ({path.name} is missing)"
        raise InputError(problem, path=str(path.parent), remedy=AGAIN) from error
    except (pa.ArrowException, OSError) as error:
        if getattr(error, "errno", None):  # otherwise the content is damaged
            raise unread(path, error) from error
        raise InputError("is not a Parquet file", path=str(path), remedy=AGAIN) from error
    if (found := _metadata(table).get(FORMAT_KEY, "none")) != str(FORMAT):
        problem = f"has format {found} of the tables, not {FORMAT}"
        raise InputError(problem, path=str(path), remedy="run jaxdet run again")
    own = {field.name: field for field in table.schema_arrow}
    for field in TABLES[path.name]:
        if field.name not in own or own[field.name] != field:
            problem = f"column {field.name} is missing, or not as jaxdet writes it"
            again = _TRACK_AGAIN if path.name in (TRACKS, LINKS) else AGAIN
            raise InputError(problem, path=str(path), remedy=again)
    return table


def _linked(log: ResultLog, chunk: Tables, links: "_Rows") -> Tables:
    """Return a chunk whose obstacles have the columns of their tracks."""
    taken = links.take(chunk.obstacles.num_rows)
    if not taken["frame"].equals(chunk.obstacles["frame"]):
        problem = f"{LINKS} and {OBSTACLES} don't belong together"
        raise InputError(problem, path=str(log.folder), remedy=_TRACK_AGAIN)
    obstacles = chunk.obstacles
    for name in taken.column_names[1:]:
        obstacles = obstacles.append_column(taken.schema.field(name), taken[name])
    return chunk._replace(obstacles=obstacles)


def _check(log: ResultLog, chunk: Tables, count: np.ndarray) -> None:
    """Check that rows belong to a log, and the obstacles to the frames."""
    frame, of = chunk.frames["frame"].to_numpy(), chunk.obstacles["frame"].to_numpy()
    named = all(
        {*table[column].unique().to_pylist()} <= {expected}
        for table in chunk
        for column, expected in (("log", log.name), ("camera", log.camera))
    )
    if not named or not np.array_equal(np.repeat(frame, count), of):
        problem = f"{FRAMES} and {OBSTACLES} don't belong together"
        raise InputError(problem, path=str(log.folder), remedy=AGAIN)


class _Rows:
    """Rows of a table, which are taken one after the other."""

    def __init__(
        self,
        file: pq.ParquetFile,
        start: int,
        columns: Sequence[str] | None,
        always: tuple[str, ...],
    ) -> None:
        named = None if columns is None else [*always, *(c for c in columns if c not in always)]
        sizes = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
        ends = np.cumsum(sizes, dtype=np.int64)
        group = int(np.searchsorted(ends, start, side="right"))
        names = file.schema_arrow.names if named is None else named
        schema = pa.schema([file.schema_arrow.field(name) for name in names])
        # Each row group has its own reader, as one reader would keep parts of all groups in memory.
        groups = range(group, len(sizes))
        self._batches = chain.from_iterable(file.iter_batches(2048, [g], named) for g in groups)
        self._waiting = schema.empty_table()
        skipped = start - sum(sizes[:group])  # rows of other cameras
        for first in range(0, skipped, CHUNK_FRAMES):
            self.take(min(CHUNK_FRAMES, skipped - first))

    def take(self, count: int) -> pa.Table:
        """Return the next ``count`` rows, or fewer at the end of the table."""
        waiting = self._waiting
        while waiting.num_rows < count and (batch := next(self._batches, None)) is not None:
            part = pa.Table.from_batches([batch.select(waiting.column_names)], waiting.schema)
            waiting = pa.concat_tables([waiting, part])
        self._waiting = waiting.slice(count)
        return waiting.slice(0, count).combine_chunks()


def _metadata(table: pq.ParquetFile) -> dict[str, str]:
    own = (table.metadata.metadata or {}).items()
    return {k.decode(): v.decode("utf-8", "replace") for k, v in own if k.startswith(b"jaxdet.")}
