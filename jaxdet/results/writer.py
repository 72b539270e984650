"""Writers of the tables of a log as Parquet files, and of its JSON files.

The bytes of the tables are a function of their rows alone: rows are buffered into row groups
of a fixed size for any batch size, and the writer's settings are fixed here.
"""

import contextlib
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.results.arrow import open_file
from jaxdet.results.durable import writing
from jaxdet.results.layout import FRAMES, OBSTACLES
from jaxdet.results.metadata import Inputs, table_metadata
from jaxdet.results.schemas import DICTIONARIES, FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.tables import Tables

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
    """Return a table as the bytes of a file; they are equal if all values are bitwise equal."""
    file = BytesIO()
    with parquet_writer(file, table.schema, store_schema=False) as writer:
        writer.write_table(table.combine_chunks())
    return file.getvalue()


class TableWriter:
    """Writes the two tables of a log; a context manager that closes them.

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
        with writing(self.folder), ThreadPoolExecutor(2) as threads:  # Arrow compresses on one
            deque(threads.map(lambda table: table.close(metadata), self._tables), 0)
