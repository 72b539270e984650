"""Replacement of a log's folder: at any time the complete old or the complete new one is there.

A folder is made in the working folder and renamed when it is complete. If there is one already, the
two are exchanged in one step. On systems that can't do that, the new folder is renamed into
``ready``, and is valid from then on: readers find it there, and the next command that works in the
results moves it to its final path (:func:`finish`).
"""

import ctypes
import errno
import os
import secrets
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from jaxdet.results.durable import flush, writing
from jaxdet.results.layout import READY, WORKING

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_CANT = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)


def publish(
    staged: Path, results: Path, name: str, unless: Callable[[], bool] = lambda: False
) -> bool:
    """Move a staged folder to the path of a log's results; an older folder is removed.

    Args:
        staged: Complete folder, on the same disk; its files are on the disk
            (:func:`flush_folder`).
        results: Results folder.
        name: Name of the log's folder.
        unless: Called if there is a folder already; returns whether to keep the old folder.

    Returns:
        Whether the folder was moved to its place.

    Raises:
        OutputError: The disk is full or broken; the old or the new folder is there, complete.
    """
    place = results / name
    with writing(place):
        if not rename_if_absent(staged, place):
            if unless():
                return False
            if exchange(staged, place):
                remove(staged)
            else:
                ready = results / WORKING / READY / name
                ready.parent.mkdir(parents=True, exist_ok=True)
                os.rename(staged, ready)
                flush(ready.parent)
                _move(ready, place)
                with suppress(OSError):
                    ready.parent.rmdir()
        flush(results)
    return True


def finish(results: Path) -> int:
    """Complete what :func:`publish` began in a process that has ended.

    Args:
        results: Results folder.

    Returns:
        Number of folders that were moved to their place.

    Raises:
        OutputError: The folder can't be written to; call this function again later.
    """
    waiting = sorted((results / WORKING / READY).glob("*"))
    with writing(results):
        for ready in waiting:
            _move(ready, results / ready.name)
        for old in (results / WORKING).glob("old-*"):
            remove(old)
        if waiting:
            flush(results)
        with suppress(OSError):
            (results / WORKING / READY).rmdir()
    return len(waiting)


def _move(ready: Path, place: Path) -> None:
    """Move a folder to its final path, unless another process did; remove the old folder."""
    old = ready.parents[1] / f"old-{secrets.token_hex(4)}"
    if os.path.lexists(place):
        os.rename(place, old)
    try:
        os.rename(ready, place)
    except FileNotFoundError:
        os.rename(old, place)  # another process had moved the new folder there
    else:
        remove(old)


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
    """Exchange two folders in one step; return False if the system can't, and change nothing."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):  # no such function in this C library
        return False
    paths = (os.fsencode(one), os.fsencode(other))
    if rename(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANT:
        return False
    raise OSError(number, os.strerror(number), str(other))


def remove(path: Path) -> None:
    """Remove a folder or a link, without an error if that fails."""
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
    """Make a new folder with hard links to the files of another one, or copies of them."""
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
