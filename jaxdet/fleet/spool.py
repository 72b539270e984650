"""Local disk for fetched logs: limited in size, and cleared however a process ends.

A process has a folder per log, whose name has the machine, the process and its start time. If the
process is killed, the next process on that machine removes the folder and records in the store that
the log killed a process; other machines can't distinguish a killed process from a lost machine.
"""

import hashlib
import json
import os
import secrets
import shutil
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from jaxdet.errors import ConfigError, InputError, JaxdetError
from jaxdet.fleet.place import open_place
from jaxdet.results.durable import writing

_WITNESS = "attempt.json"
_BOOT = Path("/proc/sys/kernel/random/boot_id")


@cache
def machine() -> str:
    """Return a name for this machine that changes with each boot."""
    boot = _BOOT.read_text(encoding="ascii").strip() if _BOOT.exists() else ""
    return hashlib.sha256(f"{os.uname().nodename} {boot}".encode()).hexdigest()[:12]


def process() -> str:
    """Return a name for this process, made of the machine, the process number and its start."""
    return f"{machine()}-{os.getpid()}-{_start(os.getpid())}"


def is_dead(name: str) -> bool | None:
    """Return whether a process has ended; None if it ran on another machine."""
    on, pid, start = name.split("-")[:3]
    return None if on != machine() else _start(int(pid)) != start


def _start(pid: int) -> str:
    """Return the start time of a process, or ``0`` if it is unknown; empty if it has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        state, *fields = text.rpartition(")")[2].split()
        return "" if state in "ZX" else fields[18]
    except OSError:
        with suppress(OSError):
            os.kill(pid, 0)
            return "0"
        return ""


class Spool:
    """Folder on local disk for one log.

    Args:
        base: Parent folder; by default that of temporary files.
    """

    def __init__(self, base: str | None = None) -> None:
        self.path = base_folder(base) / f"{process()}-{secrets.token_hex(4)}"
        with writing(self.path):
            self.path.mkdir()

    def witness(self, url: str, key: str) -> None:
        """Record the attempt that uses the folder, so that :func:`sweep` can report its death."""
        with writing(self.path):
            text = json.dumps({"url": url, "key": key})
            (self.path / _WITNESS).write_text(text, encoding="utf-8")

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.path, ignore_errors=True)


def base_folder(base: str | None) -> Path:
    """Return the folder of all spools of this user on this machine; it is made if missing.

    Raises:
        ConfigError: It is another user's, who could change the logs in it.
    """
    folder = Path(base or tempfile.gettempdir()).absolute() / f"jaxdet-spool-{os.getuid()}"
    with writing(folder):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = folder.lstat().st_uid
    if owner != os.getuid() or folder.is_symlink():
        problem = f"is a link, or belongs to another user (number {owner})"
        raise ConfigError(problem, path=str(folder), remedy="pass --spool another folder")
    return folder


def check_room(base: str | None, size: int, bound: int | None, held: int) -> None:
    """Check that a log fits on the disk.

    Args:
        base: See :class:`Spool`.
        size: Bytes of the log.
        bound: Maximum size of a process's logs [bytes]; by default three quarters of the disk's
            free space.
        held: Size of this process's logs that are already on the disk [bytes].

    Raises:
        InputError: The log doesn't fit.
    """
    folder = base_folder(base)
    with writing(folder):
        free = shutil.disk_usage(folder).free
    most = (free + held) * 3 // 4 if bound is None else bound
    if size > min(most - held, free):
        problem = f"has {size} bytes; local disk may hold {max(0, min(most - held, free))} more"
        raise InputError(problem, remedy="pass --spool a larger disk, or a larger --spool-size")


def sweep(base: str | None = None) -> int:
    """Remove folders of killed processes of this machine; return the number of folders."""
    dead = [path for path in base_folder(base).glob("*-*-*-*") if is_dead(path.name)]
    for folder in dead:
        with suppress(OSError, ValueError, KeyError, JaxdetError):
            noted = json.loads((folder / _WITNESS).read_text(encoding="utf-8"))
            testify(noted["url"], noted["key"])
        shutil.rmtree(folder, ignore_errors=True)
    return len(dead)


def testify(url: str, key: str) -> None:
    """Record that the process of an attempt died while its machine kept running."""
    place = open_place(url)
    if found := place.get(key):
        record = {**json.loads(found[0]), "killed": True}
        place.swap(key, json.dumps(record).encode(), found[1])
