"""From what the user names (files, folders, globs) to logs."""

import glob
import os
import re
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from jaxdet.errors import InputError, printable
from jaxdet.io.splits import Recording, Sketch, difference, recordings, sketch

_SPLIT = re.compile(r"(?P<stem>.+)_(?P<number>\d+)\.mcap")


class LogFiles(NamedTuple):
    """One log: a file, or the split files of one recording in order."""

    name: str
    """Unique among the logs found together; may hold ``/`` (parent folders)."""
    paths: tuple[Path, ...]
    note: str = ""
    """What is to be said of their choice."""


def find_logs(inputs: Sequence[str | PathLike[str]] | str | PathLike[str]) -> list[LogFiles]:
    """The logs in files, folders (searched with their subfolders) and globs.

    Files ``NAME_0.mcap``, ``NAME_1.mcap``, ... of one folder are the splits of one log called
    ``NAME``, in the order of their numbers, with or without a ``metadata.yaml``, unless what is in
    them speaks against it (:mod:`jaxdet.io.splits`); every other ``.mcap`` file is a log called by
    its stem. Names are made printable. Equal names get as many parent folders put
    before them as it takes. A file named twice counts once; the order is by path and does not
    depend on the order of ``inputs``.

    Raises:
        InputError: An input doesn't exist or holds no ``.mcap`` file.
    """
    named = [inputs] if isinstance(inputs, str | PathLike) else inputs
    paths = _once([path for item in named for path in _files(os.fspath(item))])
    groups: dict[tuple[Path, str], list[Path]] = {}
    for path in sorted(paths, key=_order):
        match = _SPLIT.fullmatch(path.name)
        groups.setdefault((path.parent, match["stem"] if match else path.name), []).append(path)
    stems, members = [], []
    for (_, stem), group in groups.items():
        parts = [Recording(tuple(group), "")]
        if len(group) > 1:
            parts = recordings((_number(path), path) for path in group)
        for part in parts:
            alone = len(part.paths) == 1 or len(parts) > 1
            first = part.paths[0]
            stems.append(first.with_suffix("") if alone else first.with_name(stem))
        members += parts
    names = _unique_names(stems)
    return [
        LogFiles(name, tuple(paths[path] for path in part.paths), part.note)
        for name, part in zip(names, members, strict=True)
    ]


def _once(found: Iterable[Path]) -> dict[Path, Path]:
    """Each file once, by its absolute path; one that is named by links as well, by its own name.

    Links are not followed for names: caches of data sets link them to files named by a hash.
    """
    names = sorted(((Path(os.path.abspath(path)), path) for path in found), reverse=True)
    own: dict[Path, tuple[Path, Path]] = {}
    for absolute, path in sorted(names, key=lambda item: item[0] == item[0].resolve()):
        own[path.resolve()] = absolute, path
    return dict(own.values())


def missing_splits(log: LogFiles) -> tuple[int, ...]:
    """The numbers lacking between the first and the last split of a log."""
    numbers = {_number(path) for path in log.paths}
    if len(log.paths) < 2 or -1 in numbers:
        return ()
    return tuple(sorted(set(range(min(numbers), max(numbers))) - numbers))


def siblings(log: LogFiles) -> tuple[Path, ...]:
    """The splits of the same recording, beside the log's files but not of them, in order.

    rosbag2 writes static transforms to the first split only, so they are looked for there.
    """
    have = {path.resolve() for path in log.paths}
    first = log.paths[0]
    match = _SPLIT.fullmatch(first.name)
    if not match:
        return ()
    found = []
    for path in first.parent.glob("*.mcap"):
        other = _SPLIT.fullmatch(path.name)
        if other and other["stem"] == match["stem"] and path.resolve() not in have:
            found.append(path)
    if not found:
        return ()
    own, number = sketch(first), _number(first)
    return tuple(path for path in sorted(found, key=_order) if _belongs(path, own, number))


def _belongs(path: Path, own: Sketch | None, number: int) -> bool:
    """Whether a split is of the same recording as the one with a number."""
    steps = _number(path) - number
    pair = (own, sketch(path)) if steps > 0 else (sketch(path), own)
    return not difference(*pair, abs(steps))


def _files(text: str) -> list[Path]:
    path = Path(text)
    if path.is_dir():
        found = [file for file in path.rglob("*.mcap") if file.is_file()]
        packed = next(path.rglob("*.mcap.zstd"), None)
    elif path.exists():
        found, packed = [path], path if path.suffix == ".zstd" else None
    elif glob.has_magic(text):
        matches = [Path(match) for match in sorted(glob.glob(text, recursive=True))]
        found = [file for match in matches for file in _within(match)]
        packed = next((match for match in matches if match.suffix == ".zstd"), None)
    else:
        raise InputError("no such file or folder", path=text, remedy="check the path")
    if packed and (not found or found == [packed]):
        raise InputError("the file is compressed", path=str(packed), remedy="run unzstd on it")
    if not found:
        raise InputError("no .mcap file found", path=text, remedy="name an MCAP file or a folder")
    return found


def _within(path: Path) -> Iterable[Path]:
    return path.rglob("*.mcap") if path.is_dir() else [path] if path.suffix == ".mcap" else []


def _number(path: Path) -> int:
    match = _SPLIT.fullmatch(path.name)
    return int(match["number"]) if match else -1


def _order(path: Path) -> tuple[str, str, int, str]:
    match = _SPLIT.fullmatch(path.name)
    return (str(path.parent), match["stem"] if match else path.stem, _number(path), path.name)


def _unique_names(stems: Sequence[Path]) -> list[str]:
    names = [printable(stem.name) for stem in stems]
    for depth in range(2, 1 + max((len(stem.parts) for stem in stems), default=0)):
        double = {name for name in names if names.count(name) > 1}
        if not double:
            break
        names = [
            printable("/".join(stem.parts[-depth:])) if name in double else name
            for name, stem in zip(names, stems, strict=True)
        ]
    for number, name in enumerate(names):  # what is printable may be equal
        if name in names[:number]:
            names[number] = f"{name} ({number})"
    return names
