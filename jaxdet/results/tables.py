"""Rows of the two tables of results in memory, as Arrow tables."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from jaxdet.results.arrow import map_file, open_file, to_array
from jaxdet.results.durable import writing
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.tracked import Mover


class Frame(NamedTuple):
    """A row of ``frames.parquet`` and its rows of ``obstacles.parquet``, null as None."""

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
    """Rows of ``obstacles.parquet``; those of tracked logs have the columns
    :data:`jaxdet.results.reading.LINKED` too."""

    @classmethod
    def of(cls, frames: Mapping[str, Any], obstacles: Mapping[str, Any]) -> "Tables":
        """Build the tables from columns, see :func:`to_table`."""
        return cls(to_table(frames, FRAMES_SCHEMA), to_table(obstacles, OBSTACLES_SCHEMA))

    @property
    def first(self) -> np.ndarray:
        """``(F + 1,)`` int64, frame ``i`` has the obstacles ``first[i]`` to ``first[i + 1]``."""
        return np.append(0, np.cumsum(self.frames["num_obstacles"].to_numpy(), dtype=np.int64))

    def each(self) -> Iterator[Frame]:
        """Yield the frames one by one."""
        rows, parts = self.frames.to_pylist(), self.obstacles.to_pylist()
        for row, (start, stop) in zip(rows, pairwise(self.first.tolist()), strict=True):
            yield Frame(row, parts[start:stop])

    def take(self, rows: np.ndarray) -> "Tables":
        """Return some of the frames ``(n,)``, ascending, with all their obstacles."""
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
        columns: Columns by the names of the fields, see :func:`jaxdet.results.arrow.to_array`.
        schema: One of :mod:`jaxdet.results.schemas`.
    """
    return pa.Table.from_arrays([to_array(columns[f.name], f) for f in schema], schema=schema)
