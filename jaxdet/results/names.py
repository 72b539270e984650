"""What files of a log are called."""

import re
import zlib
from collections.abc import Iterable

MOST_BYTES = 80
"""Of a log's or a camera's name in a file's: file systems take 255 in all."""


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
