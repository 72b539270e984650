"""What files of a log are called."""

import re
from collections.abc import Iterable


def file_names(logs: Iterable[str]) -> list[str]:
    """The logs' names with nothing that a file name should not have, each different."""
    names: list[str] = []
    for log in logs:
        name = stem = re.sub(r"[^\w.-]+", "_", log).strip(".")[:80] or "log"
        number = 2
        while name in names:
            name, number = f"{stem}_{number}", number + 1
        names.append(name)
    return names


def camera_file_name(log: str, camera: str) -> str:
    """For one of several cameras of a log, from the name of the log's files."""
    return f"{log}@" + re.sub(r"[^\w.-]+", "_", camera.replace("/", "-"))  # no log's name has an @
