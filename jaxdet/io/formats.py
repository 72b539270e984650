"""Opening of files by their format; compressed recordings are decompressed to temporary files.

rosbag2 names compressed files ``NAME_0.mcap.zstd``; ``zstd`` and ``bzip2`` append ``.zst`` and
``.bz2``. The decompressed file is in a folder of the user under the system's temporary folder
(``TMPDIR``), and is removed when the process that created it ends.
"""

import atexit
import bz2
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePath

import zstandard

from jaxdet.errors import InputError
from jaxdet.io.bag import BagFile
from jaxdet.io.container import LogFile
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.limits import ReadMemory
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.sqlite import SqliteFile
from jaxdet.memory import size_text

PACKED = (".zstd", ".zst", ".bz2")
"""Suffixes of compressed files."""
MAX_UNPACKED_BYTES = 64 << 30
"""Maximum size of a decompressed recording [byte]."""
_MAX_RATIO, _FREE_BYTES = 200, 64 << 20
"""Maximum compression ratio (recordings reach 20), and number of decompressed bytes that are always
allowed."""
_SPARE_BYTES = 1 << 30
"""Disk space that is left free [byte]."""
_PIECE_BYTES = 4 << 20
_OLD_S = 7 * 24 * 3600
"""Age from which files left behind by killed processes are removed [s]."""
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
    source = _unpacked(path) if is_packed(path) and path.is_file() else path
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


def is_packed(path: PurePath) -> bool:
    """Return whether the suffix of a file is that of a compressed file."""
    return path.suffix.lower() in PACKED


def _unpacked(path: Path) -> Path:
    """Return the path of a decompressed copy of a recording, which is created if necessary.

    Raises:
        InputError: The file is damaged or too large, or there is too little disk space.
    """
    try:
        state = path.stat()
        folder = _own_folder()
        about = f"{path.resolve()}|{state.st_ino}|{state.st_size}|{state.st_mtime_ns}"
        place = folder / hashlib.sha256(about.encode("utf-8", "surrogateescape")).hexdigest()[:16]
        target = place / path.with_suffix("").name
        if not target.exists():
            _remove_old(folder)
            place.mkdir(exist_ok=True)
            atexit.register(shutil.rmtree, place, ignore_errors=True)
            _unpack(path, target, state.st_size)
    except (OSError, EOFError, zstandard.ZstdError) as error:
        problem = f"can't be decompressed ({getattr(error, 'strerror', None) or error})"
        remedy = "check the file, or decompress it manually"
        raise InputError(problem, path=str(path), remedy=remedy) from error
    return target


def _own_folder() -> Path:
    """Return a folder that is writable only by this user."""
    folder = Path(tempfile.gettempdir(), f"jaxdet-{os.getuid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    about = folder.lstat()
    if about.st_uid != os.getuid() or about.st_mode & 0o077 or folder.is_symlink():
        raise PermissionError(None, f"{folder} belongs to another user or is accessible to others")
    return folder


def _remove_old(folder: Path) -> None:
    for place in folder.iterdir():
        with suppress(OSError):
            if time.time() - place.stat().st_mtime > _OLD_S:
                shutil.rmtree(place, ignore_errors=True)


def _unpack(path: Path, target: Path, packed_bytes: int) -> None:
    most = min(MAX_UNPACKED_BYTES, _MAX_RATIO * packed_bytes + _FREE_BYTES)
    room = shutil.disk_usage(target.parent).free - _SPARE_BYTES
    part, size = target.with_name(f"{target.name}.{os.getpid()}"), 0
    try:
        with part.open("wb") as file:
            for piece in _pieces(path):
                size += len(piece)
                if size > min(most, room):
                    raise _too_large(path, most, room)
                file.write(piece)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _pieces(path: Path) -> Iterator[bytes]:
    if path.suffix.lower() == ".bz2":
        with bz2.open(path) as file:
            while piece := file.read(_PIECE_BYTES):
                yield piece
        return
    with (
        path.open("rb") as packed,
        zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader,
    ):
        while piece := reader.read(_PIECE_BYTES):
            yield piece


def _too_large(path: Path, most: int, room: int) -> InputError:
    if room < most:
        problem = f"too little disk space to decompress it ({size_text(max(room, 0))} free)"
        return InputError(problem, path=str(path), remedy="set TMPDIR to a folder with more space")
    problem = f"the decompressed file exceeds {size_text(most)}"
    return InputError(problem, path=str(path), remedy="check the file, or decompress it manually")
