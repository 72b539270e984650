"""The output folder of a run: which logs are done, and where others are made."""

import logging
import os
import secrets
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from jaxdet.errors import ConfigError, InputError, ResultsError
from jaxdet.results.durable import write_whole, writing
from jaxdet.results.layout import (
    FAILED,
    FRAMES,
    MANIFEST,
    RUN,
    SUMMARY,
    WORKING,
    entries_of,
    is_complete,
    log_folders,
    read_json,
)
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import fingerprint, read_manifest, same_inputs
from jaxdet.results.names import log_name
from jaxdet.results.publish import finish, publish, remove
from jaxdet.results.record import difference, digest
from jaxdet.results.summary import LogSummary, to_json
from jaxdet.signals import stops_held_back

if TYPE_CHECKING:
    from jaxdet.engine.options import RunOptions
    from jaxdet.io import LogFiles

LOGGER = logging.getLogger("jaxdet")


class OutputFolder:
    """An output folder that this run has locked; a context manager that unlocks it.

    Args:
        output: The folder; made when missing.
        record: Configuration and versions, see :func:`jaxdet.results.record.make_record`.
        options: ``overwrite`` and ``update`` are looked at.

    Attributes:
        staging: Folder for logs that are being made.
        taken_over: Whether the run before this one ended without releasing its lock.

    Raises:
        ConfigError: Another run works there, or it is a file.
        InputError: The folder can't be written to, or holds another user's unfinished run.
    """

    def __init__(self, output: Path, record: Mapping[str, Any], options: "RunOptions") -> None:
        self.output, self.record, self.options = output, record, options
        self.run = digest(record)
        self._working = output.absolute() / WORKING
        self.staging = self._working / f"logs-{secrets.token_hex(4)}"
        if output.exists() and not output.is_dir():
            raise ConfigError("is a file", path=str(output), remedy="give --output a folder")
        self._lock = Lock(self._working / "lock")
        self.taken_over = self._lock.before is not None
        try:
            if self._lock.before:
                before = self._lock.before
                LOGGER.warning("taken over from a run that ended without a word (%s)", before)
            finish(output)
            self._clear()
        except BaseException:
            self._leave()
            raise

    def __enter__(self) -> "OutputFolder":
        return self

    def __exit__(self, *_: object) -> None:
        self._leave()

    def begin(self, logs: Sequence["LogFiles"]) -> dict[str, list[LogSummary]]:
        """Make sure that logs can be added, and find those that need not be done.

        Args:
            logs: Those of the run.

        Returns:
            Summaries of the cameras of logs that are there, by their names.

        Raises:
            ResultsError: There are results of another configuration or version, or of a log that
                has changed since.
            ConfigError: Something else is where a log's folder would be, or two logs would have
                the same one.
            InputError: Results can't be read.
        """
        names = self._names(logs)
        self._check_run(set(names.values()))
        found = {}
        for log in logs:
            about = self._standing(log, self.output / names[log.name])
            if about is not None:
                found[log.name] = about
        with writing(self.output):
            self.staging.mkdir()
            self._write_record()
        return found

    def _write_record(self) -> None:
        """Write ``run.json``, where it is not there."""
        place = self.output / RUN
        if not place.exists() or self._reason(place):
            write_whole(self.staging / RUN, to_json(dict(self.record)).encode())
            os.replace(self.staging / RUN, place)

    def staged(self, log: str) -> Path:
        """Return the new folder in which the results of a log are made."""
        return self.staging / log_name(log)

    def publish(self, log: str) -> None:
        """Make the folder of :meth:`staged` the log's.

        One without results takes no place of one with results, which stay as they are.

        Raises:
            OutputError: The disk is full or broken.
        """
        staged, name = self.staged(log), log_name(log)
        if is_complete(staged) or not is_complete(self.output / name):
            self._count_attempts(staged, self.output / name)
            publish(staged, self.output, name)
        else:
            remove(staged)

    def _names(self, logs: Sequence["LogFiles"]) -> dict[str, str]:
        """Return the names of the logs' folders."""
        found: dict[str, LogFiles] = {}
        for log in logs:
            name = log_name(log.name)
            if name in found:
                problem = f"has the name of {found[name].paths[0]}: {log.name}"
                remedy = (
                    "name the folder that both are in, and they have names by their paths in it"
                )
                raise ConfigError(problem, path=str(log.paths[0]), remedy=remedy)
            found[name] = log
        return {log.name: name for name, log in found.items()}

    def _check_run(self, names: set[str]) -> None:
        """Make sure that the results that are there are of this configuration and version."""
        if is_complete(self.output) or (self.output / FRAMES).exists():
            problem = "holds results of an older version, or of one log"
            raise ConfigError(problem, path=str(self.output), remedy="give another --output")
        if not (self.output / RUN).exists():
            return
        reason = self._reason(self.output / RUN)
        others = [name for name, path in log_folders(self.output).items() if is_complete(path)]
        if not reason or not others:
            return
        if not self.options.overwrite:
            raise ResultsError(str(self.output), others[0], reason=reason)
        if left := [name for name in others if name not in names]:
            problem = f"holds {left[0]}, which is not among the logs, and {reason}"
            remedy = "name all logs that are there, or give another --output"
            raise ConfigError(problem, path=str(self.output), remedy=remedy)

    def _reason(self, path: Path) -> str | None:
        """Return why a run.json is not of this run, for people; None: it is."""
        try:
            return difference(read_json(path), self.record)
        except InputError as error:
            return f"{RUN} {error.problem}"

    def _standing(self, log: "LogFiles", folder: Path) -> list[LogSummary] | None:
        """Return the summaries of a log that need not be done; None: it is to be done."""
        if not folder.exists():
            return None
        if not folder.is_dir():
            self._refuse(folder, "is no folder, where a log's results would be")
        if is_complete(folder):
            return self._complete(log, folder)
        if (folder / FAILED).is_file():
            told = read_json(folder / FAILED)
            again = self.options.update or self.options.overwrite or told.get("run") != self.run
            return None if again else _summaries(folder / FAILED)
        if any(folder.iterdir()):
            self._refuse(folder, "is there, and no run wrote it")
        return None

    def _complete(self, log: "LogFiles", folder: Path) -> list[LogSummary] | None:
        """Return the same of a log that has results."""
        update = self.options.update
        manifest = {} if self.options.overwrite else read_manifest(folder)
        if manifest.get("run") != self.run:  # else of before an --overwrite that was stopped
            if not (self.options.overwrite or (self.output / RUN).exists()):
                raise ResultsError(str(self.output), folder.name, reason=f"{RUN} is missing")
            self._check_own(folder)
            return None
        if not same_inputs(manifest.get("inputs"), [fingerprint(path) for path in log.paths]):
            if update:
                return None
            error = ResultsError(str(self.output), folder.name, reason="the log has changed")
            error.add_remedy("or --update to do what has changed or failed again")
            raise error
        about = _summaries(folder / SUMMARY)
        return None if update and any(one.lost or one.error for one in about) else about

    def _check_own(self, folder: Path) -> None:
        """Make sure that nothing of the user's goes with a folder that is replaced."""
        try:
            files = read_manifest(folder)["files"]
        except InputError:
            return  # of another version, or changed: it doesn't say which files are its own
        found = (p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir())
        if other := next((name for name in sorted(found) if name not in {*files, MANIFEST}), None):
            self._refuse(folder / other, "is no file of the results that are replaced")

    def _count_attempts(self, staged: Path, place: Path) -> None:
        """Count on from the attempts of a log that has failed before."""
        if is_complete(staged) or not (place / FAILED).is_file():
            return
        told, before = read_json(staged / FAILED), read_json(place / FAILED).get("attempts", 0)
        if isinstance(before, int):
            told["attempts"] += before
            write_whole(staged / FAILED, to_json(told).encode())

    def _refuse(self, path: Path, problem: str) -> NoReturn:
        raise ConfigError(problem, path=str(path), remedy="move it or give another --output")

    def _clear(self) -> None:
        """Remove what runs that ended without a word have left."""
        for path in self._working.iterdir():
            if path.name != "lock":
                remove(path)

    def _leave(self) -> None:
        with stops_held_back():
            with suppress(OSError):
                remove(self.staging)
                if not log_folders(self.output):
                    (self.output / RUN).unlink(missing_ok=True)
            self._lock.release()
            with suppress(OSError):
                self.output.rmdir()  # where nothing is in it


def _summaries(path: Path) -> list[LogSummary]:
    told = read_json(path)
    return [LogSummary.from_dict(entry) for entry in entries_of(told, path)]
