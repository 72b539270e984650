"""Lock of a folder of results, so that only one process at a time works in it."""

import fcntl
import json
import os
import socket
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jaxdet.errors import ConfigError, InputError, printable

_TRIES = 100
"""Maximum number of tries to make the folder and the file; on some file systems all tries fail."""
_MOST_BYTES = 4096
"""Maximum number of bytes that are read from the file."""


class Lock:
    """A file that this process has locked, and that contains the process, machine and time.

    The system unlocks the file when the process ends. If the process was killed, the content stays.

    Args:
        path: The file; its folder is made, and :meth:`release` removes the folder if it is empty.

    Attributes:
        before: Text that names the last owner if it was killed, else None.

    Raises:
        ConfigError: Another run holds the lock.
        InputError: The folder can't be written to or is another user's, or its file system has no
            locks.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = _locked(path)
        self.before = _owner(os.pread(self._file, _MOST_BYTES, 0))
        owner = path.parent.stat().st_uid
        if owner != os.geteuid():  # the content of the folder is trusted
            os.close(self._file)
            raise InputError(
                f"holds an unfinished run of another user (number {owner})",
                path=str(path.parent.parent),
                remedy="work in another folder",
            )
        now = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.time()}
        content = json.dumps(now).encode()
        try:
            os.pwrite(self._file, content, 0)
            os.ftruncate(self._file, len(content))
        except OSError as error:
            self.release()
            problem = f"can't be written to ({error.strerror})"
            raise InputError(problem, path=str(path.parent.parent), remedy="make room") from error

    def release(self) -> None:
        """Unlock and remove the file."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
            self.path.parent.rmdir()  # fails if anything else is in it
        os.close(self._file)


def _locked(path: Path) -> int:
    """Lock the file, and return its descriptor after checking that it was not replaced."""
    if path.parent.is_symlink():  # the content of the folder will be removed
        raise InputError("is a link", path=str(path.parent), remedy="remove it")
    tries = 0
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            tries += 1
            if isinstance(error, FileNotFoundError | FileExistsError) and tries < _TRIES:
                continue  # the lock's last owner removes the folder, or has just done so
            problem = f"can't be written to ({error.strerror})"
            raise InputError(problem, path=str(path.parent.parent)) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file), path.stat()):
                return file
        except FileNotFoundError:
            pass  # its last owner has just removed it
        except BlockingIOError:
            owner = _owner(os.pread(file, _MOST_BYTES, 0))
            os.close(file)
            raise ConfigError(
                f"another run works here ({owner or 'just begun'})",
                path=str(path.parent.parent),
                remedy="wait for it, or work in another folder",
            ) from None
        except OSError as error:
            os.close(file)
            problem = f"can't be locked ({error.strerror})"
            remedy = "take a folder on a disk of this machine"
            raise InputError(problem, path=str(path.parent.parent), remedy=remedy) from error
        os.close(file)


def _owner(text: bytes) -> str | None:
    """Return a text that names the owner, from the content of a lock file."""
    try:
        found: dict[str, Any] = json.loads(text)
        since = datetime.fromtimestamp(found["since"], UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        minutes = max(0, round((time.time() - found["since"]) / 60))
        owner = f"process {found['pid']} on {found['host']}"
        return f"{printable(owner)} since {since}, {minutes} min"
    except (ValueError, KeyError, TypeError, OverflowError, OSError):
        return None
