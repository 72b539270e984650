"""Writers of the tables of a log as Parquet files, with their metadata.

The bytes of a table depend only on its rows and its metadata: rows are buffered into row groups of
a fixed size for any batch size, and the writer's settings are fixed here. The metadata is text in
key-value pairs: format, version, configuration and inputs. Like the rows, it doesn't depend on the
time, the machine, the device, the batch or the paths of files.
"""

import contextlib
import hashlib
import json
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import jaxdet
from jaxdet.results.durable import writing
from jaxdet.results.layout import FRAMES, OBSTACLES
from jaxdet.results.schemas import DICTIONARIES, FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.tables import Tables, open_file

FORMAT = 5
"""Number of the tables' format; it changes with the columns or their meaning."""

FORMAT_KEY, VERSION_KEY = "jaxdet.format", "jaxdet.version"
CONFIG_KEY, INPUTS_KEY = "jaxdet.config", "jaxdet.inputs"

_KEYS = ("log", "camera")
_CHANGES_NO_ROW = ("preset", "backend", "batch_size")
"""Keys of ``config.json`` that change no row of the tables."""
ROWS_PER_GROUP = 65536
"""Rows in a row group; part of the format, as it decides the bytes."""


class _Table:
    """A Parquet file in row groups of a fixed size."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.path = path
        self.pending: list[pa.Table] = []
        self.rows = 0
        self.file = open_file(path, "wb")
        self.writer = parquet_writer(self.file, schema)

    def add(self, table: pa.Table) -> None:
        self.pending.append(table)
        self.rows += table.num_rows
        while self.rows >= ROWS_PER_GROUP:
            self._write_group()

    def _write_group(self) -> None:
        table = pa.concat_tables(self.pending)
        group, rest = table.slice(0, ROWS_PER_GROUP), table.slice(ROWS_PER_GROUP)
        self.writer.write_table(group.combine_chunks(), row_group_size=ROWS_PER_GROUP)
        self.pending, self.rows = [rest], rest.num_rows

    def close(self, metadata: Mapping[str, str]) -> None:
        if self.rows:
            self._write_group()
        self.writer.add_key_value_metadata(dict(metadata))
        self.writer.close()
        self.file.close()

    def drop(self) -> None:
        """Close open files."""
        for file in (self.writer, self.file):
            with contextlib.suppress(OSError):
                file.close()


def parquet_writer(
    file: pa.NativeFile | BytesIO, schema: pa.Schema, **more: Any
) -> pq.ParquetWriter:
    """Return a writer of a table whose bytes are a function of its rows and its schema."""
    return pq.ParquetWriter(
        file,
        schema,
        compression="zstd",
        compression_level=3,
        write_page_checksum=True,
        use_dictionary=DICTIONARIES,  # pyright: ignore[reportArgumentType]
        **more,
    )


def table_bytes(table: pa.Table) -> bytes:
    """Return a table as the bytes of a file, which are equal if all values are bitwise equal."""
    file = BytesIO()
    with parquet_writer(file, table.schema, store_schema=False) as writer:
        writer.write_table(table.combine_chunks())
    return file.getvalue()


class TableWriter:
    """Writer of the two tables of a log, a context manager that closes them.

    Args:
        folder: Folder of the files, which are complete when :meth:`close` returns.

    Raises:
        OutputError: The disk is full, or the folder can't be written to; all methods raise it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with writing(folder):
            self._frames = _Table(folder / FRAMES, FRAMES_SCHEMA)
            self._obstacles = _Table(folder / OBSTACLES, OBSTACLES_SCHEMA)
        self._tables = self._frames, self._obstacles
        self._inputs = Inputs()

    def __enter__(self) -> "TableWriter":
        return self

    def __exit__(self, *_: object) -> None:
        for table in self._tables:
            table.drop()

    def add(self, rows: Tables) -> None:
        """Append rows, in order."""
        self._inputs.add(rows.frames)
        with writing(self.folder):
            self._frames.add(rows.frames)
            self._obstacles.add(rows.obstacles)

    def close(self, config: Mapping[str, Any], summary: Mapping[str, Any]) -> None:
        """Write the remaining rows and the metadata of both tables.

        Args:
            config: Content of ``config.json``.
            summary: Content of ``summary.json``.
        """
        metadata = table_metadata(config, summary, self._inputs)
        with writing(self.folder), ThreadPoolExecutor(2) as threads:  # Arrow uses one per table
            deque(threads.map(lambda table: table.close(metadata), self._tables), 0)


class Inputs:
    """Digest of the timestamps and the calibration of each camera of each log in a table."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, str], int] = {}
        self._digests: dict[tuple[str, str], Any] = {}

    def add(self, frames: pa.Table) -> None:
        """Add rows of ``frames.parquet``, in order."""
        # Columns are lists, as Arrow's grouping and conversion to NumPy import pandas.
        columns = [frames[name].to_pylist() for name in (*_KEYS, "stamp_ns")]
        for name, same in groupby(zip(*columns, strict=True), key=lambda row: row[:2]):
            rows = [at for *_, at in same]
            self._frames[name] = self._frames.get(name, 0) + len(rows)
            digest = self._digests.setdefault(name, hashlib.sha256())
            digest.update(np.array(rows, "<i8").tobytes())

    def fingerprints(self, summary: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the number of frames and the digest of each camera of each log.

        Args:
            summary: Content of ``summary.json``, of which only the calibrations are used.
        """
        known = {(log["log"], log["camera"]): log["calibration"] for log in summary.get("logs", ())}
        found = []
        for (log, camera), digest in sorted(self._digests.items(), key=lambda item: item[0]):
            whole = digest.copy()
            whole.update(_canonical(known.get((log, camera))).encode())
            about = {"frames": self._frames[log, camera], "sha256": whole.hexdigest()}
            found.append({"log": log, "camera": camera, **about})
        return found


def table_metadata(
    config: Mapping[str, Any], summary: Mapping[str, Any], inputs: Inputs
) -> dict[str, str]:
    """Return the key-value metadata of both tables.

    Args:
        config: Content of ``config.json``, of which only values that can change a row are used.
        summary: Content of ``summary.json``, of which only the logs' calibrations are used.
        inputs: Inputs of the rows.
    """
    method = {key: value for key, value in config.items() if key not in _CHANGES_NO_ROW}
    if isinstance(log := method.get("log"), Mapping):  # scanning a log changes none of its frames
        method["log"] = {key: value for key, value in log.items() if key != "scan"}
    return {
        FORMAT_KEY: str(FORMAT),
        VERSION_KEY: jaxdet.__version__,
        CONFIG_KEY: _canonical(method),
        INPUTS_KEY: _canonical(inputs.fingerprints(summary)),
    }


def _canonical(value: Any) -> str:
    """Return a value as JSON in its one canonical form."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, default=str)
