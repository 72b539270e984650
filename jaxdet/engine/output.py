"""Output folder of a run: folders of logs that are done, and staging folders of other logs."""

import logging
import os
import secrets
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from jaxdet.errors import ConfigError, InputError, ResultsError
from jaxdet.results.durable import finish, publish, remove, write_whole, writing
from jaxdet.results.json_files import entries_of, read_json, to_json
from jaxdet.results.layout import (
    ASIDE,
    FAILED,
    FLEET,
    FRAMES,
    MANIFEST,
    RUN,
    SUMMARY,
    WORKING,
    is_complete,
    log_folders,
)
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import fingerprint, read_manifest, same_inputs
from jaxdet.results.names import log_name
from jaxdet.results.record import difference, digest
from jaxdet.results.summary import LogSummary
from jaxdet.signals import stops_held_back

if TYPE_CHECKING:
    from jaxdet.engine.settings import RunOptions
    from jaxdet.io import LogFiles

LOGGER = logging.getLogger("jaxdet")


class OutputFolder:
    """An output folder, locked for this run; a context manager that unlocks it.

    Args:
        output: The folder, which is made if it is missing.
        record: Configuration and versions, see :func:`jaxdet.results.record.make_record`.
        options: Options of the run, of which ``overwrite`` and ``update`` are used.

    Attributes:
        staging: Folder for results that are not complete yet.
        taken_over: Whether the previous run was killed, so that its lock was still there.

    Raises:
        ConfigError: Another run works in the folder, or it is a file.
        InputError: The folder can't be written to, or holds another user's unfinished run.
    """

    def __init__(self, output: Path, record: Mapping[str, Any], options: "RunOptions") -> None:
        self.output, self.record, self.options = output, record, options
        self.run = digest(record)
        self._working = output.absolute() / WORKING
        self.staging = self._working / f"logs-{secrets.token_hex(4)}"
        if output.exists() and not output.is_dir():
            raise ConfigError("is a file", path=str(output), remedy="pass --output a folder")
        self._lock = Lock(self._working / "lock")
        self.taken_over = self._lock.before is not None
        try:
            if self._lock.before:
                before = self._lock.before
                LOGGER.warning("taken over from a run that was killed (%s)", before)
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
        """Check that logs can be added, and return the summaries of those that are done.

        Args:
            logs: Logs of the run.

        Returns:
            Summaries of the cameras of each log that is done, by the log's name.

        Raises:
            ResultsError: There are results of another configuration or version, or of a log that
                was changed later.
            ConfigError: The path of a log's folder holds something else, or two logs would have the
                same folder.
            InputError: Results can't be read.
        """
        _check_names(logs)
        self._check_run({log_name(log.name) for log in logs})
        found = {log.name: self._standing(log, self.output / log_name(log.name)) for log in logs}
        place = self.output / RUN
        with writing(self.output):
            self.staging.mkdir()
            if not place.exists() or self._difference(place):
                write_whole(self.staging / RUN, to_json(dict(self.record)).encode())
                os.replace(self.staging / RUN, place)
        return {name: about for name, about in found.items() if about is not None}

    def staged(self, log: str) -> Path:
        """Return the folder in which the results of a log are to be made."""
        return self.staging / log_name(log)

    def publish(self, log: str) -> None:
        """Move the staged folder of a log to its final path.

        If the log failed, complete results that are already there are kept.

        Raises:
            OutputError: The disk is full or broken.
        """
        staged, name = self.staged(log), log_name(log)
        if is_complete(staged) or not is_complete(self.output / name):
            self._count_attempts(staged, self.output / name)
            publish(staged, self.output, name)
        else:
            remove(staged)

    def _check_run(self, names: set[str]) -> None:
        """Check that results in the folder are of this configuration and version."""
        if is_complete(self.output) or (self.output / FRAMES).exists():
            problem = "holds results of an older version, or of one log"
            raise ConfigError(problem, path=str(self.output), remedy="pass another --output")
        if not (self.output / RUN).exists():
            return
        reason = self._difference(self.output / RUN)
        others = [name for name, path in log_folders(self.output).items() if is_complete(path)]
        if not reason or not others:
            return
        if not self.options.overwrite:
            raise ResultsError(str(self.output), others[0], reason=reason)
        if left := [name for name in others if name not in names]:
            problem = f"holds {left[0]}, which is not among the logs, and {reason}"
            remedy = "name all logs that are there, or pass another --output"
            raise ConfigError(problem, path=str(self.output), remedy=remedy)

    def _difference(self, path: Path) -> str | None:
        """Describe how a ``run.json`` differs from this run; None if it doesn't."""
        try:
            return difference(read_json(path), self.record)
        except InputError as error:
            return f"{RUN} {error.problem}"

    def _standing(self, log: "LogFiles", folder: Path) -> list[LogSummary] | None:
        """Return the summaries of a log if it is done, else None."""
        if not folder.exists():
            return None
        if not folder.is_dir():
            self._refuse(folder, "is not a folder, but in the place of a log's results")
        if is_complete(folder):
            return self._complete(log, folder)
        if (folder / FAILED).is_file():
            content = read_json(folder / FAILED)
            again = self.options.update or self.options.overwrite or content.get("run") != self.run
            return None if again else _summaries(folder / FAILED)
        if any(folder.iterdir()):
            self._refuse(folder, "was not written by a run")
        return None

    def _complete(self, log: "LogFiles", folder: Path) -> list[LogSummary] | None:
        """Return the summaries of a log with complete results; None if it must be done again."""
        update = self.options.update
        manifest = {} if self.options.overwrite else read_manifest(folder)
        if manifest.get("run") != self.run:  # an earlier --overwrite may have been stopped
            if not (self.options.overwrite or (self.output / RUN).exists()):
                raise ResultsError(str(self.output), folder.name, reason=f"{RUN} is missing")
            self._check_own(folder)
            return None
        if not same_inputs(manifest["inputs"], [fingerprint(path) for path in log.paths]):
            if update:
                return None
            error = ResultsError(str(self.output), folder.name, reason="the log has changed")
            error.add_remedy("or --update to do what has changed or failed again")
            raise error
        about = _summaries(folder / SUMMARY)
        return None if update and any(one.lost or one.error for one in about) else about

    def _check_own(self, folder: Path) -> None:
        """Check that a folder that will be replaced contains only results."""
        try:
            files = read_manifest(folder)["files"]
        except InputError:
            return  # a manifest of another version, or a changed one, doesn't list the files
        found = (p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir())
        if other := next((name for name in sorted(found) if name not in {*files, MANIFEST}), None):
            self._refuse(folder / other, "is not a file of the results that are replaced")

    def _count_attempts(self, staged: Path, place: Path) -> None:
        """Add the number of earlier attempts at a log that failed before."""
        if is_complete(staged) or not (place / FAILED).is_file():
            return
        content, before = read_json(staged / FAILED), read_json(place / FAILED).get("attempts", 0)
        if isinstance(before, int):
            content["attempts"] += before
            write_whole(staged / FAILED, to_json(content).encode())

    def _refuse(self, path: Path, problem: str) -> NoReturn:
        raise ConfigError(problem, path=str(path), remedy="move it or pass another --output")

    def _clear(self) -> None:
        """Remove files that killed runs have left; ``finish`` removes folders moved aside."""
        for path in self._working.iterdir():
            if path.name != "lock" and not path.name.startswith(ASIDE):
                remove(path)

    def _leave(self) -> None:
        with stops_held_back():
            with suppress(OSError):
                remove(self.staging)
                shared = (self.output / FLEET).exists()  # other processes rely on run.json
                if not (shared or log_folders(self.output)):
                    (self.output / RUN).unlink(missing_ok=True)
            self._lock.release()
            with suppress(OSError):
                self.output.rmdir()  # fails if it is not empty


def _check_names(logs: Sequence["LogFiles"]) -> None:
    """Check that no two logs have the same folder of results."""
    found: dict[str, LogFiles] = {}
    for log in logs:
        name = log_name(log.name)
        if name in found:
            problem = f"has the name of {found[name].paths[0]}: {log.name}"
            remedy = "name the folder that both are in, and they have names by their paths in it"
            raise ConfigError(problem, path=str(log.paths[0]), remedy=remedy)
        found[name] = log


def _summaries(path: Path) -> list[LogSummary]:
    content = read_json(path)
    return [LogSummary.from_dict(entry) for entry in entries_of(content, path)]
