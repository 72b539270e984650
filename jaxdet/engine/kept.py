"""Results that a run brings up to date: which of their logs stay, with rows, pictures and maps."""

import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from jaxdet.engine.join import add_rows
from jaxdet.engine.known import (
    REMEDY,
    Fingerprints,
    LogIdentity,
    Matches,
    contents_of,
    match_logs,
    places_of,
)
from jaxdet.engine.record import difference_but_logs, digest, record_of_results
from jaxdet.errors import ConfigError, InputError, JaxdetError, printable
from jaxdet.io.files import LogFiles
from jaxdet.results.arrow import with_schema
from jaxdet.results.durable import sha256, writing
from jaxdet.results.manifest import read_manifest
from jaxdet.results.names import file_names
from jaxdet.results.reading import Results
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.summary import LogSummary
from jaxdet.results.writer import Tables

if TYPE_CHECKING:
    from jaxdet.results.writer import ResultWriter


class KeptLogs:
    """The logs of whole results that stay as they are when a run adds others to them.

    A log stays if it is not among the run's (:mod:`jaxdet.engine.known`), or is the same to the
    checksum and the time of its last change, or can't be read now, and neither failed nor lost
    frames. One that failed and whose files are gone is left out: it has no rows, and nothing could
    mend it. So is a folder that could not be listed, when logs in it are given.

    Args:
        folder: The results.
        logs: Those of the run.
        record: What decides the run's results, see :func:`jaxdet.engine.record.make_record`.

    Raises:
        ConfigError: The results are of another configuration or version; files of a log would have
            other names; or a log lacks files that it had.
        InputError: They can't be read, or a file of them is not as it was written.
    """

    def __init__(self, folder: Path, logs: Sequence[LogFiles], record: Mapping[str, Any]) -> None:
        self.folder = folder
        self.notes: list[str] = []
        """What is to be said of logs that stay."""
        self._names: dict[str, str] = {}
        """What files of the logs are called, by the logs' names."""
        self._manifest, self._results = self._read()
        try:
            self._entries: dict[str, list[dict[str, Any]]] = {}
            for entry in self._results.summary["logs"]:
                self._entries.setdefault(entry["log"], []).append(entry)
            self._check_record(record)
            self._decide(logs, record)
        except BaseException:
            self.close()
            raise

    logs: list[LogFiles]
    """All logs of the new results, in order, those of the old ones with their names there."""
    record: Mapping[str, Any]
    """What decides these."""
    names: frozenset[str]
    """Of the logs that stay."""

    @property
    def all_stay(self) -> bool:
        """Whether the results hold all of the run's logs already."""
        same = self._manifest.get("run") == digest(self.record)
        return same and len(self.names) == len(self.logs)

    @property
    def batch_size(self) -> int:
        """How many frames were computed together."""
        return self._results.summary["batch_size"]

    def close(self) -> None:
        """Closes the tables."""
        self._results.close()

    def take(self, log: LogFiles, writer: "ResultWriter") -> list[LogSummary]:
        """Adds the rows of a log to the new tables.

        Returns:
            The summaries of its cameras.

        Raises:
            InputError: The old tables can't be read.
            OutputError: The disk is full or broken, or there is no memory for the rows.
        """
        add_rows(writer, self._rows(log.name), log.name)
        where = {"paths": tuple(str(path.absolute()) for path in log.paths)}
        return [LogSummary.from_dict(entry | where) for entry in self._entries[log.name]]

    def link_files(self, log: LogFiles, folder: Path) -> dict[str, Path]:
        """Makes links to the pictures and the maps of a log, by their names in the results.

        Args:
            log: The log.
            folder: Gets them; copies where its file system has no links.

        Raises:
            OutputError: The disk is full or broken.
        """
        entries = self._entries[log.name]
        return self._link([name for entry in entries for name in self._files_of(entry)], folder)

    def link_tracks(self, tables: Mapping[str, Path], folder: Path) -> dict[str, Path]:
        """Makes links to the tracks, where tables of the new results are those that they are of.

        Args:
            tables: The new ones, by their names in the results.
            folder: As of :meth:`link_files`.

        Raises:
            OutputError: The disk is full or broken.
        """
        files = self._manifest["files"]
        tracks = [name for name in files if name.startswith("track")]
        if tracks and all(sha256(path) == files[name]["sha256"] for name, path in tables.items()):
            return self._link(tracks, folder)
        return {}

    def _link(self, names: Sequence[str], folder: Path) -> dict[str, Path]:
        for path in (folder / name for name in names):
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                _link_file(self.folder / path.relative_to(folder), path)
        return {name: folder / name for name in names}

    def _rows(self, name: str) -> Iterator[Tables]:
        for log in self._results.logs:
            if log.name == name:
                for chunk in self._results.chunks(log, obstacles=OBSTACLES_SCHEMA.names):
                    frames = with_schema(chunk.frames, FRAMES_SCHEMA)
                    yield Tables(frames, with_schema(chunk.obstacles, OBSTACLES_SCHEMA))

    def _check_record(self, record: Mapping[str, Any]) -> None:
        """Makes sure that all but the logs is as it was."""
        before = record_of_results(self.folder, record)
        reason = "they are of another version"
        if before is not None:
            reason = difference_but_logs(before, record)
        if reason:
            self._refuse(reason)

    def _decide(self, given: Sequence[LogFiles], record: Mapping[str, Any]) -> None:
        """Which logs stay, and what all of them are then."""
        told, now = self._manifest["inputs"], record["about"]["inputs"]
        ours = {name: self._known(name) for name in told}
        theirs = [LogIdentity(log.name, places_of(log.paths), now[log.name]) for log in given]
        matches = match_logs(theirs, ours.values())
        names = self._name(given, matches)
        left = {*told} - matches.replaced - {*names.values()}
        there = {place for log in theirs for place in log.places}
        stay = {name for name in left if not _failed_and_gone(ours[name], there)}
        logs = {name: self._recorded(name) for name in stay}
        files: dict[str, Fingerprints] = {name: told[name] for name in stay}
        for log, about in zip(given, theirs, strict=True):
            if log.name in matches.parts:
                continue
            name = names[log.name]
            logs[name], files[name] = log._replace(name=name), about.files
            if log.name in matches.names and self._stays(ours[name], about):
                stay.add(name)
                if about.places == ours[name].places or not contents_of(about.files):
                    logs[name], files[name] = self._recorded(name), told[name]
        self.names = frozenset(stay)
        self.logs = [logs[name] for name in sorted(logs)]
        inputs = {log.name: files[log.name] for log in self.logs}
        self.record = {**record, "about": {**record["about"], "inputs": inputs}}
        self._names = file_names(inputs)
        for name in sorted(stay):
            own = (entry["file_name"] or self._names[name] for entry in self._entries[name])
            if any(file.partition("@")[0] != self._names[name] for file in own):
                self._refuse(f"files of the log {name} would be called {self._names[name]}")

    def _name(self, given: Sequence[LogFiles], matches: Matches) -> dict[str, str]:
        """What the run's logs are called in the results, but those that are parts of one there.

        What is known again keeps its name. New ones whose name is taken get as many folders put
        before it as it takes.
        """
        names = {**matches.names}
        taken = {*self._entries} - matches.replaced
        for log in given:
            if log.name not in names and log.name not in matches.parts:
                names[log.name] = _free_name(log, taken)
                taken.add(names[log.name])
        return names

    def _stays(self, known: LogIdentity, log: LogIdentity) -> bool:
        """Whether a log that is known again need not be done again."""
        if any(entry["error"] or entry["lost"] for entry in self._entries[known.name]):
            return False
        if contents_of(log.files):
            return contents_of(log.files, "mtime_ns") == contents_of(known.files, "mtime_ns")
        each = zip(log.places, log.files, strict=True)
        place = next(place for place, file in each if not contents_of([file]))
        self.notes.append(f"{place} can't be read; its results stay as they are")
        return True

    def _recorded(self, name: str) -> LogFiles:
        """A log as the results tell of it."""
        return LogFiles(name, tuple(map(Path, self._entries[name][0]["paths"])))

    def _known(self, name: str) -> LogIdentity:
        has_rows = not all(entry["error"] for entry in self._entries[name])
        places = places_of(self._recorded(name).paths)
        return LogIdentity(name, places, self._manifest["inputs"][name], has_rows)

    def _files_of(self, entry: Mapping[str, Any]) -> list[str]:
        """The names of a log's pictures, its map and the report of what made it fail."""
        maps = [f"{entry['map']}.{end}" for end in ("npz", "png")] if entry["map"] else []
        report = f"report_{entry['file_name'] or self._names[entry['log']]}.txt"
        reports = [report] if report in self._manifest["files"] else []
        return [*entry["pictures"], *maps, *reports]

    def _refuse(self, reason: str) -> NoReturn:
        problem = f"holds results that can't be brought up to date: {reason}"
        raise ConfigError(problem, path=str(self.folder), remedy=REMEDY)

    def _read(self) -> tuple[dict[str, Any], Results]:
        """The manifest, and the tables.

        Raises:
            InputError: One can't be read, or a file of theirs is not as it was written.
        """
        remedy = f"see jaxdet verify; or {REMEDY}"
        try:
            manifest = read_manifest(self.folder)
            for name, about in manifest["files"].items():
                path = self.folder / name
                if not path.is_file() or sha256(path) != about["sha256"]:
                    raise InputError("is not as it was written", path=str(path))
            return manifest, Results(self.folder)
        except JaxdetError as error:
            raise InputError(error.problem, path=error.path, remedy=remedy) from error


def _failed_and_gone(known: LogIdentity, given: Collection[str]) -> bool:
    """Whether a log has no rows, and its files are gone, or logs in the folder that it was."""
    if known.has_rows:
        return False
    if any(one.startswith(f"{place}/") for place in known.places for one in given):
        return True
    escaped = any("\\" in place for place in known.places)  # where these are can't be told
    return not escaped and not any(Path(place).exists() for place in known.places)


def _free_name(log: LogFiles, taken: Collection[str]) -> str:
    """A name for a log that no other has."""
    folders, name = log.paths[0].parent.resolve().parts[1:], log.name
    own = name.rpartition("/")[2]
    for depth in range(1, len(folders) + 1):
        if name not in taken:
            break
        name = printable("/".join([*folders[-depth:], own]))
    number = 2
    while name in taken:
        name, number = f"{log.name} ({number})", number + 1
    return name


def _link_file(path: Path, link: Path) -> None:
    try:
        link.hardlink_to(path)
    except OSError:
        shutil.copy2(path, link)
