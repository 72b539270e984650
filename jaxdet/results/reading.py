"""A results folder read back: what ``jaxdet run`` wrote, in order and without holding all of it."""

import dataclasses
import json
import os
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.config import Config
from jaxdet.errors import InputError
from jaxdet.io.files import SUFFIXES
from jaxdet.io.options import LogOptions
from jaxdet.results.arrow import open_file
from jaxdet.results.manifest import MANIFEST
from jaxdet.results.metadata import FORMAT, FORMAT_KEY, VERSION_KEY
from jaxdet.results.names import is_of_one_camera
from jaxdet.results.occupancy import MapImage, load_map
from jaxdet.results.tracked import Mover, TracksInFrames

CHUNK_FRAMES = 1024
"""Frames of a chunk, unless it is asked for otherwise."""

TRACKS, LINKS = "tracks", "track_links"
"""Tables that ``jaxdet track`` adds."""

_AGAIN = "run jaxdet run again, or name another folder"


class ResultLog(NamedTuple):
    """A log whose rows are in the tables."""

    name: str
    camera: str
    label: str
    """The name, and the camera's where the log has several."""
    file_name: str
    """What the names of its files begin with, different for each log of a run."""
    summary: Mapping[str, Any]
    """Its entry in ``summary.json``."""
    first_frame: int
    """Row of its first frame in ``frames.parquet``."""
    first_obstacle: int
    """Row of its first obstacle in ``obstacles.parquet``."""

    @property
    def num_frames(self) -> int:
        """Rows of ``frames.parquet``."""
        return self.summary["frames"]

    @property
    def num_obstacles(self) -> int:
        """Rows of ``obstacles.parquet``."""
        return self.summary["obstacles"]

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files that it was read from, as they were named then."""
        return tuple(map(Path, self.summary["paths"]))

    @property
    def poses_from_tf(self) -> bool:
        """Whether the log's own transforms join the camera to the world.

        Those of a folder of images are made of ``groundtruth.txt``: no other program sees any.
        """
        about = self.summary["description"] or {}
        known = any(path.suffix.lower() in SUFFIXES for path in self.paths)
        is_folder = about.get("is_folder", not known)  # older versions did not say
        return about.get("pose_source", "").startswith("poses: TF") and not is_folder

    def topic(self, role: str) -> str:
        """The topic of the ``color`` or the ``depth`` images; empty where it isn't known."""
        topics = (self.summary["description"] or {}).get("topics", ())
        return next((t["topic"] for t in topics if role in t["chosen_as"].split()), "")


class Chunk(NamedTuple):
    """Whole frames of one log with all their obstacles, in order."""

    frames: pa.Table
    obstacles: pa.Table

    @property
    def first(self) -> np.ndarray:
        """``(F + 1,)`` int64, frame ``i`` has the obstacles ``first[i]`` to ``first[i + 1]``."""
        return np.append(0, np.cumsum(self.frames["num_obstacles"].to_numpy(), dtype=np.int64))

    def each(self) -> Iterator["Frame"]:
        """The frames one by one."""
        rows, parts = self.frames.to_pylist(), self.obstacles.to_pylist()
        for row, (start, stop) in zip(rows, pairwise(self.first.tolist()), strict=True):
            yield Frame(row, parts[start:stop])

    def take(self, rows: np.ndarray) -> "Chunk":
        """Some of the frames ``(n,)``, ascending, with all their obstacles."""
        chosen = np.zeros(self.frames.num_rows, bool)
        chosen[rows] = True
        of = np.repeat(chosen, self.frames["num_obstacles"].to_numpy())
        return Chunk(self.frames.take(rows), self.obstacles.take(np.flatnonzero(of)))


class Frame(NamedTuple):
    """A row of ``frames.parquet`` and its rows of ``obstacles.parquet``, null as None."""

    row: dict[str, Any]
    obstacles: list[dict[str, Any]]

    @property
    def tracks(self) -> Sequence[Mover]:
        """The tracks that it has, of :meth:`Results.frames` where ``jaxdet track`` found some."""
        return self.row.get("tracks", ())


def check_folder(folder: Path) -> None:
    """Raises an error where there is no folder that could hold results.

    Raises:
        InputError: There is none, or a file.
    """
    if not folder.is_dir():
        problem = "a file, not a folder of results" if folder.exists() else "no such folder"
        remedy = "name the folder that jaxdet run --output wrote"
        raise InputError(problem, path=str(folder), remedy=remedy)


class Results:
    """What a run wrote; opening it reads no rows.

    Args:
        folder: The folder that ``jaxdet run --output`` was given.

    Attributes:
        folder: The same, as a path.
        config: What ``config.json`` holds.
        summary: What ``summary.json`` holds.
        metadata: What ``obstacles.parquet`` says of itself, see :mod:`jaxdet.results.metadata`.
        frames_metadata: Likewise ``frames.parquet``; the same, where they belong together.
        version: The jaxdet that wrote it.
        logs: The logs that are in the tables, in their order there.

    Raises:
        InputError: It is no whole results folder, or of a format that this version doesn't read.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = folder = Path(folder)
        check_folder(folder)
        manifest = self._json(MANIFEST)  # the last file to arrive, and the first to leave
        self.summary = self._json("summary.json")
        self.config = self._json("config.json")
        self._frames, self._obstacles = self._table("frames"), self._table("obstacles")
        if self._json(MANIFEST) != manifest:
            problem = "the results were replaced while they were opened"
            raise InputError(problem, path=str(folder), remedy="read them again")
        self._read_on: list[_Rows] = []
        """Tables read up to the end of a log, from where others are read on."""
        self.metadata = _metadata(self._obstacles)
        self.frames_metadata = _metadata(self._frames)
        self.version = self.metadata.get(VERSION_KEY, "")
        self.logs = tuple(self._logs())
        for table, name in ((self._frames, "frames"), (self._obstacles, "obstacles")):
            expected, found = self.summary[name], table.metadata.num_rows
            if found != expected:
                problem = f"{found} rows, but summary.json says {expected}"
                raise InputError(problem, path=str(self._path(name)), remedy=_AGAIN)

    def __enter__(self) -> "Results":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the tables."""
        self._frames.close(force=True)
        self._obstacles.close(force=True)
        for name in {"_tracks", "_links"} & vars(self).keys():
            getattr(self, name).close(force=True)

    @cached_property
    def tracked(self) -> bool:
        """Whether ``jaxdet track`` linked the obstacles, which then have a column ``track``."""
        return self._path(TRACKS).is_file() and self._path(LINKS).is_file()

    def tracks(self, log: ResultLog) -> Iterator[dict[str, Any]]:
        """The rows of ``tracks.parquet`` of a log; none where there are no tracks.

        Raises:
            InputError: They can't be read, or are those of other results.
        """
        if not self.tracked:
            return
        with self._reading():
            own = self._track_rows.get((log.name, log.camera))
            if own is None:
                return
            rows = self._rows(self._tracks, own.start, None, ())
            for first in range(own.start, own.stop, CHUNK_FRAMES):
                yield from rows.take(min(CHUNK_FRAMES, own.stop - first)).to_pylist()
        self._read_on.append(rows)

    @cached_property
    def method(self) -> Config:
        """The configuration that the obstacles were found with."""
        return _restored(Config, self.config)

    @cached_property
    def log_options(self) -> LogOptions:
        """How the logs were read."""
        return _restored(LogOptions, self.config["log"])

    def options_of(self, log: ResultLog) -> LogOptions:
        """How to open the log, or the camera of a log, that some rows are of."""
        return dataclasses.replace(self.log_options, camera=log.camera)

    def log(self, name: str) -> ResultLog:
        """The log of this label, or of this name where one camera of it is in the tables.

        Raises:
            InputError: There is none.
        """
        found = [log for log in self.logs if name in (log.label, log.name)]
        if len(found) != 1:
            names = ", ".join(log.label for log in self.logs) or "no log"
            raise InputError(f"no log {name!r}; it holds {names}", path=str(self.folder))
        return found[0]

    def chunks(
        self,
        log: ResultLog | None = None,
        frames: Sequence[str] | None = None,
        obstacles: Sequence[str] | None = None,
        size: int = CHUNK_FRAMES,
    ) -> Iterator[Chunk]:
        """The rows, some frames at a time, each chunk of one log.

        Memory: a row group's chosen columns, and the chunk.

        Args:
            log: Of this log; None: of all, one after the other.
            frames: Columns of the frames; None: all. ``log``, ``camera``, ``frame`` and
                ``num_obstacles`` come always.
            obstacles: Columns of the obstacles; None: all, with ``track`` where they are
                :attr:`tracked`. ``log``, ``camera`` and ``frame`` come always.
            size: Most frames of a chunk.

        Raises:
            InputError: The tables can't be read, or don't belong together.
        """
        for one in self.logs if log is None else (log,):
            start = one.first_frame, one.first_obstacle
            own = obstacles and [name for name in obstacles if name != "track"]
            linked = self.tracked and (obstacles is None or "track" in obstacles)
            rows = self._rows(
                self._frames, start[0], frames, ("log", "camera", "frame", "num_obstacles")
            )
            parts = self._rows(self._obstacles, start[1], own, ("log", "camera", "frame"))
            links = self._rows(self._links, start[1], ("track",), ("frame",)) if linked else None
            left = one.num_frames
            with self._reading():
                while left:
                    taken = rows.take(min(size, left))
                    if not taken.num_rows:
                        problem = f"summary.json says more frames of {one.label} than there are"
                        raise InputError(problem, path=str(self.folder), remedy=_AGAIN)
                    left -= taken.num_rows
                    count = taken["num_obstacles"].to_numpy()
                    chunk = Chunk(taken, parts.take(int(count.sum(dtype=np.int64))))
                    self._check(one, chunk, count)
                    yield chunk if links is None else self._linked(chunk, links)
            self._read_on += [table for table in (rows, parts, links) if table is not None]

    def frames(
        self,
        log: ResultLog | None = None,
        frames: Sequence[str] | None = None,
        obstacles: Sequence[str] | None = None,
    ) -> Iterator[Frame]:
        """The frames one by one, each with its obstacles; see :meth:`chunks`."""
        for one in self.logs if log is None else (log,):
            tracks = TracksInFrames(self.tracks(one))
            for chunk in self.chunks(one, frames, obstacles):
                for frame in chunk.each():
                    if self.tracked:
                        frame.row["tracks"] = tracks.at(frame.row["frame"])
                    yield frame

    def world_frame(self, log: ResultLog) -> str:
        """The frame that poses, outlines in the world and the map are in; empty without poses."""
        first = next(self.chunks(log, ["world_frame"], [], size=1), None)
        return (first.frames["world_frame"][0].as_py() or "") if first else ""

    def map(self, log: ResultLog) -> MapImage | None:
        """The map of a log; None where it has none."""
        name = log.summary["map"]
        return load_map(self.folder / f"{name}.npz") if name else None

    def pictures(self, log: ResultLog) -> dict[int, Path]:
        """The pictures that were drawn, by frame."""
        paths = (self.folder / name for name in log.summary["pictures"])
        return {int(path.stem.rpartition("_")[2]): path for path in paths if path.is_file()}

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.parquet"

    def _json(self, name: str) -> dict[str, Any]:
        path = self.folder / name
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            problem = f"is no whole results folder ({name} is missing)"
            raise InputError(problem, path=str(self.folder), remedy=_AGAIN) from error
        except OSError as error:
            raise _unread(path, error) from error
        except ValueError as error:
            raise InputError("is not JSON", path=str(path), remedy=_AGAIN) from error
        if not isinstance(found, dict):
            raise InputError("is not a JSON object", path=str(path), remedy=_AGAIN)
        return found

    def _table(self, name: str) -> pq.ParquetFile:
        path = self._path(name)
        try:
            table = pq.ParquetFile(open_file(path, "rb"), page_checksum_verification=True)
        except FileNotFoundError as error:
            problem = f"is no whole results folder ({path.name} is missing)"
            raise InputError(problem, path=str(self.folder), remedy=_AGAIN) from error
        except (pa.ArrowException, OSError) as error:
            if getattr(error, "errno", None):  # else it is Parquet's own
                raise _unread(path, error) from error
            raise InputError("is not a Parquet file", path=str(path), remedy=_AGAIN) from error
        if (found := _metadata(table).get(FORMAT_KEY, "none")) != str(FORMAT):
            problem = f"has format {found} of the tables, not {FORMAT}"
            raise InputError(problem, path=str(path), remedy="run jaxdet run again")
        return table

    def _logs(self) -> Iterator[ResultLog]:
        frame = obstacle = 0
        for entry in self.summary["logs"]:
            if not entry["error"]:
                name, camera = entry["log"], entry["camera"]
                several = is_of_one_camera(entry["file_name"])
                label = f"{name}, {camera}" if several else name
                yield ResultLog(name, camera, label, entry["file_name"], entry, frame, obstacle)
                frame, obstacle = frame + entry["frames"], obstacle + entry["obstacles"]

    def _table_of_tracks(self, name: str) -> pq.ParquetFile:
        """A table that ``jaxdet track`` wrote of these results."""
        table = self._table(name)
        about = _metadata(table)
        if {key: about.get(key) for key in self.metadata} != self.metadata:
            problem = "is not of the results that it lies beside"
            raise InputError(problem, path=str(self._path(name)), remedy="run jaxdet track again")
        return table

    @cached_property
    def _tracks(self) -> pq.ParquetFile:
        return self._table_of_tracks(TRACKS)

    @cached_property
    def _track_rows(self) -> dict[tuple[str, str], range]:
        """The rows of each log and camera, one after the other as in the other tables."""
        found: dict[tuple[str, str], range] = {}
        row = 0
        for group in range(self._tracks.num_row_groups):
            names = self._tracks.read_row_group(group, ["log", "camera"]).to_pydict()
            for of in zip(names["log"], names["camera"], strict=True):
                first = found[of].start if of in found else row
                found[of], row = range(first, row + 1), row + 1
        return found

    @cached_property
    def _links(self) -> pq.ParquetFile:
        return self._table_of_tracks(LINKS)

    def _linked(self, chunk: Chunk, links: "_Rows") -> Chunk:
        """A chunk whose obstacles have their tracks."""
        taken = links.take(chunk.obstacles.num_rows)
        if not taken["frame"].equals(chunk.obstacles["frame"]):
            problem = f"{LINKS}.parquet and obstacles.parquet don't belong together"
            raise InputError(problem, path=str(self.folder), remedy="run jaxdet track again")
        return chunk._replace(obstacles=chunk.obstacles.append_column("track", taken["track"]))

    def _rows(self, file: pq.ParquetFile, start: int, *columns: Any) -> "_Rows":
        """Rows of a table from one on, with these columns of :class:`_Rows`.

        Of small logs one row group holds many, which it would take to read for each of them.
        """
        wanted = file, start, columns
        found = next((rows for rows in self._read_on if rows.at == wanted), None)
        self._read_on = [r for r in self._read_on if (r.at[0], r.at[2]) != (file, columns)]
        return found or _Rows(file, start, *columns)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Tables that are damaged are errors of the input."""
        try:
            yield
        except (pa.ArrowException, OSError) as error:
            problem = f"the tables can't be read ({' '.join(str(error).split())})"
            raise InputError(problem, path=str(self.folder), remedy=_AGAIN) from error

    def _check(self, log: ResultLog, chunk: Chunk, count: np.ndarray) -> None:
        """The chunk is of this log, and its obstacles are of its frames."""
        frame, of = chunk.frames["frame"].to_numpy(), chunk.obstacles["frame"].to_numpy()
        named = all(
            {*table[column].unique().to_pylist()} <= {expected}
            for table in chunk
            for column, expected in (("log", log.name), ("camera", log.camera))
        )
        if not named or not np.array_equal(np.repeat(frame, count), of):
            problem = "frames.parquet and obstacles.parquet don't belong together"
            raise InputError(problem, path=str(self.folder), remedy=_AGAIN)


class _Rows:
    """Rows of a table one after the other."""

    def __init__(
        self,
        file: pq.ParquetFile,
        start: int,
        columns: Sequence[str] | None,
        always: tuple[str, ...],
    ) -> None:
        self.at = file, start, (columns, always)
        """The table, the next row, and the columns asked for."""
        named = None if columns is None else [*always, *(c for c in columns if c not in always)]
        sizes = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
        ends = np.cumsum(sizes, dtype=np.int64)
        group = int(np.searchsorted(ends, start, side="right"))
        groups = list(range(group, len(sizes)))
        names = file.schema_arrow.names if named is None else named
        self.schema = pa.schema([file.schema_arrow.field(name) for name in names])
        self._batches = _batches(file, groups, named)
        self._waiting: list[pa.RecordBatch] = []
        self._skip = start - int(ends[group - 1]) if group else start

    def take(self, count: int) -> pa.Table:
        """The next ``count`` rows, fewer where the table ends."""
        found: list[pa.RecordBatch] = []
        while count:
            batch = self._waiting.pop() if self._waiting else next(self._batches, None)
            if batch is None:
                break
            skip, self._skip = min(self._skip, batch.num_rows), max(0, self._skip - batch.num_rows)
            batch = batch.slice(skip)
            part = batch.slice(0, count)
            if part.num_rows < batch.num_rows:
                self._waiting.append(batch.slice(count))
            if part.num_rows:
                found.append(part.select(self.schema.names))
            count -= part.num_rows
        taken, (file, row, columns) = sum(part.num_rows for part in found), self.at
        self.at = file, row + taken, columns
        return pa.Table.from_batches(found, schema=self.schema).combine_chunks()


def _batches(
    file: pq.ParquetFile,
    groups: Iterable[int],
    columns: Sequence[str] | None = None,
    size: int = 2048,
) -> Iterator[pa.RecordBatch]:
    """The rows of some row groups, at most ``size`` together, each by a reader of its own.

    One of them all would keep some of what it has read of each.
    """
    for group in groups:
        yield from file.iter_batches(size, [group], columns)


def _unread(path: Path, error: OSError) -> InputError:
    """The error of a file that the system doesn't give, whatever is in it."""
    problem = f"can't be read ({os.strerror(error.errno or 0)})"
    return InputError(problem, path=str(path), remedy="check its permissions and its disk")


def _metadata(table: pq.ParquetFile) -> dict[str, str]:
    own = (table.metadata.metadata or {}).items()
    return {k.decode(): v.decode("utf-8", "replace") for k, v in own if k.startswith(b"jaxdet.")}


def _restored(kind: type, values: Mapping[str, Any]) -> Any:
    """A dataclass from what JSON holds of it."""
    hints, found = typing.get_type_hints(kind), {}
    for field in dataclasses.fields(kind):
        if field.name in values:
            value, hint = values[field.name], hints[field.name]
            if dataclasses.is_dataclass(hint) and isinstance(hint, type):
                value = _restored(hint, value)
            found[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**found)
