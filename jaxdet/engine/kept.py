"""Results that a run brings up to date: which of their logs stay, with rows, pictures and maps."""

import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from jaxdet.engine.record import difference_but_logs, digest, record_of_results
from jaxdet.errors import ConfigError, InputError, OutputError, printable
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

_REMEDY = "give another --output, or --overwrite to do all logs again"


class KeptLogs:
    """The logs of whole results that stay as they are when a run adds others to them.

    A log stays if it is not among the run's, or is the same to the checksum and the time of its
    last change, and neither failed nor lost frames. One that failed and whose files are gone is
    left out: it has no rows, and nothing could mend it.

    Args:
        folder: The results.
        logs: Those of the run.
        record: What decides the run's results, see :func:`jaxdet.engine.record.make_record`.

    Raises:
        ConfigError: The results are of another configuration or version; or files of a log would
            have other names.
        InputError: They can't be read, or a file of them is not as it was written.
    """

    def __init__(self, folder: Path, logs: Sequence[LogFiles], record: Mapping[str, Any]) -> None:
        self.folder = folder
        self._manifest = read_manifest(folder)
        self._results = Results(folder)
        try:
            self._entries: dict[str, list[dict[str, Any]]] = {}
            for entry in self._results.summary["logs"]:
                self._entries.setdefault(entry["log"], []).append(entry)
            self._check_record(record)
            self._decide(logs, record)
            self._check_files()
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
        try:
            for rows in self._rows(log.name):
                writer.add(rows)
        except MemoryError as error:
            how = {"path": log.name, "remedy": "end other programs"}
            raise OutputError("no memory for its rows", **how) from error
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
        names = [name for entry in self._entries[log.name] for name in _files_of(entry)]
        for path in (folder / name for name in names):
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                _link(self.folder / path.relative_to(folder), path)
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
        names = self._names(given, now)
        named = {names[log.name]: log._replace(name=names[log.name]) for log in given}
        now = {names[name]: files for name, files in now.items()}
        left = {name: self._recorded(name) for name in told.keys() - named.keys()}
        left = {name: log for name, log in left.items() if not self._failed_and_gone(log)}
        same = {
            name
            for name in told.keys() & named.keys()
            if _contents(told[name], "mtime_ns") == (_contents(now[name], "mtime_ns") or None)
            and not any(entry["error"] or entry["lost"] for entry in self._entries[name])
        }
        self.names = frozenset({*left, *same})
        self.logs = [log for _, log in sorted({**left, **named}.items())]
        inputs = {log.name: {**told, **now}[log.name] for log in self.logs}
        self.record = {**record, "about": {**record["about"], "inputs": inputs}}
        for log, name in zip(self.logs, file_names(log.name for log in self.logs), strict=True):
            files = (entry["file_name"] or name for entry in self._entries.get(log.name, ()))
            if log.name in self.names and any(file.partition("@")[0] != name for file in files):
                self._refuse(f"files of the log {log.name} would be called {name}")

    def _failed_and_gone(self, log: LogFiles) -> bool:
        failed = all(entry["error"] for entry in self._entries[log.name])
        return failed and not any(path.exists() for path in log.paths)

    def _recorded(self, name: str) -> LogFiles:
        """A log as the results tell of it."""
        return LogFiles(name, tuple(map(Path, self._entries[name][0]["paths"])))

    def _names(
        self, logs: Sequence[LogFiles], inputs: Mapping[str, Sequence[Mapping[str, Any]]]
    ) -> dict[str, str]:
        """What the run's logs are called in the results, by their names in the run.

        They are known again by their place, else by what is in them, and keep the name that they
        have there. New ones whose name is taken get as many folders put before it as it takes.
        """
        told = self._manifest["inputs"]
        places = {path: name for name in told for path in self._recorded(name).paths}
        contents = {_key(_contents(files)): name for name, files in told.items()}
        found = {
            log.name: places[log.paths[0].absolute()]
            for log in logs
            if log.paths[0].absolute() in places
        }
        for log in logs:
            known = contents.get(_key(_contents(inputs[log.name]) or [["unread"]]))
            if log.name not in found and known and known not in found.values():
                found[log.name] = known
        taken = {*told, *found.values()}
        for log in logs:
            if log.name not in found:
                found[log.name] = _free_name(log, taken)
                taken.add(found[log.name])
        return found

    def _refuse(self, reason: str) -> NoReturn:
        problem = f"holds results that can't be brought up to date: {reason}"
        raise ConfigError(problem, path=str(self.folder), remedy=_REMEDY)

    def _check_files(self) -> None:
        """Makes sure that what stays is as it was written.

        Raises:
            InputError: It isn't.
        """
        for name, about in self._manifest["files"].items():
            path = self.folder / name
            if not path.is_file() or sha256(path) != about["sha256"]:
                problem, remedy = "is not as it was written", f"see jaxdet verify; or {_REMEDY}"
                raise InputError(problem, path=str(path), remedy=remedy)


def _contents(files: Sequence[Mapping[str, Any]], *more: str) -> list[list[Any]]:
    """What files hold, by their fingerprints; nothing where one can't be read."""
    found = [[file.get(key) for key in ("size", "fingerprint", *more)] for file in files]
    return [] if any(None in one for one in found) else found


def _key(contents: list[list[Any]]) -> tuple[tuple[Any, ...], ...]:
    return tuple(map(tuple, contents))


def _free_name(log: LogFiles, taken: Collection[str]) -> str:
    """A name for a log that no other has."""
    folders, name = log.paths[0].absolute().parent.parts[1:], log.name
    own = name.rpartition("/")[2]
    for depth in range(1, len(folders) + 1):
        if name not in taken:
            break
        name = printable("/".join([*folders[-depth:], own]))
    number = 2
    while name in taken:
        name, number = f"{log.name} ({number})", number + 1
    return name


def _files_of(entry: Mapping[str, Any]) -> list[str]:
    """The names of a log's pictures and map."""
    maps = [f"{entry['map']}.{end}" for end in ("npz", "png")] if entry["map"] else []
    return [*entry["pictures"], *maps]


def _link(path: Path, link: Path) -> None:
    try:
        link.hardlink_to(path)
    except OSError:
        shutil.copy2(path, link)
