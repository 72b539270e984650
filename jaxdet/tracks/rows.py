"""Rows of ``tracks.parquet`` of a log, sorted by track number on disk.

Tracks arrive when they end: a track that is visible throughout has the number 0 but arrives last.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa

from jaxdet.results.durable import writing
from jaxdet.results.reading import ResultLog
from jaxdet.results.schemas import TRACKS_SCHEMA
from jaxdet.results.tables import map_file, open_file
from jaxdet.tracks.track import Track

PART_ROWS = 1024
"""Number of rows that are read at once."""


class TrackRows:
    """Tracks of a log in a temporary file, which is removed at the end of the context.

    Args:
        path: Temporary file.
        log: Log.
    """

    def __init__(self, path: Path, log: ResultLog) -> None:
        self._path, self._log = path, log
        with writing(path):
            self._file = open_file(path, "wb")
            self._writer = pa.ipc.new_file(self._file, TRACKS_SCHEMA)
        self._places: list[tuple[int, int, int]] = []
        """Track number, batch, and row in the batch, of each track."""
        self._batches = 0
        self.moving = 0
        self.in_world = 0

    def __enter__(self) -> "TrackRows":
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # the file is removed anyway
            self._close()
        self._path.unlink(missing_ok=True)

    def __len__(self) -> int:
        return len(self._places)

    def add(self, tracks: Sequence[Track]) -> None:
        """Append tracks that have ended, in any order."""
        if not tracks:
            return
        with writing(self._path):
            self._writer.write_batch(_batch(self._log, tracks))
        self._places += [(t.number, self._batches, row) for row, t in enumerate(tracks)]
        self._batches += 1
        self.moving += sum(track.moving for track in tracks)
        self.in_world += sum(track.in_world for track in tracks)

    def ordered(self) -> Iterator[pa.Table]:
        """Yield the rows in parts, sorted by track number; no track can be added afterwards."""
        with writing(self._path):
            self._close()
        with map_file(self._path) as file, pa.ipc.open_file(file) as reader:
            places = sorted(self._places)
            for first in range(0, len(places), PART_ROWS):
                part = places[first : first + PART_ROWS]
                rows = [reader.get_batch(batch).slice(row, 1) for _, batch, row in part]
                yield pa.Table.from_batches(rows).combine_chunks()

    def _close(self) -> None:
        if not self._file.closed:
            with self._file:
                self._writer.close()


def _batch(log: ResultLog, tracks: Sequence[Track]) -> pa.RecordBatch:
    columns = [
        [log.name] * len(tracks), [log.camera] * len(tracks), [t.number for t in tracks],
        [t.in_world for t in tracks],
        [t.first_frame for t in tracks], [t.last_frame for t in tracks],
        [t.first_stamp_ns for t in tracks], [t.last_stamp_ns for t in tracks],
        [t.frames for t in tracks], [t.obstacles for t in tracks], [t.moving for t in tracks],
        [t.mean_speed_mps for t in tracks], [t.max_speed_mps for t in tracks],
        [t.length_m for t in tracks], [t.width_m for t in tracks],
        [None if np.isnan(t.top_m) else t.top_m for t in tracks],
        [t.path.ravel() for t in tracks], [t.speed for t in tracks],
        *[[None] * len(tracks)] * 3,  # filled in by jaxdet.tracks.places
    ]  # fmt: skip
    arrays = [pa.array(c, f.type) for c, f in zip(columns, TRACKS_SCHEMA, strict=True)]
    return pa.RecordBatch.from_arrays(arrays, schema=TRACKS_SCHEMA)
