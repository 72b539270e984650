"""The results folder: two Parquet tables, the configuration and a summary.

The bytes of the tables are a function of their rows alone: rows are buffered into row groups
of a fixed size whatever the batch, and the writer's settings are fixed here. Everything is
written into a hidden folder inside the output folder and moved to its final name at the end,
so a final name never holds half a file.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.errors import ConfigError, InputError
from jaxdet.results.arrow import to_array
from jaxdet.results.metadata import Inputs, table_metadata
from jaxdet.results.schemas import DICTIONARIES, FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.summary import to_json

ROWS_PER_GROUP = 65536
"""Rows in a row group; part of the format, as it decides the bytes."""

_NAMES = ("frames.parquet", "obstacles.parquet", "config.json", "summary.json")
_GENERATED = ("pictures/*.png", "map_*.npz", "map_*.png", "track*.parquet", "tracks_*.png")


def to_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Rows as an Arrow table.

    Args:
        columns: One for each field, see :func:`jaxdet.results.arrow.to_array`.
        schema: One of :mod:`jaxdet.results.schemas`.

    Returns:
        A table of R rows.
    """
    return pa.Table.from_arrays([to_array(columns[f.name], f) for f in schema], schema=schema)


class Tables(NamedTuple):
    """Rows of both tables."""

    frames: pa.Table
    obstacles: pa.Table

    @classmethod
    def of(cls, frames: Mapping[str, Any], obstacles: Mapping[str, Any]) -> "Tables":
        """Rows from columns, see :func:`to_table`."""
        return cls(to_table(frames, FRAMES_SCHEMA), to_table(obstacles, OBSTACLES_SCHEMA))

    @classmethod
    def load(cls, stem: Path) -> "Tables":
        """What :meth:`save` wrote."""
        return cls(*(_load(stem.with_suffix(end)) for end in _ARROW))

    def save(self, stem: Path) -> None:
        """Writes them as Arrow files beside each other, ``STEM.frames`` and ``STEM.obstacles``."""
        for table, end in zip(self, _ARROW, strict=True):
            with pa.ipc.new_file(str(stem.with_suffix(end)), table.schema) as file:
                file.write_table(table)


_ARROW = (".frames", ".obstacles")


def join_tables(parts: Iterable[Tables]) -> Tables:
    """Rows one after the other."""
    return Tables(*map(pa.concat_tables, zip(*parts, strict=True)))


def _load(path: Path) -> pa.Table:
    with pa.OSFile(str(path)) as file, pa.ipc.open_file(file) as reader:
        return reader.read_all()


class _Table:
    """A Parquet file in row groups of a fixed size."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.path, self.schema = path, schema
        self.pending: list[pa.Table] = []
        self.rows = 0
        self.writer = pq.ParquetWriter(
            path,
            schema,
            compression="zstd",
            compression_level=3,
            write_page_checksum=True,
            use_dictionary=DICTIONARIES,  # pyright: ignore[reportArgumentType]
        )

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


class ResultWriter:
    """Writes a results folder; a context manager that leaves nothing behind on an error.

    Args:
        directory: The output folder; made when missing.
        overwrite: Replace results that are there.

    Raises:
        ConfigError: The folder holds results and ``overwrite`` is off, or it is a file.
        InputError: The folder can't be written to.
    """

    def __init__(self, directory: Path, *, overwrite: bool = False) -> None:
        self.directory = Path(directory)
        _check(self.directory, overwrite)
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            self.staging = Path(tempfile.mkdtemp(prefix=".jaxdet-", dir=self.directory))
        except OSError as error:
            raise InputError(
                f"can't be written to ({error.strerror})", path=str(directory)
            ) from error
        self._frames = _Table(self.staging / "frames.parquet", FRAMES_SCHEMA)
        self._obstacles = _Table(self.staging / "obstacles.parquet", OBSTACLES_SCHEMA)
        self._inputs = Inputs()

    def __enter__(self) -> "ResultWriter":
        return self

    def __exit__(self, *_: object) -> None:
        for table in (self._frames, self._obstacles):
            table.writer.close()
        shutil.rmtree(self.staging, ignore_errors=True)
        with contextlib.suppress(OSError):
            self.directory.rmdir()  # where nothing is in it

    def add(self, rows: "Tables") -> None:
        """Appends rows, in order."""
        self._inputs.add(rows.frames)
        self._frames.add(rows.frames)
        self._obstacles.add(rows.obstacles)

    @contextlib.contextmanager
    def log_folder(self) -> Iterator[Path]:
        """A folder for a log while it is not whole; its ``pictures`` are kept if it ends well."""
        folder = Path(tempfile.mkdtemp(prefix="log-", dir=self.staging)).absolute()
        try:
            yield folder
            for picture in sorted(folder.glob("pictures/*")):
                picture.rename(self.path(f"pictures/{picture.name}"))
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def path(self, name: str) -> Path:
        """Where to write a further file that shall end as ``name`` in the output folder."""
        path = self.staging / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def commit(self, config: Mapping[str, Any], summary: Mapping[str, Any]) -> None:
        """Writes the JSON files and moves everything to its final name, the summary last."""
        metadata = table_metadata(config, summary, self._inputs)
        self._frames.close(metadata)
        self._obstacles.close(metadata)
        self.path("config.json").write_text(to_json(config), encoding="utf-8")
        self.path("summary.json").write_text(to_json(summary), encoding="utf-8")
        for old in [p for pattern in _GENERATED for p in self.directory.glob(pattern)]:
            old.unlink()
        files = [p.relative_to(self.staging) for p in self.staging.rglob("*") if p.is_file()]
        for name in sorted(files, key=lambda p: (str(p) == "summary.json", str(p))):
            _sync(self.staging / name)
            (self.directory / name).parent.mkdir(exist_ok=True)
            os.replace(self.staging / name, self.directory / name)
        _sync(self.directory)


def _check(directory: Path, overwrite: bool) -> None:
    if directory.exists() and not directory.is_dir():
        raise ConfigError("is a file", path=str(directory), remedy="give --output a folder")
    found = [name for name in _NAMES if (directory / name).exists()]
    if found and not overwrite:
        raise ConfigError(
            f"holds results already ({found[0]})",
            path=str(directory),
            remedy="give another --output, or --overwrite to replace them",
        )


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
