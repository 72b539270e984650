"""Formats of logs: MCAP, ROS 1 bags, ROS 2 SQLite files and folders of images."""

from pathlib import Path

from jaxdet.errors import InputError
from jaxdet.io.bag import BagFile
from jaxdet.io.container import LogFile
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.sqlite import SqliteFile
from jaxdet.io.unpacking import is_packed, unpacked

_SUFFIXES: dict[str, type[LogFile]] = {".bag": BagFile, ".db3": SqliteFile}
"""File classes by suffix; files with other suffixes are opened as MCAP."""


def open_file(path: Path, max_bytes: int) -> LogFile:
    """Open a file of a log; compressed files are decompressed to a temporary file.

    Args:
        path: File or folder.
        max_bytes: Maximum size of a chunk or message, before and after decompression.

    Raises:
        InputError: The file can't be opened, or does not have the format of its suffix.
    """
    if not is_packed(path) or not path.is_file():
        return _open(path, max_bytes)
    try:
        file = _open(unpacked(path), max_bytes)
    except InputError as error:
        raise InputError(error.problem, path=str(path), remedy=error.remedy) from error
    file.named = path
    return file


def _open(path: Path, max_bytes: int) -> LogFile:
    kind = ImageFolder if path.is_dir() else _SUFFIXES.get(path.suffix.lower(), McapFile)
    return kind(path, max_bytes)
