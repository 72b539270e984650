"""Opening of files by their content; compressed recordings are decompressed to temporary files.

rosbag2 names compressed files ``NAME_0.mcap.zstd``; ``zstd``, ``bzip2`` and ``gzip`` append
``.zst``, ``.bz2`` and ``.gz``. The decompressed file is in the system's temporary folder
(``TMPDIR``). It is removed when the main process ends, as worker processes are killed, or earlier
if another file needs the space. If a compressed file is truncated or damaged, the data before the
damage are used.
"""

import hashlib
import multiprocessing
import os
import shutil
import tempfile
import time
from contextlib import closing, suppress
from multiprocessing.util import Finalize
from pathlib import Path, PurePath

from jaxdet.errors import InputError, printable
from jaxdet.io.bag import BagFile
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import BytesFile, FileState, LogFile, Source, opened, unreadable
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.limits import ReadMemory
from jaxdet.io.mcap_file import McapFile
from jaxdet.io.sqlite import SqliteFile
from jaxdet.memory import size_text

RECORDINGS = {
    ".mcap": (McapFile, "an MCAP file"),
    ".db3": (SqliteFile, "a rosbag2 SQLite file"),
    ".bag": (BagFile, "a ROS 1 bag (version 2.0)"),
}
"""Formats of recordings by suffix, in order of preference if a recording exists in several."""
PACKED = (".zstd", ".zst", ".bz2", ".gz")
"""Suffixes of compressed files."""
_CODECS = {
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x50\x2a\x4d\x18": "zstd",  # first frame of pzstd
    b"BZh": "bz2",
    b"\x1f\x8b": "gzip",
}
"""Compressions that are read, by the first bytes of the file."""
MAX_UNPACKED_BYTES = 64 << 30
"""Maximum size of a decompressed recording [byte]."""
_MAX_RATIO, _FREE_BYTES = 200, 64 << 20
"""Maximum compression ratio (recordings reach 20), and number of decompressed bytes that are always
allowed."""
_SPARE_BYTES = 1 << 30
"""Disk space that is left free [byte]."""
_PIECE_BYTES = 16 << 10
"""Number of bytes decompressed at a time, and at most lost before a damaged part."""
_FOLDER = "jaxdet-unpacked-"
_OLD_S = 7 * 24 * 3600
"""Age from which files left behind by killed processes are removed [s]."""
_HEAD_BYTES = 512
_TEXT = {*range(0x20, 0x7F), *range(0x80, 0x100), *b"\t\r\n"}
"""Bytes that occur in text."""
_copies: dict[FileState, Source] = {}
"""Decompressed copies made by this process, by the state of the compressed file."""
_CONTENTS = {
    b"version https://git-lfs": ("a Git LFS pointer", "run git lfs pull"),
    b"PK\3\4": ("a ZIP archive", "unpack it"),
    b"\xfd7zXZ\0": ("compressed with xz", "decompress it with xz -d"),
    b"\4\x22\x4d\x18": ("compressed with lz4", "decompress it with lz4 -d"),
}
"""Contents that are not recordings, and remedies, by the first bytes of the file."""


def open_file(path: Path, max_bytes: int, memory: ReadMemory | None = None) -> LogFile:
    """Open a file of a log by its content; compressed files are decompressed to a temporary file.

    Args:
        path: File or folder.
        max_bytes: Maximum size of a chunk or message, before and after decompression.
        memory: Limits of the memory for reading.

    Raises:
        InputError: The file can't be opened, or is not a recording.
    """
    if path.is_dir():
        file: LogFile = ImageFolder(path, max_bytes)
    else:
        source = Source(path)
        size, head = _head(path, source)
        codec = next((name for magic, name in _CODECS.items() if head.startswith(magic)), "")
        if codec:
            source = _unpacked(path, codec)
            size, head = _head(path, source)
        kinds = [kind for kind, _ in RECORDINGS.values() if head.startswith(kind.magic)]
        if not kinds or size <= 2 * len(kinds[0].magic):
            raise _not_a_recording(path, size, head)
        file = kinds[0](path, max_bytes, source)
    file.memory = memory or ReadMemory()
    return file


def bare_name(path: PurePath) -> PurePath:
    """Return the name of a recording without the suffix of its compression."""
    return path.with_suffix("") if path.suffix.lower() in PACKED else path


def _head(path: Path, source: Source) -> tuple[int, bytes]:
    """Return the size of a file, and its first bytes.

    Raises:
        InputError: The file can't be read.
    """
    with closing(BytesFile(path, source=source)) as file:
        try:
            return file.size, file.read(0, min(file.size, _HEAD_BYTES))
        except DamageError as error:
            raise unreadable(error, path) from error


def _not_a_recording(path: Path, size: int, head: bytes) -> InputError:
    """Return the error for a file with other content than its suffix says."""
    suffix = bare_name(path).suffix.lower()
    _, name = RECORDINGS.get(suffix, RECORDINGS[".mcap"])
    found = [about for begin, about in _CONTENTS.items() if head.startswith(begin)]
    what, remedy = "", "record or copy it again, or exclude it"
    if any(head.startswith(kind.magic) for kind, _ in RECORDINGS.values()):
        problem = "the recording has no records"
    elif not size:
        problem = "the file is empty"
    else:
        if found:
            what, remedy = found[0]
        elif head[257:262] == b"ustar":
            what, remedy = "a tar archive", "unpack it"
        elif not any(head):
            what, remedy = "zeros, as if it was never written", "copy the recording again"
        elif all(byte in _TEXT for byte in head):
            line = head.strip()[:40].decode(errors="replace").partition("\n")[0]
            what = f"text that begins with '{printable(line)}'"
            remedy = "it may be an error message of a server; download or copy the recording again"
        problem = f"not {name}" + (f", but {what}" if what else "")
    return InputError(problem, path=str(path), remedy=remedy)


def _unpacked(path: Path, codec: str) -> Source:
    """Return a decompressed copy of a recording, which is created if necessary.

    Raises:
        InputError: The file can't be decompressed, is too large, or there is too little disk space.
    """
    try:
        state = FileState.of(path.stat())
        if state not in _copies or not _copies[state].path.exists():
            _remove_old()
            _folder().mkdir(mode=0o700, exist_ok=True)
            folder = Path(tempfile.mkdtemp(dir=_folder()))
            Finalize(None, shutil.rmtree, (folder, True), exitpriority=-1)
            _copies[state] = _unpack(path, codec, folder / "recording", state.size)
        return _copies[state]
    except OSError as error:
        problem = f"can't be decompressed ({error.strerror or error})"
        remedy = "copy or compress the original file again"
        raise InputError(problem, path=str(path), remedy=remedy) from error


def _folder() -> Path:
    """Return the temporary folder of a main process and its workers, which share a random key."""
    key = hashlib.sha256(multiprocessing.current_process().authkey).hexdigest()[:16]
    return Path(tempfile.gettempdir(), f"{_FOLDER}{key}")


def _remove_all() -> None:
    shutil.rmtree(_folder(), ignore_errors=True)


if multiprocessing.parent_process() is None:
    Finalize(None, _remove_all, exitpriority=-1)  # after workers have been killed


def _room(target: Path) -> int:
    return shutil.disk_usage(target.parent).free - _SPARE_BYTES


def _remove_unused() -> None:
    """Remove the copies of logs that are no longer open."""
    used = {file.source.path for file in [*opened]}
    for state, copy in [*_copies.items()]:
        if copy.path not in used:
            shutil.rmtree(copy.path.parent, ignore_errors=True)
            del _copies[state]


def _remove_old() -> None:
    """Remove the copies that killed processes have left behind."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_FOLDER}*"):
        with suppress(OSError):
            about = folder.stat()
            if about.st_uid == os.getuid() and time.time() - about.st_mtime > _OLD_S:
                shutil.rmtree(folder, ignore_errors=True)


def _unpack(path: Path, codec: str, target: Path, packed_bytes: int) -> Source:
    """Decompress a file up to its end, or up to a damaged part.

    Raises:
        InputError: The decompressed file is too large, or there is too little disk space.
        OSError: A file can't be read or written, or is damaged from its start on.
    """
    import pyarrow as pa  # here, as most logs do not need it

    most, size = min(MAX_UNPACKED_BYTES, _MAX_RATIO * packed_bytes + _FREE_BYTES), 0
    if _room(target) < most:
        _remove_unused()
    room = _room(target)
    with (
        target.open("wb") as file,
        pa.OSFile(str(path)) as packed,
        pa.CompressedInputStream(packed, codec) as stream,
    ):
        while True:
            try:
                piece = stream.read(_PIECE_BYTES)
            except OSError as error:
                if not size:
                    raise
                problem = f"the compressed file is truncated or damaged ({error})"
                return Source(target, f"{problem}; {size_text(size)} were decompressed")
            if not piece:
                return Source(target)
            size += len(piece)
            if size > min(most, room):
                raise _too_large(path, most, room)
            file.write(piece)


def _too_large(path: Path, most: int, room: int) -> InputError:
    if room < most:
        problem = f"too little disk space to decompress it ({size_text(max(room, 0))} free)"
        return InputError(problem, path=str(path), remedy="set TMPDIR to a folder with more space")
    problem = f"the decompressed file exceeds {size_text(most)}"
    return InputError(problem, path=str(path), remedy="check the file, or decompress it manually")
