"""Formats of logs: MCAP, ROS 1 bags, ROS 2 SQLite files and folders of images."""

from pathlib import Path

from jaxdet.errors import InputError
from jaxdet.io.bag import BagFile
from jaxdet.io.container import LogFile
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.limits import ReadMemory
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.sqlite import SqliteFile
from jaxdet.io.unpacking import is_packed, unpacked

_SUFFIXES: dict[str, type[LogFile]] = {".bag": BagFile, ".db3": SqliteFile}
"""File classes by suffix; files with other suffixes are opened as MCAP."""


def open_file(path: Path, max_bytes: int, memory: ReadMemory | None = None) -> LogFile:
    """Open a file of a log; compressed files are decompressed to a temporary file.

    Args:
        path: File or folder.
        max_bytes: Maximum size of a chunk or message, before and after decompression.
        memory: Limits of the memory for reading.

    Raises:
        InputError: The file can't be opened, or does not have the format of its suffix.
    """
    source = unpacked(path) if is_packed(path) and path.is_file() else path
    kind = ImageFolder if source.is_dir() else _SUFFIXES.get(source.suffix.lower(), McapFile)
    try:
        file = kind(source, max_bytes)
    except InputError as error:
        if source == path:
            raise
        raise InputError(error.problem, path=str(path), remedy=error.remedy) from error
    file.named = path
    file.memory = memory or ReadMemory()
    return file
