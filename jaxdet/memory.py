"""Memory limits of this process, and sizes in bytes."""

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from jaxdet.errors import ConfigError

_GROUPS, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
_UNITS = {"": 1, "b": 1, **{f"{name}ib": 1 << 10 * (i + 1) for i, name in enumerate("kmgt")}}
_UNITS |= {name[0]: size for name, size in _UNITS.items() if name}
_UNITS |= {f"{name}b": 1000 ** (i + 1) for i, name in enumerate("kmgt")}
_SIZE = re.compile(r"(\d{1,18}(?:\.\d+)?) ?([kmgt]?(?:i?b)?)", re.IGNORECASE | re.ASCII)


def machine_memory() -> int:
    """Return the size of the machine's memory, or the lowest limit of its control groups [byte]."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(total, *_group_limits(), total)


def _group_limits() -> Iterator[int]:
    """Yield the memory limits of this process's control group and its parents [byte]."""
    try:
        lines = _OWN.read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return
    for line in lines:
        _, kinds, name = line.split(":", 2)
        base, file = _GROUPS, "memory.max"
        if kinds:
            if "memory" not in kinds.split(","):
                continue
            base, file = _GROUPS / "memory", "memory.limit_in_bytes"
        group = base / name.strip("/")
        for folder in (group, *group.parents):
            with suppress(OSError, ValueError):  # no such file, or "max"
                yield int((folder / file).read_text(encoding="ascii"))
            if folder == base:
                break


def parse_size(text: str, flag: str) -> int:
    """Parse a size: ``800MiB``, ``1.5G``, ``2GB``; units without B are powers of 1024.

    Args:
        text: Number with its unit.
        flag: Name of the flag, for the error.

    Raises:
        ConfigError: The text is not a valid size.
    """
    match = _SIZE.fullmatch(text.strip())
    unit = match and match[2].lower()
    if not match or unit not in _UNITS:
        remedy = "pass a number with a unit, for instance 800MiB or 4GiB"
        raise ConfigError(f"{flag}: expected a size, got {text!r}", remedy=remedy)
    return int(float(match[1]) * _UNITS[unit])


def size_text(nbytes: int) -> str:
    """Format a number of bytes as a size in whole MiB, rounded up; :func:`parse_size` reads it."""
    return f"{-(-nbytes >> 20)}MiB"
