"""Files that are complete or absent, however the process ends."""

import hashlib
import os
import secrets
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxdet.errors import OutputError

MAKE_ROOM = "make room or give another --output"


@contextmanager
def writing(path: Path, remedy: str = MAKE_ROOM) -> Iterator[None]:
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
    # A random name, as processes in different containers may have the same number.
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
