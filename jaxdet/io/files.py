"""From what the user names (files, folders, globs) to logs."""

import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice, pairwise
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from jaxdet.errors import InputError, printable
from jaxdet.io.image_folder import BESIDE, image_folders, stamp_note
from jaxdet.io.splits import Recording, Sketch, difference, gap, joined, recordings, sketch
from jaxdet.io.unpacking import PACKED, is_packed

_RECORDINGS = (".mcap", ".db3", ".bag")
SUFFIXES = (*_RECORDINGS, *PACKED)
"""Of the files that are read; of one recording in several formats the first is taken. A compressed
file has the suffix of its recording before its own."""
_SPLIT = re.compile(
    r"(?P<stem>.+)_(?P<number>\d{1,5}|00\d{4,})\.(?i:mcap|db3|bag)(?i:\.zstd|\.zst|\.bz2)?"
)
"""What has more digits, and does not begin with two zeros, is a time or a date, but for
:data:`_LATE` ones."""
_LATE = re.compile(
    r"(?P<stem>.+)_(?P<number>(?!00)\d{6})\.(?i:mcap|db3|bag)(?i:\.zstd|\.zst|\.bz2)?"
)
"""Splits too, where the one of :data:`_BEFORE_LATE` is there, which is no time of day."""
_BEFORE_LATE = "009999"
_OTHERS = {
    ".zstd": "name a recording, as NAME.mcap.zstd",
    ".zst": "name a recording, as NAME.mcap.zst",
    ".bz2": "name a recording, as NAME.bag.bz2",
    ".mcap.active": "take .active off its name when nothing writes to it any more",
    ".db3.active": "take .active off its name when nothing writes to it any more",
    ".active": "run rosbag reindex on it and name it .bag",
    ".svo": "play it to ROS 2 topics and record them as MCAP",
    ".svo2": "play it to ROS 2 topics and record them as MCAP",
    ".mkv": "play it to ROS 2 topics and record them as MCAP",
    ".oni": "play it to ROS 2 topics and record them as MCAP",
    ".r3d": "in Record3D, export it as EXR + JPG sequence, and convert its depth to PNG as jaxdet "
    "help logs shows",
}
"""How names of recordings end that are not read, and what can be done; the first that fits."""
_DATASET = "write its frames as PNG to color/ and depth/ with a camera.json, see jaxdet help logs"
"""What can be done with a LeRobot dataset: its depth is video of 12 bits, TIFF or Parquet, by
version, and nowhere has it the camera's calibration."""
_PNG = "convert it to 16-bit PNG in millimetres, as jaxdet help logs shows (the Python package "
_PNG += "OpenEXR reads it)"
EXPORTED = ".jaxdet.mcap"
"""How files for Foxglove and ROS 2 are named that jaxdet exports, for beside the log. The name says
so, as their headers are those of any writer."""
_MAX_LISTED, _MAX_MISSING = 4, 1000
MAX_FOLDERS = 100_000
"""Folders that are searched for logs."""


class LogFiles(NamedTuple):
    """One log: a file, or the split files of one recording in order."""

    name: str
    """Its path under the folder that was named, without the suffix; printable."""
    paths: tuple[Path, ...]
    note: str = ""
    """Warning about the selection of files."""
    about: str = ""
    """Note about their choice: what was joined."""


def find_logs(
    inputs: Sequence[str | PathLike[str]] | str | PathLike[str], *, join: bool = True
) -> list[LogFiles]:
    """Find the logs in files, folders (searched with their subfolders) and globs.

    Files ``NAME_0.mcap``, ``NAME_1.mcap``, ... of one folder are one log called ``NAME``, in the
    order of their numbers, where ``metadata.yaml`` lists them or their numbers, topics,
    calibration and times follow on (:mod:`jaxdet.io.splits`); one that begins with a later number
    than 1 is called by its first file. Every other ``.mcap`` file is a log.
    So are ``.db3`` and ``.bag`` files; of a recording that a folder holds in several of these
    formats one is taken, MCAP first. A folder of colour and depth images
    (:mod:`jaxdet.io.image_folder`) is a log, but where a recording lies in it or beside it, whose
    images they are. So is a folder that can't be listed, which fails when it is opened. Exports of
    jaxdet are left out, unless they are named themselves.

    A log is called by its path under the folder that was named (of a glob: under the folder before
    the first ``*``), so its name does not depend on other logs. A file named twice counts once, by
    its longest name; the order is by path and does not depend on the order of ``inputs``.

    Args:
        inputs: What is looked through.
        join: Join the splits of a recording; else every file is a log.

    Raises:
        InputError: An input doesn't exist or holds nothing that is read.
    """
    named = [inputs] if isinstance(inputs, str | PathLike) else inputs
    if not isinstance(named, Iterable):
        named = [named]
    named = list(named)
    for item in named:
        if not isinstance(item, str | PathLike):
            problem = f"{type(item).__name__} is no path"
            raise InputError(problem, topic="inputs", remedy="give texts or paths")
    chosen: dict[Path, Path] = {}
    said: dict[Path, str] = {}
    for item in named:
        text = os.fspath(item)
        found, notes = _files(text)
        root = _root(text)
        for path in found:
            chosen[path] = min(root, chosen.get(path, root), key=lambda root: len(root.parts))
        said |= {path.resolve(): note for path, note in notes.items()}
    paths = _once(chosen)
    groups: dict[tuple[Path, str, str], list[Path]] = {}
    for (_, stem, number, _), path in sorted((_order(path), path) for path in paths):
        key = path.parent, path.name if number < 0 or not join else stem, path.suffix
        groups.setdefault(key, []).append(path)
    logs = []
    for group in groups.values():
        parts = [Recording(tuple(group), "")]
        if len(group) > 1:
            parts = recordings([(_split(path)[1], path) for path in group])
        for part in parts:
            files = [paths[path] for path in part.paths]
            notes = "; ".join(filter(None, (said.get(file.target, "") for file in files)))
            name = _name(files[0], chosen[files[0].path], joined=len(files) > 1)
            logs.append(LogFiles(name, tuple(file.path for file in files), notes, part.note))
    return logs


def _root(text: str) -> Path:
    """Return the folder under which the logs of an input have their names."""
    path = Path(text)
    if path.is_dir():
        return path
    if path.exists() or not glob.has_magic(text):
        return path.parent
    first = next(number for number, part in enumerate(path.parts) if glob.has_magic(part))
    return Path(*path.parts[:first])


def _name(file: "_Named", root: Path, *, joined: bool) -> str:
    """Return the name of a log by its first file and the folder that was named."""
    path = file.path
    if path == root:  # a folder that is a log, named itself
        return printable(path.resolve().name or "log")
    own = path.name if path.is_dir() else _bare_name(path)
    if joined and 0 <= (split := _split(path))[1] <= 1:
        own = split[0]
    folders = path.parent.parts[len(root.parts) :] if path.is_relative_to(root) else ()
    return printable("/".join((*folders, own)))


class _Named(NamedTuple):
    """A file or folder that was named."""

    place: Path
    """See :func:`place_of`."""
    target: Path
    """The same, a link's own name followed as well."""
    path: Path
    """As it was named."""


def _once(found: Iterable[Path]) -> dict[Path, _Named]:
    """Each file once, by its place; one that is named by links as well, by its own name.

    Links of files are not followed for names: caches of data sets link to files named by a hash.
    """
    folders: dict[Path, Path] = {}
    named = []
    for path in found:
        place = _place(path, folders)
        named.append(_Named(place, place.resolve() if place.is_symlink() else place, path))
    named.sort(key=lambda one: (one.place, one.path), reverse=True)
    named.sort(key=lambda one: one.place == one.target)
    own = {one.target: one for one in named}
    return {one.place: one for one in own.values()}


def place_of(path: Path) -> Path:
    """Return the path of a file with links of its folders followed, but not its own."""
    return _place(path, {})


def _place(path: Path, folders: dict[Path, Path]) -> Path:
    """Return the same; folders that were looked up already are taken from ``folders``."""
    if path.is_dir():
        return path.resolve()
    parent = path.parent
    if parent not in folders:
        folders[parent] = parent.resolve()
    return folders[parent] / path.name


def missing_splits(log: LogFiles) -> tuple[int, ...]:
    """Return the first numbers that lack between the first and the last split of a log."""
    numbers = {_split(path)[1] for path in log.paths}
    if len(log.paths) < 2 or -1 in numbers:
        return ()
    gaps = (range(one + 1, other) for one, other in pairwise(sorted(numbers)))
    return tuple(islice(chain.from_iterable(gaps), _MAX_MISSING))


def siblings(log: LogFiles) -> tuple[Path, ...]:
    """Return the splits of the same recording that are not part of the log, in order.

    rosbag2 writes static transforms to the first split only, so they are looked for there.
    """
    begin = log.paths[0]
    stem, first = _split(begin)
    if first < 0:
        return ()
    named = begin.parent.glob(f"{glob.escape(stem)}_*{begin.suffix}")
    splits = [path for path in sorted(named, key=_order) if _split(path)[0] == stem]
    before = [path for path in splits if _split(path)[1] < first]
    after = [path for path in splits[len(before) :] if path.resolve() != begin.resolve()]
    if not (before or after):
        return ()
    own = sketch(begin)
    return (*reversed([*_going_on(log, own, before[::-1])]), *_going_on(log, own, after))


def _going_on(log: LogFiles, known: Sketch | None, splits: Iterable[Path]) -> Iterator[Path]:
    """Splits beside a log's files, farther and farther, that go with all nearer ones.

    What does not go with them is passed over; but where it is too far in time, so is the rest.
    """
    own, near = {path.resolve() for path in log.paths}, _split(log.paths[0])[1]
    for path in splits:
        number, found = _split(path)[1], sketch(path)
        if path.resolve() not in own:
            steps = number - near
            pair = (known, found) if steps > 0 else (found, known)
            if gap(*pair, abs(steps)):
                return
            if difference(*pair, abs(steps)):
                continue
            yield path
        known = joined(known, found)
        near = number if found and found.span_ns else near


def _seen(text: str, skipped: list[Path]) -> list[Path]:
    """Return the files of any kind that an input names, in order, and unreadable folders.

    Links to folders above go to ``skipped``.
    """
    path = Path(text)
    _check_path(path)
    if not text:  # a shell's variable that is not set is not this folder
        raise InputError("a log without a name", remedy="check the arguments")
    if path.exists():
        return sorted(_within(path, skipped))
    if "://" in text:
        problem, remedy = "addresses are not read", "copy it to a disk, or mount the storage"
        raise InputError(problem, path=text, remedy=remedy)
    if not glob.has_magic(text):
        raise InputError("no such file or folder", path=text, remedy="check the path")
    matches = [Path(match) for match in sorted(glob.glob(text, recursive=True))]
    for match in matches:
        _check_path(match)
    # A folder may match, and what is in it.
    return list(dict.fromkeys(file for match in matches for file in _within(match, skipped)))


def _files(text: str) -> tuple[list[Path], dict[Path, str]]:
    """Return the files of an input that are read, at least one, and notes by file."""
    if Path(text).name == "metadata.yaml" and Path(text).is_file():
        text = str(Path(text).parent)  # of rosbag2: its files are named in it
    path, seen, rest, above = Path(text), list[Path](), list[Path](), list[Path]()
    for item in _seen(text, above):
        (seen if item.is_file() else rest).append(item)
    shut = [item for item in rest if item.is_dir()]
    links = [item for item in rest if item.is_symlink() and _is_recording(item)]
    gone = [item for item in links if not item.exists()]
    others = [file for file in seen if _advice(file)]
    datasets = [file.parents[1] for file in seen if _is_dataset(file)]
    exports = [file for file in seen if _is_export(file)]
    found = [file for file in seen if _is_recording(file) and not _is_export(file)]
    if path.is_file():
        if others:
            problem = f"{path.suffix} files are not read"
            raise InputError(problem, path=text, remedy=_advice(path))
        return seen, {}
    places = {file.parent for file in found}
    images = image_folders(seen)
    copies = {item for item in images if places & {item, item.parent}}
    folders = [item for item in images if item not in copies]
    stamps = {item: note for item in folders if (note := stamp_note(item))}
    if not found and (folders or shut):
        return [*folders, *shut], stamps
    exr = [file for file in seen if file.suffix.lower() == ".exr"]
    if not found and exr:
        problem = "depth in OpenEXR files, as of Record3D, is not read"
        raise InputError(problem, path=str(exr[0].parent), remedy=_PNG)
    if not found and datasets:
        problem = "is a LeRobot dataset, which holds no camera's calibration"
        raise InputError(problem, path=str(datasets[0]), remedy=_DATASET)
    if not found:
        raise _nothing(text, others, exports, gone)
    taken, left = _preferred(found)
    left += [(file, _advice(file)) for file in others]
    left += [(file, "a link to nothing") for file in gone]
    left += [(item, "a link to a folder above it") for item in above]
    left += [(file, "an export of jaxdet") for file in exports]
    left += [(item, "images beside a recording") for item in sorted(copies)]
    left += [(item, "a LeRobot dataset") for item in datasets]
    notes = [f"{_within_input(item, path)} is left out: {why}" for item, why in left[:_MAX_LISTED]]
    more = [f"and {len(left) - _MAX_LISTED} more"] if len(left) > _MAX_LISTED else []
    return [*taken, *folders, *shut], {taken[0]: "; ".join([*notes, *more]), **stamps}


def _within_input(file: Path, named: Path) -> str:
    """Return a file's path relative to the input; for a glob its name."""
    return printable(str(file.relative_to(named) if file.is_relative_to(named) else file.name))


def _advice(file: Path) -> str:
    """Return the remedy for a recording that is not read; empty for all other files."""
    if _is_recording(file):
        return ""
    name = file.name.lower()
    return next((remedy for ending, remedy in _OTHERS.items() if name.endswith(ending)), "")


def _nothing(
    text: str, others: Sequence[Path], exports: Sequence[Path], gone: Sequence[Path]
) -> InputError:
    """Return the error of an input without logs, by what else it holds."""
    where, remedy = text, "name an MCAP file or a folder; jaxdet help logs has the layouts of "
    remedy += "folders of images"
    problem = "no .mcap, .bag or .db3 file and no folder of images found"
    if others:
        where, remedy = str(others[0]), _advice(others[0])
        problem = f"{others[0].suffix} files are not read, and there is nothing else here"
    elif exports:
        where, remedy = str(exports[0]), "name the log that it was made of"
        problem = "an export of jaxdet, and there is nothing else here"
    elif gone:
        where, remedy = str(gone[0]), "mend the link"
        problem = "a link to nothing, and there is nothing else here"
    return InputError(problem, path=where, remedy=remedy)


def _is_recording(file: Path) -> bool:
    """Return whether a file is of a format that is read, by its name."""
    return (file.with_suffix("") if is_packed(file) else file).suffix.lower() in _RECORDINGS


def _bare_name(file: Path) -> str:
    """Return a file's name without the suffixes of its format."""
    return (file.with_suffix("") if is_packed(file) else file).stem


def _is_export(file: Path) -> bool:
    return file.name.lower().endswith(EXPORTED)


def _is_dataset(file: Path) -> bool:
    """Return whether a file describes a LeRobot dataset."""
    if file.name != "info.json" or file.parent.name != "meta":
        return False
    try:
        return b'"codebase_version"' in file.read_bytes()[:4096]
    except OSError:
        return False


def _check_path(path: Path) -> None:
    """Refuse a path that the system does not accept; there may be nothing at it.

    Raises:
        InputError: It is too long, has a zero byte, or may not be looked at.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):  # perhaps a glob
        return
    except (OSError, ValueError) as error:
        problem = f"can't be read ({getattr(error, 'strerror', None) or error})"
        raise InputError(problem, path=str(path)[:200], remedy="check the path") from error


def _preferred(found: Sequence[Path]) -> tuple[list[Path], list[tuple[Path, str]]]:
    """Return the files that are read of those found, and the others, each with the reason.

    A file is left out where its recording is there in a format that is read rather. A split is not
    where that has other numbers alone, and images of other times: it may be half converted, or
    another recording.
    """
    known: dict[tuple[Path, str], dict[str, list[Path]]] = {}
    of = [known.setdefault(recording_of(file), {}) for file in found]
    for file, formats in zip(found, of, strict=True):
        formats.setdefault(format_of(file), []).append(file)
    taken, left = [], []
    for file, formats in zip(found, of, strict=True):
        rather = SUFFIXES[: SUFFIXES.index(format_of(file))]
        better = [one for kind in rather for one in formats.get(kind, ())]
        number = _split(file)[1] if better else -1
        same = [one for one in better if number < 0 or _split(one)[1] in (number, -1)]
        if better and (same or _has_times_of(file, formats[format_of(better[0])])):
            suffix = format_of((same or better)[0])
            left.append((file, f"its recording is there as {suffix}"))
        else:
            taken.append(file)
    return taken, left


def _has_times_of(file: Path, others: Sequence[Path]) -> bool:
    """Return whether images of a file may be of the same times as those of others."""
    known = sketch(file)
    spans = [one.span_ns for one in map(sketch, others) if one and one.span_ns]
    if known is None or known.span_ns is None or not spans:
        return True
    first, last = zip(*spans, strict=True)
    return known.span_ns[0] < max(last) and known.span_ns[1] > min(first)


def recording_of(path: Path) -> tuple[Path, str]:
    """Return what all files of a recording have in common, whatever their format."""
    return path.parent, _split(path)[0]


def format_of(path: Path) -> str:
    """Return the suffix that names the format of a file, one of :data:`SUFFIXES`."""
    return path.suffix.lower()


def _within(path: Path, skipped: list[Path]) -> Iterable[Path]:
    """Yield a file, or all files in a folder and its subfolders but :data:`BESIDE`.

    Of a folder that can't be listed, or whose files can't be looked at, it is the folder itself.
    Links to folders above are not followed: they go to ``skipped``.

    Raises:
        InputError: There are more than ``MAX_FOLDERS`` folders.
    """
    if not path.is_dir():
        yield path
        return
    walked, shut, own = set[tuple[int, int]](), list[Path](), path.resolve()
    listed = os.walk(
        path, onerror=lambda error: shut.append(Path(error.filename)), followlinks=True
    )
    for folder, folders, files in listed:
        try:
            about = os.stat(os.path.join(folder, os.curdir))
        except OSError:
            folders.clear()
            shut.append(Path(folder))
            continue
        if (about.st_dev, about.st_ino) in walked:
            folders.clear()
            continue
        walked.add((about.st_dev, about.st_ino))
        if len(walked) > MAX_FOLDERS:
            problem = f"there are more than {MAX_FOLDERS} folders in it"
            raise InputError(problem, path=str(path), remedy="name a smaller folder")
        links = [name for name in folders if os.path.islink(os.path.join(folder, name))]
        up = [name for name in links if own.is_relative_to(Path(folder, name).resolve())]
        skipped += [Path(folder, n) for n in up if Path(folder, n).resolve() != own]
        folders[:] = [name for name in folders if name not in up]
        yield from (Path(folder, name) for name in files if not name.startswith(BESIDE))
    yield from shut


def _split(path: Path) -> tuple[str, int]:
    """Return the common name of the splits of a recording, and the number; -1: not a split."""
    match = _SPLIT.fullmatch(path.name) or _late_split(path)
    return (match["stem"], int(match["number"])) if match else (_bare_name(path), -1)


def _late_split(path: Path) -> re.Match[str] | None:
    match = _LATE.fullmatch(path.name)
    if match is None:
        return None
    before = path.with_name(f"{match['stem']}_{_BEFORE_LATE}{path.suffix}")
    return match if os.path.exists(before) else None


def _order(path: Path) -> tuple[str, str, int, str]:
    return (str(path.parent), *_split(path), path.name)
