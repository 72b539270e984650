"""Logs known again: which of a run's logs are those that results hold already."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.errors import ConfigError, printable
from jaxdet.io.files import SUFFIXES, format_of, place_of, recording_of

Fingerprints = Sequence[Mapping[str, Any]]
"""Of a log's files, see :func:`jaxdet.results.manifest.fingerprint`."""
REMEDY = "give another --output, or --overwrite for results of these logs alone"


class LogIdentity(NamedTuple):
    """What a log is known by, one of a run or of results."""

    name: str
    places: tuple[str, ...]
    """Of its files, as :func:`places_of` has them."""
    files: Fingerprints
    has_rows: bool = True
    """Of one in results; else it failed."""


class Matches(NamedTuple):
    """What a run's logs are in results, by their names in the run."""

    names: dict[str, str]
    """The names there of those that are known again."""
    parts: dict[str, str]
    """Likewise of those that are some files of a log there, and no others, unchanged."""
    replaced: set[str]
    """Logs there whose files are of other logs now."""


def match_logs(given: Collection[LogIdentity], known: Collection[LogIdentity]) -> Matches:
    """Knows logs again: by the places of their files, else by what is in them.

    A known log whose files are in several of the run's logs, or in one that has those of other
    known ones too, is replaced by them; so is one whose every file the run has at its place in
    another format.

    Args:
        given: A run's logs.
        known: The logs of the results.

    Raises:
        ConfigError: A log has some files of a known one, changed, with others or in another
            format: without the rest rows would be lost.
    """
    at = {place: log.name for log in known for place in log.places}
    held = {log.name: {at[one]: None for one in log.places if one in at} for log in given}
    matches = _by_place(given, {log.name: log for log in known}, held)
    new = [log for log in given if not held[log.name]]
    met = {name for names in held.values() for name in names}
    others = [log for log in known if log.name not in met]
    matches.replaced.update(_in_other_formats(new, others))
    others = [log for log in others if log.name not in matches.replaced]
    matches.names.update(by_content(new, others))
    return matches


def places_of(paths: Iterable[Path]) -> tuple[str, ...]:
    """Where files are, however they are named; of those that results tell of as well."""
    return tuple(printable(str(place_of(path))) for path in paths)


def contents_of(files: Fingerprints, *more: str) -> tuple[tuple[Any, ...], ...]:
    """What files hold, by their fingerprints; nothing where one can't be read.

    Args:
        files: The files.
        more: What else counts of them.
    """
    which = ("size", "fingerprint", *more)
    found = tuple(tuple(file.get(name) for name in which) for file in files)
    return () if any(None in one for one in found) else found


def _by_place(
    given: Collection[LogIdentity],
    known: Mapping[str, LogIdentity],
    held: Mapping[str, Collection[str]],
) -> Matches:
    """The logs that share files with known ones; ``held`` has these by the logs' names."""
    matches = Matches({}, {}, set())
    there = {place for log in given for place in log.places}
    holders = Counter(name for names in held.values() for name in names)
    for log in given:
        ours = [known[name] for name in held[log.name]]
        rest = [one for one in ours if one.has_rows and not there.issuperset(one.places)]
        if rest and not _is_part(log, rest[0]):
            place = next(place for place in rest[0].places if place not in there)
            problem = f"is not among the logs now, but others of the log {rest[0].name} are"
            raise ConfigError(problem, path=place, remedy=f"name it as well, {REMEDY}")
        if rest:
            matches.parts[log.name] = rest[0].name
        elif len(ours) == 1 and holders[ours[0].name] == 1:
            matches.names[log.name] = ours[0].name
        else:
            matches.replaced.update(one.name for one in ours)
    return matches


def _is_part(log: LogIdentity, known: LogIdentity) -> bool:
    """Whether a log's files are some of those of a known one, as they were or can't be read."""
    was = dict(zip(known.places, known.files, strict=True))

    def same(place: str, now: Mapping[str, Any]) -> bool:
        found = contents_of([now], "mtime_ns")
        return place in was and found in ((), contents_of([was[place]], "mtime_ns"))

    return all(map(same, log.places, log.files))


def _in_other_formats(given: Collection[LogIdentity], known: Collection[LogIdentity]) -> set[str]:
    """Known logs whose recordings are given in another format."""
    paths = [path for log in given for path in _recordings(log)]
    formats: dict[Any, set[str]] = {}
    for path in paths:
        formats.setdefault(recording_of(path), set()).add(format_of(path))
    bare = {path.with_suffix("") for path in paths}
    found = set()
    for log in known:
        own = _recordings(log)
        if not any(formats.get(recording_of(path), set()) - {format_of(path)} for path in own):
            continue
        left = [path for path in own if path.with_suffix("") not in bare]
        if left and log.has_rows:
            problem = f"the recording of the log {log.name} is given in another format, but this "
            problem += "file of it is not"
            raise ConfigError(problem, path=str(left[0]), remedy=f"convert it as well, {REMEDY}")
        found.add(log.name)
    return found


def _recordings(log: LogIdentity) -> list[Path]:
    """A log's files; none of one that is a folder of images."""
    return [path for path in map(Path, log.places) if format_of(path) in SUFFIXES]


def by_content(given: Collection[LogIdentity], known: Collection[LogIdentity]) -> dict[str, str]:
    """Logs that were moved or copied are each a known one, of the same name where there is one.

    Args:
        given: The logs.
        known: Each is at most one of them.

    Returns:
        By the names of those that are known their names there.
    """
    unmet: dict[Any, list[str]] = {}
    for one in known:
        unmet.setdefault(contents_of(one.files), []).append(one.name)
    unmet.pop((), None)  # of files that could not be read nothing is known
    contents = {log.name: contents_of(log.files) for log in given}
    found = {name: name for name, what in contents.items() if name in unmet.get(what, ())}
    for name in found:
        unmet[contents[name]].remove(name)
    for name, what in contents.items():
        if name not in found and unmet.get(what):
            found[name] = unmet[what].pop(0)
    return found
