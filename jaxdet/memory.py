"""How much memory this process may have."""

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
    """Bytes of this machine, or of its control group where that has fewer."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(total, *_group_limits(), total)


def _group_limits() -> Iterator[int]:
    """What the control groups of this process allow, its own and those it is in."""
    try:
        lines = _OWN.read_text(encoding="utf-8").splitlines()
    except OSError:  # another system
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
            with suppress(OSError, ValueError):  # not here, or "max"
                yield int((folder / file).read_text(encoding="ascii"))
            if folder == base:
                break


def parse_size(text: str, flag: str) -> int:
    """A number of bytes: ``800MiB``, ``1.5G``, ``2GB``; K, M, G and T alone are 1024 and so on.

    Args:
        text: The number with its unit.
        flag: What the user gave it to.

    Raises:
        ConfigError: It is none.
    """
    found = _SIZE.fullmatch(text.strip())
    unit = found and found[2].lower()
    if not found or unit not in _UNITS:
        remedy = f"give {flag} a number with a unit, for instance 800MiB or 4GiB"
        raise ConfigError(f"{flag} {text!r} is no size", remedy=remedy)
    return int(float(found[1]) * _UNITS[unit])


def size_text(nbytes: int) -> str:
    """A number of bytes that is given as a least one, in whole MiB, as :func:`parse_size` reads."""
    return f"{-(-nbytes >> 20)}MiB"
