"""Grouping of numbered files into recordings.

rosbag2 names the files of a recording ``NAME_0.mcap``, ``NAME_1.mcap``, ...; so do people who
number their recordings. ROS 1 adds the time at which each file begins,
``NAME_2024-05-01-10-00-00_0.bag``. Files listed in a ``metadata.yaml`` next to them are one
recording. Other files are joined only if they certainly belong together: their numbers are
consecutive, they have the same topics, schemas and calibration, and the images of each begin within
about a second of the end of the previous ones, without overlap.
"""

import re
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from jaxdet.errors import InputError
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.contents import ContentsBuilder, LogContents
from jaxdet.io.file_index import FileIndex
from jaxdet.io.formats import open_file
from jaxdet.io.indexed import search_index
from jaxdet.io.messages import IMAGE_KINDS, kind_of
from jaxdet.io.options import LogOptions
from jaxdet.io.validity import values_of

_MAX_OVERLAP_NS = 100_000_000
"""Maximum overlap in time of two splits' images [ns], as a recorder has several queues."""
_MAX_GAP_NS = 1_000_000_000
"""Maximum pause between the images of two splits [ns], or two image periods if that is longer."""
METADATA = "metadata.yaml"
"""File in which rosbag2 lists the files of a recording."""
_LISTED = re.compile(r"^[ \t]*relative_file_paths:[ \t]*\n((?:[ \t]*-[^\n]*\n?)+)", re.MULTILINE)
_ITEM = re.compile(r"""^[ \t]*-[ \t]*(["']?)(.+?)\1\s*(?:[ \t]#.*)?$""", re.MULTILINE)
_MOST_BYTES = 1 << 20


class Signature(NamedTuple):
    """Properties of a file by which its recording is recognised."""

    schemas: dict[str, str]
    """Schemas of the useful topics."""
    images: frozenset[str]
    """Image topics with messages."""
    span_ns: tuple[int, int] | None
    """Log times of the first and the last image [ns]; None without images."""
    calibrations: dict[str, tuple[object, ...] | None]
    """Calibrations by topic, see :func:`jaxdet.io.validity.values_of`."""
    period_ns: int = 0
    """Mean interval of the images on the slowest topic [ns]; 0 if there are too few."""


def signature(path: Path) -> Signature | None:
    """Return the signature of a file; None if the file can't be read.

    The file is scanned if its index, or a chunk that the index names, is damaged.
    """
    most = LogOptions.max_chunk_mib << 20
    with suppress(InputError, DamageError), closing(open_file(path, most)) as file:
        return file.by_index(partial(_signature_of, file))
    return None


def _signature_of(file: LogFile, entries: FileIndex) -> Signature:
    counts = entries.counts
    useful = {key: info for key, info in entries.infos.items() if kind_of(info.schema_name)}
    images = [key for key, info in useful.items() if kind_of(info.schema_name) in IMAGE_KINDS]
    seen = [key for key in images if key in counts]
    spans = [(counts[key].first_ns, counts[key].last_ns) for key in seen]
    several = [counts[key] for key in seen if counts[key].messages > 1]
    periods = [(one.last_ns - one.first_ns) // (one.messages - 1) for one in several]
    builder = ContentsBuilder(LogContents(str(file.path)), use_tf=False, images=False)
    search_index(file, entries, builder)
    known = builder.contents.calibrations.items()
    return Signature(
        {info.topic: info.schema_name for info in useful.values()},
        frozenset(useful[key].topic for key in seen),
        (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None,
        {topic: values_of(item.first) for topic, item in known if item.first},
        max(periods, default=0),
    )


def _other_kind(first: Signature, second: Signature) -> str:
    for topic in sorted(first.schemas.keys() & second.schemas.keys()):
        if first.schemas[topic] != second.schemas[topic]:
            return f"{topic} has another schema"
    for topic in sorted(first.calibrations.keys() & second.calibrations.keys()):
        values = first.calibrations[topic], second.calibrations[topic]
        if None not in values and values[0] != values[1]:
            return f"{topic} has another calibration"
    if first.images and second.images and not first.images & second.images:
        return "they have no image topic in common"
    return ""


def _joined(first: Signature | None, second: Signature | None) -> Signature | None:
    """Return the signature of a recording after adding the file ``second``."""
    if first is None or second is None:
        return second or first
    schemas, calibrations = first.schemas | second.schemas, first.calibrations | second.calibrations
    span, period = second.span_ns or first.span_ns, max(first.period_ns, second.period_ns)
    return Signature(schemas, second.images, span, calibrations, period)


class Recording(NamedTuple):
    """Files of one recording."""

    paths: tuple[Path, ...]
    note: str
    """Files that were joined and why, or why neighbouring files are another recording."""


def recordings(files: Sequence[tuple[int, Path]]) -> list[Recording]:
    """Group numbered files with the same name and folder into recordings, in order.

    Args:
        files: Files with their numbers; at least one.
    """
    names = listed_files(files[0][1].parent)
    listed = [path for _, path in files if path.name in names]
    if len(listed) > 1:
        note = f"joined {len(listed)} files listed in {METADATA}"
        rest = [one for one in files if one[1] not in listed]
        return [Recording(tuple(listed), note), *(recordings(rest) if rest else ())]
    found: list[list[Path]] = []
    notes: list[list[str]] = []
    before: tuple[int, Signature | None] = (0, None)
    for number, path in files:
        now = signature(path)
        why = _why_apart(*before, number, now) if found else ""
        if why or not found:
            found.append([])
            notes.append([])
        if why:
            names = f"{found[-2][-1].name} and {path.name}"
            for about in notes[-2:]:
                about.append(f"{names} are different recordings: {why}")
        found[-1].append(path)
        before = number, _joined(None if why else before[1], now)
    for paths, about in zip(found, notes, strict=True):
        if len(paths) > 1:
            text = f"joined {len(paths)} files, {paths[0].name} to {paths[-1].name}"
            text += ", whose topics and times are consecutive"
            about.insert(0, f"{text}; --no-join keeps them separate")
    return [
        Recording(tuple(one), "; ".join(about)) for one, about in zip(found, notes, strict=True)
    ]


def recording_around(files: Sequence[tuple[int, Path]], place: int) -> list[Path]:
    """Return the recording that contains the file at ``place``; only neighbours are read.

    Args:
        files: Files of one name and folder with their numbers, in order.
        place: Index of the file.
    """
    number, path = files[place]
    names = listed_files(path.parent)
    if path.name in names:
        return [path for _, path in files if path.name in names]
    found, own = [path], signature(path)
    for is_later, others in ((False, files[:place][::-1]), (True, files[place + 1 :])):
        near, known = number, own
        for other, path in others:
            there = signature(path)
            pair = (near, known, other, there) if is_later else (other, there, near, known)
            if _why_apart(*pair):
                break
            found.insert(len(found) if is_later else 0, path)
            near, known = other, _joined(known, there)
    return found


def _why_apart(first: int, before: Signature | None, second: int, now: Signature | None) -> str:
    """Return why a file is not the continuation of the recording before it; empty if it is."""
    if second != first + 1:
        return "their numbers are not consecutive"
    if before is None or now is None or not (before.span_ns and now.span_ns):
        return "their indexes don't have the times of the images"
    if why := _other_kind(before, now):
        return why
    pause_ns = now.span_ns[0] - before.span_ns[1]
    if pause_ns < -_MAX_OVERLAP_NS or now.span_ns[0] <= before.span_ns[0]:
        return "their images overlap in time or are in the wrong order"
    if pause_ns > max(_MAX_GAP_NS, 2 * max(before.period_ns, now.period_ns)):
        return f"they are {pause_ns / 1e9:.1f} s apart"
    return ""


def listed_files(folder: Path) -> frozenset[str]:
    """Return the names of the files listed in the ``metadata.yaml`` of a folder."""
    try:
        with (folder / METADATA).open("rb") as file:
            return listed_in(file.read(_MOST_BYTES))
    except OSError:
        return frozenset()


def listed_in(metadata: bytes) -> frozenset[str]:
    """Return the names of the files listed in the content of a ``metadata.yaml``."""
    match = _LISTED.search(metadata.decode(errors="replace").replace("\r\n", "\n"))
    names = _ITEM.findall(match[1]) if match else []
    return frozenset(PurePosixPath(name.strip()).name for _, name in names)
