"""Names of the folder of a log's results and of files of its cameras."""

import hashlib
import re
import zlib
from collections.abc import Iterable

MOST_BYTES = 80
"""Longest name of a log or a camera in the name of a file [bytes]; file systems take 255 in all."""
RESERVED = ("run.json", "failed.json")
"""Names that no log's folder has, as files of a run have them."""
_MARK = "~"
"""Before the checksum in a folder's name; no other name has one."""


def log_name(path_under_root: str) -> str:
    """Return the name of the folder for the results of a log.

    It is a function of the log's name alone: letters, digits, ``_``, ``.`` and ``-`` stay, ``/``
    becomes ``--``. A name that can't be read back from that, is long, begins with a dot or has
    capital letters ends in a checksum, so that different logs have different folders on any disk,
    also where the case of letters does not count.

    Args:
        path_under_root: Path of the log under the folder that was named, without its suffix.

    >>> log_name("monday/drive_1")
    'monday--drive_1'
    >>> log_name("Monday drive")
    'Monday_drive~d266d453'
    """
    joined = path_under_root.replace("/", "--")
    name = re.sub(r"[^\w.-]", "_", joined, flags=re.ASCII)[:MOST_BYTES]
    same = name == joined and name.replace("--", "/") == path_under_root
    plain = same and name == name.lower() and not name.startswith(".") and name not in RESERVED
    if plain and name:
        return name
    digest = hashlib.sha256(path_under_root.encode(errors="backslashreplace")).hexdigest()
    return f"{name.lstrip('.')}{_MARK}{digest[:8]}"


def file_names(logs: Iterable[str]) -> dict[str, str]:
    """What the files of each log are called: nothing that they shouldn't be, each different.

    Also where the case of letters makes no difference, as on disks of macOS and Windows.
    """
    names, used = dict[str, str](), set[str]()
    for log in logs:
        name = stem = _plain(log).strip(".") or "log"
        number = 2
        while name.casefold() in used:
            name, number = f"{stem}_{number}", number + 1
        used.add(name.casefold())
        names[log] = name
    return names


def camera_file_name(log: str, camera: str) -> str:
    """For one of several cameras of a log, from the name of the log's files.

    Different cameras have different names: what can't be told from the name has a checksum.
    """
    name = _plain(camera.replace("/", "-"))
    if name.replace("-", "/") != camera:
        name += f"_{zlib.crc32(camera.encode(errors='backslashreplace')):08x}"
    return f"{log}@{name}"  # no log's name has an @


def is_of_one_camera(file_name: str) -> bool:
    """Whether files called so are of one of several cameras of a log."""
    return "@" in file_name


def _plain(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name).encode()[:MOST_BYTES].decode(errors="ignore")
