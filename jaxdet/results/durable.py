"""Files and folders that are complete or absent, however the process ends.

The folder of a log's results is made in the working folder and renamed when it is complete. If an
older folder exists, the two are exchanged in one step, so at any time readers find the complete old
or the complete new folder. On systems that can't exchange folders, the old folder is moved aside
for a moment: readers find it there, and if the process ends at that moment, the next command that
works in the results moves it back (:func:`finish`).
"""

import ctypes
import errno
import hashlib
import os
import secrets
import shutil
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxdet.errors import OutputError
from jaxdet.results.layout import ASIDE, WORKING

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_CANT = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)


@contextmanager
def writing(path: Path, remedy: str = "make room or pass another --output") -> Iterator[None]:
    """Turn system errors into an error that ends the whole run, not only the current log.

    Args:
        path: Path for the error, if the system's error has none.
        remedy: Remedy in the error.

    Raises:
        OutputError: The disk is full, read-only or broken.
    """
    try:
        yield
    except OSError as error:
        problem = f"can't be written ({error.strerror or error})"
        raise OutputError(problem, path=str(error.filename or path), remedy=remedy) from error


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, wait until it is on the disk, and rename it."""
    # The name is random, as processes in different containers may have the same number.
    new = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    with writing(path):
        try:
            with new.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            new.replace(path)
        except BaseException:
            with suppress(OSError):
                new.unlink()
            raise


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def flush(*paths: Path) -> None:
    """Wait until files, and the directory entries of folders, are on the disk."""
    with ThreadPoolExecutor() as disk:
        deque(disk.map(_flush, paths), 0)


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def publish(staged: Path, results: Path, name: str) -> None:
    """Move a staged folder to the path of a log's results; an older folder is removed.

    Args:
        staged: Complete folder, on the same disk; its files are on the disk
            (:func:`flush_folder`).
        results: Results folder.
        name: Name of the log's folder.

    Raises:
        OutputError: The disk is full or broken; the complete old or new folder remains.
    """
    place = results / name
    with writing(place):
        while not rename_if_absent(staged, place):
            if exchange(staged, place):
                remove(staged)
                break
            aside = results / WORKING / f"{ASIDE}{secrets.token_hex(4)}"
            aside.mkdir(parents=True)
            with suppress(FileNotFoundError):  # another process has moved it
                os.rename(place, aside / name)
        flush(results)
        finish(results)


def finish(results: Path) -> None:
    """Complete what :func:`publish` began: folders that were moved aside are removed or moved back.

    Args:
        results: Results folder.

    Raises:
        OutputError: The folder can't be written to; call this function again later.
    """
    with writing(results):
        for aside in (results / WORKING).glob(f"{ASIDE}*"):
            for folder in aside.glob("*"):
                with suppress(FileNotFoundError):  # another process has moved it
                    if rename_if_absent(folder, results / folder.name):
                        flush(results)
                    else:
                        remove(folder)
            with suppress(OSError):
                aside.rmdir()


def rename_if_absent(staged: Path, place: Path) -> bool:
    """Rename a folder; return False, and change nothing, if something is at its place."""
    try:
        os.rename(staged, place)
    except OSError:
        if os.path.lexists(place):
            return False
        raise
    return True


def exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; return False, and change nothing, if that is not possible.

    The system may not support it, or another process may have moved ``other``.
    """
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):  # no such function in this C library
        return False
    paths = (os.fsencode(one), os.fsencode(other))
    if rename(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANT or (number == errno.ENOENT and os.path.lexists(one)):
        return False
    raise OSError(number, os.strerror(number), str(other))


def remove(path: Path) -> None:
    """Remove a folder, file or link, without an error if that fails."""
    if path.is_symlink() or not path.is_dir():
        with suppress(OSError):
            path.unlink()
    else:
        shutil.rmtree(path, ignore_errors=True)


def flush_folder(folder: Path) -> None:
    """Wait until all files of a folder are on the disk."""
    paths = [*folder.rglob("*")]
    flush(*(path for path in paths if not path.is_symlink()), folder)


def link_folder(folder: Path, copy: Path) -> None:
    """Make a new folder with hard links to the files of ``folder``, or with copies of them."""
    copy.mkdir(parents=True)
    for path in sorted(folder.rglob("*")):
        to = copy / path.relative_to(folder)
        if path.is_dir() and not path.is_symlink():
            to.mkdir()
            continue
        try:
            to.hardlink_to(path)
        except OSError:
            shutil.copy2(path, to, follow_symlinks=False)
