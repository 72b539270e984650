"""Rows of the tables of results in memory: as Arrow tables, and frame by frame with their tracks.

Arrow arrays are made from the memory of NumPy arrays: ``pa.array`` and, in earlier versions,
``to_pandas_dtype`` import pandas if it is installed, which takes a third of a second and 40 MB in
each process.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa

from jaxdet.elementary import hypot
from jaxdet.results.durable import writing
from jaxdet.results.rows import Lists
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA

_NUMPY = {
    pa.int8(): np.int8,
    pa.int32(): np.int32,
    pa.int64(): np.int64,
    pa.float32(): np.float32,
    pa.float64(): np.float64,
}


class Mover(NamedTuple):
    """State of a track at a frame, even if the frame does not show it."""

    track: int
    in_world: bool
    """Whether the path is in the world; otherwise it is in the camera's ground frame."""
    moving: bool
    path: np.ndarray
    """Path of the track up to this frame, or its position if it stands, ``(n, 2)`` float64 [m]."""
    velocity: np.ndarray
    """Velocity ``(2,)`` float64 [m/s]."""


class TracksInFrames:
    """Look-up of the tracks at each frame of a log; frames are requested in order.

    Args:
        tracks: Rows of ``tracks.parquet``, in order.
    """

    def __init__(self, tracks: Iterable[Mapping[str, Any]]) -> None:
        self._tracks: Iterator[Mapping[str, Any]] = iter(tracks)
        self._next = next(self._tracks, None)
        self._there: list[tuple[int, Mapping[str, Any]]] = []
        self._row = -1

    def at(self, frame: int) -> list[Mover]:
        """Return the tracks at the next frame, whose number is ``frame``."""
        self._row += 1
        while self._next is not None and self._next["first_frame"] <= frame:
            path = np.reshape(self._next["path"], (-1, 2)).astype(np.float64)
            velocity = _velocities(path, np.asarray(self._next["speed_mps"], np.float64))
            self._there.append((self._row, {**self._next, "path": path, "velocity": velocity}))
            self._next = next(self._tracks, None)
        self._there = [(row, track) for row, track in self._there if track["last_frame"] >= frame]
        return [_mover(track, self._row - row) for row, track in self._there]


def _mover(track: Mapping[str, Any], point: int) -> Mover:
    point = min(point, len(track["path"]) - 1)
    about = track["track"], track["in_world"], track["moving"]
    return Mover(*about, track["path"][: point + 1], track["velocity"][point])


def _velocities(path: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return the velocities ``(n, 2)`` at the points of a path, along it, from speeds ``(n,)``."""
    way = np.concatenate([path[1:], path[-1:]]) - np.concatenate([path[:1], path[:-1]])
    return speed[:, None] * way / np.maximum(hypot(*way.T), 1e-9)[:, None]


class Frame(NamedTuple):
    """A row of ``frames.parquet`` and its rows of ``obstacles.parquet``, with None for null."""

    row: dict[str, Any]
    obstacles: list[dict[str, Any]]

    @property
    def tracks(self) -> Sequence[Mover]:
        """Tracks in the frame, if it is one of :meth:`Results.frames` of a tracked log."""
        return self.row.get("tracks", ())


class Tables(NamedTuple):
    """Frames with all their obstacles, in order."""

    frames: pa.Table
    """Rows of ``frames.parquet``."""
    obstacles: pa.Table
    """Rows of ``obstacles.parquet``; rows of tracked logs have the columns
    :data:`jaxdet.results.reading.LINKED` too."""

    @classmethod
    def of(cls, frames: Mapping[str, Any], obstacles: Mapping[str, Any]) -> "Tables":
        """Build the tables from columns, see :func:`to_table`."""
        return cls(to_table(frames, FRAMES_SCHEMA), to_table(obstacles, OBSTACLES_SCHEMA))

    @property
    def first(self) -> np.ndarray:
        """Row of each frame's first obstacle, then the number of obstacles, ``(F + 1,)`` int64."""
        return np.append(0, np.cumsum(self.frames["num_obstacles"].to_numpy(), dtype=np.int64))

    def each(self) -> Iterator[Frame]:
        """Yield the frames one by one."""
        rows, parts = self.frames.to_pylist(), self.obstacles.to_pylist()
        for row, (start, stop) in zip(rows, pairwise(self.first.tolist()), strict=True):
            yield Frame(row, parts[start:stop])

    def take(self, rows: np.ndarray) -> "Tables":
        """Return the frames at ``rows``, ``(n,)`` ascending, with all their obstacles."""
        chosen = np.zeros(self.frames.num_rows, bool)
        chosen[rows] = True
        of = np.repeat(chosen, self.frames["num_obstacles"].to_numpy())
        return Tables(self.frames.take(rows), self.obstacles.take(np.flatnonzero(of)))

    def save(self, path: Path) -> None:
        """Write the rows to a temporary file, whose folder is made if it is missing.

        Raises:
            OutputError: The disk is full or broken.
        """
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with open_file(path, "wb") as file:
                for table in self:
                    with pa.ipc.new_stream(file, table.schema) as stream:
                        stream.write_table(table)

    @classmethod
    def load(cls, path: Path) -> "Tables":
        """Return the rows that :meth:`save` wrote, mapped into memory."""
        file = map_file(path)
        return cls(*(pa.ipc.open_stream(file).read_all() for _ in cls._fields))


def to_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Return columns as an Arrow table.

    Args:
        columns: Columns by the names of the fields, see :func:`to_array`.
        schema: One of :mod:`jaxdet.results.schemas`.
    """
    return pa.Table.from_arrays([to_array(columns[f.name], f) for f in schema], schema=schema)


def open_file(path: Path, mode: Literal["rb", "wb"]) -> pa.NativeFile:
    """Open a file for Arrow, whose own functions refuse paths that aren't UTF-8.

    Raises:
        OSError: It can't be opened.
    """
    return pa.OSFile(os.fsencode(path), mode)


def map_file(path: Path) -> pa.NativeFile:
    """Map a file into memory for Arrow, even if its path isn't UTF-8.

    Raises:
        OSError: It can't be opened.
    """
    return pa.memory_map(os.fsencode(path))


def to_array(values: Any, field: pa.Field) -> pa.Array:
    """Return a column as an Arrow array.

    Args:
        values: ``(R,)`` numbers, booleans or strings, ``(R, n)`` for lists of n, or
            :class:`jaxdet.results.rows.Lists`. In a nullable field, masked values, NaN and lists
            that contain such values are null.
        field: Field of the column, with its type and whether it is nullable.
    """
    if isinstance(values, Lists):
        flat = _numbers(values.values, field.type.value_type)
        offsets = np.ascontiguousarray(values.offsets, np.int32)
        return _array(field.type, values.null, [pa.py_buffer(offsets)], [flat])
    null, data = np.zeros(len(values), bool), np.ma.getdata(values)
    if field.nullable:
        none = np.ma.getmaskarray(values)
        if np.issubdtype(data.dtype, np.floating):
            none = none | np.isnan(data)
        data, null = np.where(none, 0, data), np.asarray(none.any(axis=tuple(range(1, none.ndim))))
    if pa.types.is_fixed_size_list(field.type):
        flat = _numbers(data.reshape(-1), field.type.value_type)
        return _array(field.type, null, [], [flat])
    if pa.types.is_string(field.type):
        return _strings(data, null)
    return _numbers(data, field.type, null)


def _numbers(values: np.ndarray, kind: pa.DataType, null: np.ndarray | None = None) -> pa.Array:
    if pa.types.is_boolean(kind):
        memory = np.packbits(np.asarray(values, bool), bitorder="little")
    else:
        memory = np.ascontiguousarray(values, _NUMPY[kind])
    null = np.zeros(len(values), bool) if null is None else null
    return _array(kind, null, [pa.py_buffer(memory)])


def _strings(values: np.ndarray, null: np.ndarray) -> pa.Array:
    given = np.where(null, "", values).tolist()
    known = {text: text.encode() for text in set(given)}
    texts = [known[text] for text in given]
    ends = np.zeros(len(texts) + 1, np.int32)
    np.cumsum([len(text) for text in texts], out=ends[1:])
    return _array(pa.string(), null, [pa.py_buffer(ends), pa.py_buffer(b"".join(texts))])


def _array(
    kind: pa.DataType,
    null: np.ndarray,
    buffers: list[pa.Buffer],
    children: list[pa.Array] | None = None,
) -> pa.Array:
    count = int(np.count_nonzero(null))
    valid = pa.py_buffer(np.packbits(~null, bitorder="little")) if count else None
    return pa.Array.from_buffers(kind, len(null), [valid, *buffers], count, children=children)


def list_array(column: pa.ChunkedArray) -> pa.ListArray:
    """Return a column of lists as one array."""
    array = column.combine_chunks()
    return array.chunk(0) if isinstance(array, pa.ChunkedArray) else array


def vectors(column: pa.ChunkedArray, size: int) -> np.ndarray:
    """Return vectors ``(N, size)`` of the column's type, NaN for null."""
    values = list_array(column).flatten().to_numpy().reshape(-1, size)
    found = np.full((len(column), size), np.nan, values.dtype)
    found[column.is_valid().to_numpy()] = values
    return found
