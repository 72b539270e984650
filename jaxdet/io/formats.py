"""The formats of logs: MCAP, ROS 1's bags, ROS 2's SQLite files and folders of images.

Whichever it is, the file gives its channels, an index of its messages and chunks of MCAP records;
all that reads logs stands on these.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.io.bag import BagFile
from jaxdet.io.bag_index import read_bag_index, rebuild_bag_index
from jaxdet.io.container import LogFile, McapFile
from jaxdet.io.file_index import FileIndex
from jaxdet.io.image_folder import ImageFolder, read_folder_index, rebuild_folder_index
from jaxdet.io.mcap_index import read_mcap_index
from jaxdet.io.mcap_scan import rebuild_mcap_index
from jaxdet.io.sqlite import SqliteFile
from jaxdet.io.sqlite_index import read_sqlite_index, rebuild_sqlite_index
from jaxdet.io.unpacking import is_packed, unpacked


class _Format(NamedTuple):
    read_index: Callable[[Any], FileIndex]
    rebuild_index: Callable[[Any], FileIndex]


_FORMATS: dict[type[LogFile], _Format] = {
    McapFile: _Format(read_mcap_index, rebuild_mcap_index),
    BagFile: _Format(read_bag_index, rebuild_bag_index),
    SqliteFile: _Format(read_sqlite_index, rebuild_sqlite_index),
    ImageFolder: _Format(read_folder_index, rebuild_folder_index),
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
    """What a file's own index tells.

    Raises:
        DamageError: The index is missing, torn or wrong.
    """
    return _FORMATS[type(file)].read_index(file)


def rebuild_file_index(file: LogFile) -> FileIndex:
    """The index of every readable message of a file, by reading all of it; says what was lost.

    Raises:
        InputError: The file was changed meanwhile, or holds more messages than it has room for.
    """
    return _FORMATS[type(file)].rebuild_index(file)
