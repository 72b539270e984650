"""Logs known again: which of a run's logs are those that results hold already."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

from jaxdet.errors import ConfigError, printable
from jaxdet.io.files import SUFFIXES, LogFiles

Fingerprints = Sequence[Mapping[str, Any]]
"""Of a log's files, see :func:`jaxdet.results.manifest.fingerprint`."""
REMEDY = "give another --output, or --overwrite for results of these logs alone"


class KnownLog(NamedTuple):
    """A log of results."""

    name: str
    places: tuple[str, ...]
    """Of its files, as :func:`places_of` has them."""
    files: Fingerprints
    has_rows: bool


class Matches(NamedTuple):
    """What a run's logs are in results, by their names in the run."""

    names: dict[str, str]
    """The names there of those that are known again."""
    parts: dict[str, str]
    """Likewise of those that are some files of a log there, and no others, unchanged."""
    replaced: set[str]
    """Logs there whose files are of other logs now."""


def match_logs(
    given: Sequence[LogFiles], files: Mapping[str, Fingerprints], known: Collection[KnownLog]
) -> Matches:
    """Knows logs again: by the places of their files, else by what is in them.

    A known log whose files are in several of the run's logs, or in one that has those of other
    known ones too, is replaced by them; so is one of a recording that the run has from the same
    place in another format.

    Args:
        given: A run's logs.
        files: Theirs, by the logs' names.
        known: The logs of the results.

    Raises:
        ConfigError: A log has some files of a known one, changed or with others: without the rest
            rows would be lost.
    """
    at = {place: log.name for log in known for place in log.places}
    held = {log.name: {at[place]: None for place in places_of(log) if place in at} for log in given}
    matches = _by_place(given, files, {log.name: log for log in known}, held)
    new = [log for log in given if not held[log.name]]
    met = {name for names in held.values() for name in names}
    here = {bare for log in new for bare in _bare(places_of(log))}
    others = [log for log in known if log.name not in met]
    again = {log.name for log in others if not here.isdisjoint(_bare(log.places))}
    matches.replaced.update(again)
    others = [log for log in others if log.name not in again]
    matches.names.update(_by_content(new, files, others))
    return matches


def places_of(log: LogFiles) -> tuple[str, ...]:
    """Where a log's files are, as results tell it."""
    return tuple(printable(str(path.absolute())) for path in log.paths)


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
    given: Sequence[LogFiles],
    files: Mapping[str, Fingerprints],
    known: Mapping[str, KnownLog],
    held: Mapping[str, Collection[str]],
) -> Matches:
    """The logs that share files with known ones; ``held`` has these by the logs' names."""
    matches = Matches({}, {}, set())
    there = {place for log in given for place in places_of(log)}
    holders = Counter(name for names in held.values() for name in names)
    for log in given:
        ours = [known[name] for name in held[log.name]]
        rest = [one for one in ours if one.has_rows and not there.issuperset(one.places)]
        if rest and not _is_part(log, files[log.name], rest[0]):
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


def _is_part(log: LogFiles, files: Fingerprints, known: KnownLog) -> bool:
    """Whether a log's files are some of those of a known one, as they were or can't be read."""
    was = dict(zip(known.places, known.files, strict=True))

    def same(place: str, now: Mapping[str, Any]) -> bool:
        found = contents_of([now], "mtime_ns")
        return place in was and found in ((), contents_of([was[place]], "mtime_ns"))

    return all(map(same, places_of(log), files))


def _bare(places: Iterable[str]) -> set[str]:
    """Places of files without what tells formats of recordings apart."""
    paths = map(PurePath, places)
    return {str(path.with_suffix("")) for path in paths if path.suffix.lower() in SUFFIXES}


def _by_content(
    given: Sequence[LogFiles], files: Mapping[str, Fingerprints], known: Collection[KnownLog]
) -> dict[str, str]:
    """Logs that were moved or copied are each a known one, of the same name where there is one."""
    unmet: dict[Any, list[str]] = {}
    for one in known:
        unmet.setdefault(contents_of(one.files), []).append(one.name)
    unmet.pop((), None)  # of files that could not be read nothing is known
    contents = {log.name: contents_of(files[log.name]) for log in given}
    found = {name: name for name, what in contents.items() if name in unmet.get(what, ())}
    for name in found:
        unmet[contents[name]].remove(name)
    for name, what in contents.items():
        if name not in found and unmet.get(what):
            found[name] = unmet[what].pop(0)
    return found
