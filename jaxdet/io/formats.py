"""The formats of logs: MCAP, ROS 1's bags, ROS 2's SQLite files and folders of images.

Whichever it is, the file gives its channels, an index of its messages and chunks of MCAP records;
all that reads logs stands on these.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from jaxdet.io.bag import BagFile
from jaxdet.io.bag_index import read_bag_index, scan_bag
from jaxdet.io.chunks import RECORD_HEAD
from jaxdet.io.container import LogFile, McapFile
from jaxdet.io.file_index import FileIndex, indexed_integrity
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.image_folder_index import read_folder_index, scan_folder
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.message_index import read_message_index
from jaxdet.io.messages import kind_of
from jaxdet.io.scan import scan
from jaxdet.io.sqlite import SqliteFile
from jaxdet.io.sqlite_index import read_sqlite_index, scan_sqlite
from jaxdet.io.summary import read_summary
from jaxdet.io.walk import Handler

_FORMATS: dict[str, type[LogFile]] = {".bag": BagFile, ".db3": SqliteFile}
"""By suffix; any other file is taken for MCAP."""


def open_file(path: Path, max_bytes: int) -> LogFile:
    """Opens a file of a log.

    Args:
        path: The file or folder.
        max_bytes: Largest chunk or message, before and after decompression.

    Raises:
        InputError: It can't be opened, or isn't of the format that its name says.
    """
    kind = ImageFolder if path.is_dir() else _FORMATS.get(path.suffix, McapFile)
    return kind(path, max_bytes)


def read_file_index(file: LogFile) -> FileIndex:
    """What a file's index tells.

    Raises:
        DamageError: The index is missing, torn or wrong.
    """
    if isinstance(file, BagFile):
        return read_bag_index(file)
    if isinstance(file, SqliteFile):
        return read_sqlite_index(file)
    if isinstance(file, ImageFolder):
        return read_folder_index(file)
    assert isinstance(file, McapFile)
    summary = read_summary(file)
    infos = {key: summary.declared.info(key) for key in summary.declared.channels}
    infos = {key: info for key, info in infos.items() if info is not None}
    useful = [key for key, info in infos.items() if kind_of(info.schema_name) is not None]
    entries = read_message_index(file, summary, useful)
    chunks = summary.chunks
    has_crc = len(chunks.start) and file.chunk_head(int(chunks.start[0]) + RECORD_HEAD.size).crc
    return FileIndex(
        infos,
        entries.counts,
        indexed_integrity(file.path, entries.total, len(chunks.start), has_crc != 0),
        entries.channel,
        entries.log_ns,
        chunks.start[entries.chunk] + RECORD_HEAD.size,
        chunks.length[entries.chunk] - RECORD_HEAD.size,
        entries.offset,
    )


def scan_file(file: LogFile, handler: Handler, pool: ThreadPoolExecutor) -> FileIntegrity:
    """Gives every readable message to ``handler``, in file order; says what was lost.

    Args:
        file: The file.
        handler: Called by this thread.
        pool: Decompresses chunks ahead.

    Raises:
        InputError: The file was changed meanwhile, or holds more messages than it has room for.
    """
    if isinstance(file, BagFile):
        return scan_bag(file, handler, pool)
    if isinstance(file, SqliteFile):
        return scan_sqlite(file, handler)
    if isinstance(file, ImageFolder):
        return scan_folder(file, handler)
    assert isinstance(file, McapFile)
    return scan(file, handler, pool)
