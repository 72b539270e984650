"""Search for logs in files, folders and globs."""

import glob
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import chain, islice, pairwise
from os import PathLike
from pathlib import Path, PurePath
from typing import NamedTuple, TypeVar

from jaxdet.errors import InputError, printable
from jaxdet.io.folders.layouts import LAYOUTS, image_folders
from jaxdet.io.folders.recording import APPLE_DOUBLE
from jaxdet.io.formats import PACKED, RECORDINGS, bare_name
from jaxdet.io.splits import Recording, listed_files, recording_around, recordings, signature

SUFFIXES = (*RECORDINGS, *PACKED)
"""Suffixes of the files that are read, by priority. The name of a compressed file has two suffixes,
such as ``.mcap.zst``."""
_ENDINGS = ["|".join(map(re.escape, suffixes)) for suffixes in (RECORDINGS, PACKED)]
_SPLIT = re.compile(
    r"(?P<stem>.+)_(?P<number>\d{1,5}|00\d{4,})" + "(?i:{})(?i:{})?".format(*_ENDINGS)
)
"""Name of a split. Numbers of six and more digits are dates or times unless they start with 00."""
_BEGIN = re.compile(r"(?:^|_)\d{4}(?:-\d\d){5}$")
"""Time at which a split of ROS 1 begins, in its name before the number."""
_AS_IMAGES = "write its frames as PNG to color/ and depth/ with a camera.json, see jaxdet help logs"
_ZED = "play it with zed-ros2-wrapper and record the topics as MCAP"
_OTHERS = {
    ".mcap.active": "remove .active from its name once nothing writes to it",
    ".db3.active": "remove .active from its name once nothing writes to it",
    ".active": "run rosbag reindex on it and rename it to .bag",
    ".svo": _ZED,
    ".svo2": _ZED,
    ".mkv": "if it is from an Azure Kinect, export it with Open3D's azure_kinect_mkv_reader.py",
    ".oni": f"open it with OpenNI 2, and {_AS_IMAGES}",
    ".sens": "export its images with ScanNet's SensReader",
    ".depth.pgm": "convert its depth to 16-bit PNG (frame-000000.depth.png)",
    ".r3d": "in Record3D, export it as EXR + JPG sequence, and convert its depth to PNG as jaxdet "
    "help logs shows",
}
"""Unsupported recordings by the end of their names, with remedies; the first match counts."""
_ARCHIVES = dict.fromkeys((".tar", ".tgz", ".zip", ".7z", ".rar"), "unpack it")
_ARCHIVES |= dict.fromkeys((".xz", ".lz4"), "decompress it")
"""Files that may contain a recording, with remedies; next to a recording they are ignored."""
_UNSUPPORTED = _OTHERS | _ARCHIVES
_PNG = "export it as 16-bit PNG in millimetres; jaxdet help logs shows how to convert OpenEXR"
EXPORTED = ".jaxdet.mcap"
"""End of the names of files exported for Foxglove and ROS 2. They are recognised by name, since
their headers are those of any MCAP file."""
_MAX_LISTED, _MAX_MISSING = 4, 1000
_P = TypeVar("_P", bound=PurePath)
MAX_FOLDERS = 100_000
"""Maximum number of folders that are searched."""


class LogFiles(NamedTuple):
    """A log: a file, or the split files of a recording in order."""

    name: str
    """Path relative to the input folder, without the suffix; printable."""
    paths: tuple[Path, ...]
    note: str = ""
    """Warning about files that were left out."""
    about: str = ""
    """Note about files that were joined."""


def find_logs(
    inputs: Sequence[str | PathLike[str]] | str | PathLike[str], *, join: bool = True
) -> list[LogFiles]:
    """Find the logs in files, folders (with their subfolders) and globs.

    Files ``NAME_0.mcap``, ``NAME_1.mcap``, ... (in ROS 1 ``NAME_TIME_0.bag``, ...) in a folder are
    one log named ``NAME`` (``NAME_TIME``) if ``metadata.yaml`` lists them, or if their numbers,
    topics, calibrations and times are consecutive (:mod:`jaxdet.io.splits`). If the first number is
    above 1, the log has the name of its first file. All other ``.mcap`` files, and ``.db3`` and
    ``.bag`` files, are separate logs. If a folder has a recording in several of these formats, one
    of them is used, preferably MCAP. A folder of depth images, with or without
    colour (:mod:`jaxdet.io.folders`), is a log, unless a recording is in it or next to it, which is
    assumed to contain these images. A folder that can't be listed is a log, too; opening it fails.
    Exports of jaxdet are left out unless they are inputs themselves.

    The name of a log is its path relative to the input folder (for a glob: relative to the folder
    before the first ``*``), so it does not depend on other logs. A file that several inputs contain
    counts once, with its longest name. The order is by path and does not depend on the order of
    ``inputs``.

    Args:
        inputs: Files, folders and globs.
        join: Whether to join the splits of a recording; otherwise every file is a log.

    Raises:
        InputError: An input does not exist or contains no log.
    """
    named = [inputs] if isinstance(inputs, str | PathLike) else inputs
    if not isinstance(named, Iterable):
        named = [named]
    named = list(named)
    for item in named:
        if not isinstance(item, str | PathLike):
            problem = f"expected a path, got {type(item).__name__}"
            raise InputError(problem, topic="inputs", remedy="pass strings or paths")
    chosen: dict[Path, Path] = {}
    said: dict[Path, str] = {}
    for item in named:
        text = os.fspath(item)
        found, note = _files(text)
        root = _root(text)
        for path in found:
            chosen[path] = min(root, chosen.get(path, root), key=lambda root: len(root.parts))
        if note:
            said[found[0].resolve()] = note
    paths = _once(chosen)
    logs = []
    for group in _grouped(paths, lambda _: join):
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
    """Return the folder relative to which the logs of an input are named."""
    path = Path(text)
    if path.is_dir():
        return path
    if path.exists() or not glob.has_magic(text):
        return path.parent
    first = next(number for number, part in enumerate(path.parts) if glob.has_magic(part))
    return Path(*path.parts[:first])


def _name(file: "_Named", root: Path, *, joined: bool) -> str:
    """Return the name of a log from its first file and the folder of its input."""
    path = file.path
    if path == root:  # the input folder is a log itself
        return printable(path.resolve().name or "log")
    own = path.name if path.is_dir() else recording_name(path, joined=joined)
    folders = path.parent.parts[len(root.parts) :] if path.is_relative_to(root) else ()
    return printable("/".join((*folders, own)))


class _Named(NamedTuple):
    """A file or folder from the inputs."""

    place: Path
    """Path in which the links of folders are resolved."""
    target: Path
    """Path with all links resolved, including a link of the file itself."""
    path: Path
    """Path as passed by the user."""


def _once(found: Iterable[Path]) -> dict[Path, _Named]:
    """Return each file once, by its ``place``; links to a file that was found are dropped.

    Names are those of the links, as caches of data sets link to files named by a hash.
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


def _place(path: Path, folders: dict[Path, Path]) -> Path:
    """Return the path of a file with the links of its folders resolved, but not its own link.

    ``folders`` caches resolved folders.
    """
    if path.is_dir():
        return path.resolve()
    parent = path.parent
    if parent not in folders:
        folders[parent] = parent.resolve()
    return folders[parent] / path.name


def missing_splits(log: LogFiles) -> tuple[int, ...]:
    """Return the first missing numbers of a log's splits.

    These are the numbers between its first and its last split, and those of files that its
    ``metadata.yaml`` lists but that do not exist.
    """
    numbers = {_split(path)[1] for path in log.paths}
    if -1 in numbers:
        return ()
    gaps = (range(one + 1, other) for one, other in pairwise(sorted(numbers)))
    folder = log.paths[0].parent
    listed = {folder / name for name in listed_files(folder)}
    gone = {_split(path)[1] for path in listed if not path.exists()}
    gone = set() if listed.isdisjoint(log.paths) else gone - {-1}
    return tuple(sorted({*islice(chain.from_iterable(gaps), _MAX_MISSING), *gone}))


def siblings(log: LogFiles) -> tuple[Path, ...]:
    """Return the other files of the log's recording, in order, as :func:`find_logs` joins them.

    rosbag2 writes static transforms only to the first split, so they are searched in all splits.
    """
    begin = log.paths[0]
    stem, number = _split(begin)
    if number < 0:
        return ()
    series = _series(stem)
    named = begin.parent.glob(f"{glob.escape(series)}*{begin.suffix}")
    found = sorted(((_split(path), path) for path in named), key=lambda item: _order(item[1]))
    splits = [(at, path) for (own, at), path in found if at >= 0 and _series(own) == series]
    own = {path.resolve() for path in log.paths}
    places = [place for place, (_, path) in enumerate(splits) if path.resolve() in own]
    around = recording_around(splits, places[0]) if places else ()
    return tuple(path for path in around if path.resolve() not in own)


def _seen(text: str, skipped: list[Path]) -> list[Path]:
    """Return all files of an input in order, and folders that can't be listed.

    Links to parent folders are added to ``skipped``.
    """
    path = Path(text)
    _check_path(path)
    if not text:  # an unset shell variable does not mean the current folder
        raise InputError("the path of a log is empty", remedy="check the arguments")
    if path.exists():
        return sorted(_within(path, skipped))
    if "://" in text:
        problem, remedy = "addresses can't be opened", "download the log, or mount the storage"
        raise InputError(problem, path=text, remedy=remedy)
    if not glob.has_magic(text):
        raise InputError("no such file or folder", path=text, remedy="check the path")
    matches = [Path(match) for match in sorted(glob.glob(text, recursive=True))]
    for match in matches:
        _check_path(match)
    # A glob may match both a folder and its contents.
    return list(dict.fromkeys(file for match in matches for file in _within(match, skipped)))


def _files(text: str) -> tuple[list[Path], str]:
    """Return the readable files of an input, at least one, and a warning about the others."""
    if Path(text).name == "metadata.yaml" and Path(text).is_file():
        text = str(Path(text).parent)  # metadata.yaml of rosbag2 names the files in its folder
    path, seen, rest, above = Path(text), list[Path](), list[Path](), list[Path]()
    for item in _seen(text, above):
        (seen if os.path.isfile(item) else rest).append(item)
    shut = [item for item in rest if os.path.isdir(item)]
    links = [item for item in rest if item.is_symlink() and _is_recording(item)]
    gone = [item for item in links if not os.path.exists(item)]
    others = {file: found for file in seen if (found := _unsupported(file))[1]}
    datasets = [file.parents[1] for file in seen if _is_dataset(file)]
    exports = [file for file in seen if _is_export(file)]
    found = [file for file in seen if _is_recording(file) and not _is_export(file)]
    if path.is_file():
        for ending, remedy in others.values():
            if ending not in PACKED:  # otherwise the content shows whether it is a recording
                raise InputError(f"{ending} files are not supported", path=text, remedy=remedy)
        return seen, ""
    places = {file.parent for file in found}
    images = image_folders(seen)
    copies = {item for item in images if places & {item, item.parent}}
    folders = [item for item in images if item not in copies]
    if not found and (folders or shut):
        return [*folders, *shut], ""
    depth = [file for file in seen if file.parent.name.lower() == "depth" and file.suffix]
    depth = [file for file in depth if file.suffix.lower() != ".png"]
    if not found and depth:
        problem = f"depth in {depth[0].suffix} files is not supported"
        raise InputError(problem, path=str(depth[0].parent), remedy=_PNG)
    if not found and datasets:
        # Their depth is video of 12 bits, TIFF or Parquet, depending on the version.
        problem = "LeRobot datasets are not supported, as they contain no camera calibration"
        raise InputError(problem, path=str(datasets[0]), remedy=_AS_IMAGES)
    if not found:
        raise _nothing(text, others, exports, gone)
    taken, left = _preferred(found, _overlap)
    left += [(file, why) for file, (ending, why) in others.items() if ending not in _ARCHIVES]
    left += [(file, "a broken link") for file in gone]
    left += [(item, "a link to a parent folder") for item in above]
    left += [(file, "an export of jaxdet") for file in exports]
    left += [(item, "images next to a recording") for item in sorted(copies)]
    left += [(item, "a LeRobot dataset") for item in datasets]
    note = left_out_text([(_within_input(item, path), why) for item, why in left])
    return [*taken, *folders, *shut], note


def left_out_text(left: Sequence[tuple[str, str]]) -> str:
    """Return a note on files that were left out, each with the reason."""
    notes = [f"{name} is left out: {why}" for name, why in left[:_MAX_LISTED]]
    more = [f"and {len(left) - _MAX_LISTED} more"] if len(left) > _MAX_LISTED else []
    return "; ".join([*notes, *more])


def _within_input(file: Path, named: Path) -> str:
    """Return a file's path relative to the input; for a glob, its name."""
    return printable(str(file.relative_to(named) if file.is_relative_to(named) else file.name))


def _unsupported(file: Path) -> tuple[str, str]:
    """Return the ending of an unsupported recording or archive, and its remedy; else empty."""
    if _is_recording(file):
        return "", ""
    bare, suffix = bare_name(file), file.suffix.lower()
    if suffix in PACKED and not bare.suffix:
        return suffix, f"rename the recording to NAME.mcap{suffix}"
    ending = next((end for end in _UNSUPPORTED if bare.name.lower().endswith(end)), "")
    return ending, _UNSUPPORTED.get(ending, "")


def _nothing(
    text: str,
    others: Mapping[Path, tuple[str, str]],
    exports: Sequence[Path],
    gone: Sequence[Path],
) -> InputError:
    """Return the error for an input without logs, depending on its other contents.

    ``others`` has results of :func:`_unsupported`.
    """
    if others:
        where, (ending, remedy) = next(iter(others.items()))
        problem = f"{ending} files are not supported, and the input has no others"
    elif exports:
        where, remedy = exports[0], "pass the original log"
        problem = "this is an export of jaxdet, and the input has no other files"
    elif gone:
        where, remedy = gone[0], "correct the link"
        problem = "this is a broken link, and the input has no other files"
    else:
        layouts = ", ".join(layout.names for layout in LAYOUTS)
        remedy = f"pass an MCAP file, or a folder of images in one of these layouts: {layouts}"
        where, remedy = Path(text), f"{remedy} (jaxdet help logs describes them)"
        problem = "no .mcap, .bag or .db3 file and no folder of images found"
    return InputError(problem, path=str(where), remedy=remedy)


def _is_recording(file: PurePath) -> bool:
    """Return whether the format of a file is supported, by its name."""
    return bare_name(file).suffix.lower() in RECORDINGS


def _is_export(file: PurePath) -> bool:
    return file.name.lower().endswith(EXPORTED)


def _is_dataset(file: Path) -> bool:
    """Return whether a file is the description of a LeRobot dataset."""
    if file.name != "info.json" or file.parent.name != "meta":
        return False
    try:
        return b'"codebase_version"' in file.read_bytes()[:4096]
    except OSError:
        return False


def _check_path(path: Path) -> None:
    """Check that the system accepts a path; it need not exist.

    Raises:
        InputError: The path is too long, has a zero byte, or may not be accessed.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):  # may be a glob
        return
    except (OSError, ValueError) as error:
        problem = f"can't be read ({getattr(error, 'strerror', None) or error})"
        raise InputError(problem, path=str(path)[:200], remedy="check the path") from error


def _preferred(
    found: Sequence[_P], overlap: Callable[[_P, Sequence[_P]], bool]
) -> tuple[list[_P], list[tuple[_P, str]]]:
    """Return the files to read, and the files to leave out, each with the reason.

    If a recording exists in several formats, only the file with the preferred one is read. A split
    is read nevertheless if the preferred format has only splits with other numbers, unless these
    overlap in time: the recording may be partly converted, or the split may belong to a different
    recording.

    Args:
        found: Recordings.
        overlap: Function that returns whether a file overlaps in time with any of other files.
    """
    known: dict[tuple[PurePath, str], dict[str, list[_P]]] = {}
    for file in found:
        formats = known.setdefault((file.parent, _split(file)[0]), {})
        formats.setdefault(file.suffix.lower(), []).append(file)
    taken, left = [], []
    for file in found:
        stem, number = _split(file)
        formats = known[file.parent, stem]
        rather = SUFFIXES[: SUFFIXES.index(file.suffix.lower())]
        better = [one for kind in rather for one in formats.get(kind, ())]
        same = [one for one in better if number < 0 or _split(one)[1] in (number, -1)]
        if same or (better and overlap(file, formats[better[0].suffix.lower()])):
            suffix = (same or better)[0].suffix.lower()
            left.append((file, f"the same recording exists as {suffix}"))
        else:
            taken.append(file)
    return taken, left


def _overlap(file: Path, others: Sequence[Path]) -> bool:
    """Return whether the images of a file are known to overlap in time with those of others."""
    known = signature(file)
    spans = [one.span_ns for one in map(signature, others) if one and one.span_ns]
    if known is None or known.span_ns is None or not spans:
        return False
    first, last = zip(*spans, strict=True)
    return known.span_ns[0] < max(last) and known.span_ns[1] > min(first)


def _within(path: Path, skipped: list[Path]) -> Iterable[Path]:
    """Yield a file, or all files in a folder and its subfolders except :data:`APPLE_DOUBLE`.

    A folder that can't be listed, or whose files can't be accessed, is yielded itself. Links to
    parent folders are not followed but added to ``skipped``.

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
            problem = f"the folder has more than {MAX_FOLDERS} subfolders"
            raise InputError(problem, path=str(path), remedy="pass a smaller folder")
        links = [name for name in folders if os.path.islink(os.path.join(folder, name))]
        up = [name for name in links if own.is_relative_to(Path(folder, name).resolve())]
        skipped += [Path(folder, n) for n in up if Path(folder, n).resolve() != own]
        folders[:] = [name for name in folders if name not in up]
        yield from (Path(folder, name) for name in files if not name.startswith(APPLE_DOUBLE))
    yield from shut


def _split(path: PurePath) -> tuple[str, int]:
    """Return the common name of a recording's splits, and the split number; -1: not a split."""
    match = _SPLIT.fullmatch(path.name)
    return (match["stem"], int(match["number"])) if match else (bare_name(path).stem, -1)


def _series(stem: str) -> str:
    """Return the part of a recording's name that its splits share."""
    return _BEGIN.sub("", stem)


def _order(path: PurePath) -> tuple[str, str, int, str]:
    return (str(path.parent), *_split(path), path.name)


def recording_name(first: PurePath, *, joined: bool) -> str:
    """Return the name of a recording without its folder.

    Args:
        first: First file of the recording.
        joined: Whether the recording has further files.
    """
    stem, number = _split(first)
    return stem if joined and 0 <= number <= 1 else bare_name(first).stem


def listed_recordings(
    files: Iterable[PurePath], listed: Mapping[PurePath, Collection[str]]
) -> tuple[list[list[PurePath]], list[tuple[PurePath, str]]]:
    """Return the recordings among files that can't be read yet, and files left out with the reason.

    Only names are known. If a folder has a recording in several formats, the preferred one is used
    as in local folders, but the times of splits are not compared.

    Args:
        files: All files, in any order.
        listed: Names of the files listed in the ``metadata.yaml`` of each folder that has one.
            Splits that are listed are one recording; all other files are separate recordings.
    """
    found = [path for path in files if _is_recording(path) and not _is_export(path)]
    taken, left = _preferred(found, lambda *_: False)
    return _grouped(taken, lambda path: path.name in listed.get(path.parent, ())), left


def _grouped(files: Iterable[_P], may_join: Callable[[_P], bool]) -> list[list[_P]]:
    """Return files in order, grouped into the splits of a recording, if they may be joined."""
    groups: dict[tuple[PurePath, str, str], list[_P]] = {}
    for path in sorted(files, key=_order):
        stem, number = _split(path)
        name = _series(stem) if number >= 0 and may_join(path) else path.name
        groups.setdefault((path.parent, name, path.suffix), []).append(path)
    return [*groups.values()]
