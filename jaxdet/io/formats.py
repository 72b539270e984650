"""The formats of logs: MCAP, ROS 1's bags, ROS 2's SQLite files and folders of images."""

from pathlib import Path

from jaxdet.io.bag import BagFile
from jaxdet.io.container import LogFile
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.sqlite import SqliteFile
from jaxdet.io.unpacking import is_packed, unpacked

_SUFFIXES: dict[str, type[LogFile]] = {".bag": BagFile, ".db3": SqliteFile}
"""Any other file is taken for MCAP."""


def open_file(path: Path, max_bytes: int) -> LogFile:
    """Open a file of a log; one that is compressed as a whole through a temporary file.

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
