"""Names of the folder of a log's results and of files of its cameras."""

import hashlib
import re
import zlib

MOST_BYTES = 80
"""Maximum length of a log's or camera's name in a file name, whose own limit is 255 [bytes]."""
RESERVED = ("run.json", "failed.json")
"""Names of a run's files, which no log's folder may have."""
_MARK = "~"
"""Separator before the checksum in a folder's name; names without a checksum don't have it."""


def log_name(path_under_root: str) -> str:
    """Return the name of the folder for the results of a log.

    It depends only on the log's name: letters, digits, ``_``, ``.`` and ``-`` stay, ``/`` becomes
    ``--``. It ends in a checksum if the log's name can't be restored from it, is long, begins with
    a dot or has capital letters. So different logs have different folders on any disk, even if its
    file system ignores the case of letters.

    Args:
        path_under_root: Path of the log relative to the run's input folder, without its suffix.

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


def camera_name(camera: str) -> str:
    """Return the part of a log's file names that identifies one of its cameras.

    It is different for each camera, as it ends in a checksum if the camera's name can't be restored
    from it.
    """
    name = _plain(camera.replace("/", "-"))
    if name.replace("-", "/") != camera:
        name += f"_{zlib.crc32(camera.encode(errors='backslashreplace')):08x}"
    return name


def export_name(log: str, camera: str = "") -> str:
    """Return the prefix of the names of a log's files in an export.

    Args:
        log: Name of the log.
        camera: Camera, if the log has several.
    """
    return f"{log_name(log)}@{camera_name(camera)}" if camera else log_name(log)


def _plain(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name).encode()[:MOST_BYTES].decode(errors="ignore")
