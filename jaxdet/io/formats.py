"""The formats of logs: MCAP, ROS 1's bags, ROS 2's SQLite files and folders of images.

Whichever it is, the file gives its channels, an index of its messages and chunks of MCAP records;
all that reads logs stands on these.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.io.bag import BagFile
from jaxdet.io.bag_index import read_bag_index, scan_bag
from jaxdet.io.container import LogFile, McapFile
from jaxdet.io.file_index import FileIndex
from jaxdet.io.image_folder import ImageFolder, read_folder_index, scan_folder
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.mcap_index import read_mcap_index
from jaxdet.io.mcap_scan import scan
from jaxdet.io.sqlite import SqliteFile
from jaxdet.io.sqlite_index import read_sqlite_index, scan_sqlite
from jaxdet.io.unpacking import is_packed, unpacked
from jaxdet.io.walk import Handler


class _Format(NamedTuple):
    read_index: Callable[[Any], FileIndex]
    scan: Callable[[Any, Handler, ThreadPoolExecutor], FileIntegrity]


_FORMATS: dict[type[LogFile], _Format] = {
    McapFile: _Format(read_mcap_index, scan),
    BagFile: _Format(read_bag_index, scan_bag),
    SqliteFile: _Format(read_sqlite_index, lambda file, handler, _: scan_sqlite(file, handler)),
    ImageFolder: _Format(read_folder_index, lambda file, handler, _: scan_folder(file, handler)),
}
_SUFFIXES: dict[str, type[LogFile]] = {".bag": BagFile, ".db3": SqliteFile}
"""Any other file is taken for MCAP."""


def open_file(path: Path, max_bytes: int) -> LogFile:
    """Opens a file of a log; one that is compressed as a whole through a temporary file.

    Args:
        path: The file or folder.
        max_bytes: Largest chunk or message, before and after decompression.

    Raises:
        InputError: It can't be opened, or isn't of the format that its name says.
    """
    if is_packed(path) and path.is_file():
        path = unpacked(path)
    kind = ImageFolder if path.is_dir() else _SUFFIXES.get(path.suffix.lower(), McapFile)
    return kind(path, max_bytes)


def read_file_index(file: LogFile) -> FileIndex:
    """What a file's index tells.

    Raises:
        DamageError: The index is missing, torn or wrong.
    """
    return _FORMATS[type(file)].read_index(file)


def scan_file(file: LogFile, handler: Handler, pool: ThreadPoolExecutor) -> FileIntegrity:
    """Gives every readable message to ``handler``, in file order; says what was lost.

    Args:
        file: The file.
        handler: Called by this thread.
        pool: Decompresses chunks ahead.

    Raises:
        InputError: The file was changed meanwhile, or holds more messages than it has room for.
    """
    return _FORMATS[type(file)].scan(file, handler, pool)
