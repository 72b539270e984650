"""The working folder of a run, ``.jaxdet`` in its output folder.

::

    lock            who works here
    plan            what decides the results (jaxdet.engine.record)
    logs-3f9a/      a name of each run's own, so that a process which outlives its run finds no
                    place to write to
      drive-5e09…/  a log; with a file "whole" it is done
        0/          its camera: plan, a part for each unit that is done, pictures, and when it is
                    done its summary in "whole"; several cameras are in 1/, 2/, ...
    result/         tables, maps, configuration, summary, manifest
    tracks/         what jaxdet track makes (jaxdet.tracks.folder)
    5120-0.work     what workers are given that do logs whole
    commit          the results are whole, and move to the output folder (jaxdet.results.commit)

It is there while a run goes on and after one that was stopped, with what is done. Whatever is in it
is whole, as it was renamed there, and agrees with its checksum.
"""

import pickle
import secrets
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from jaxdet.engine.record import (
    difference,
    difference_but_logs,
    digest,
    record_of_results,
)
from jaxdet.errors import ConfigError, ResultsError
from jaxdet.results.commit import JOURNAL, commit, settle
from jaxdet.results.durable import read_checked, write_checked, writing
from jaxdet.results.lock import Lock
from jaxdet.results.manifest import (
    MANIFEST,
    RESULTS,
    WORKING,
    files_like_results,
    made_by,
    result_files,
)
from jaxdet.results.names import file_names
from jaxdet.signals import stops_held_back

if TYPE_CHECKING:
    from jaxdet.engine.kept import KeptLogs

Say = Callable[[str], None]


class WorkFolder:
    """A working folder, and what decides the results of the run that works there.

    Args:
        folder: The working folder.
        record: See :func:`jaxdet.engine.record.make_record`.
    """

    def __init__(self, folder: Path, record: Mapping[str, Any]) -> None:
        self.folder, self.record = folder, record

    def write(self, place: str | Path, value: Any) -> None:
        """Keeps a value in a file of the folder; it is on the disk when the system sees fit.

        What a power cut takes of it is done again.
        """
        write_checked(self.folder / place, pickle.dumps(value, 5), wait=False)

    def read(self, place: str | Path) -> Any:
        """What :meth:`write` kept; None: it isn't there, or damaged."""
        content = read_checked(self.folder / place)
        return None if content is None else pickle.loads(content)

    def empty(self, folder: Path) -> None:
        """Makes the folder of a camera, with nothing in it."""
        shutil.rmtree(folder, ignore_errors=True)
        with writing(folder):
            (folder / "pictures").mkdir(parents=True, exist_ok=True)


class Workspace(WorkFolder):
    """A working folder that this run has locked; a context manager that unlocks it.

    It ends with the folder removed, unless parts are in it that the next run can use.

    Args:
        output: The output folder; made when missing.
        record: What decides the results, see :func:`jaxdet.engine.record.make_record`.
        overwrite: Replace results that are there.
        update: Brings results that are there up to date: opens them. Else they are replaced.
        say: Gets a line for each thing worth knowing.

    Raises:
        ResultsError: The folder holds results and ``overwrite`` is off, or all that are to be
                made.
        ConfigError: It holds an unfinished run of another record, files named as results are, or
            what these can't take the place of; another run works there; or it is a file.
        InputError: The folder can't be written to, or holds another user's unfinished run.
    """

    def __init__(
        self,
        output: Path,
        record: Mapping[str, Any],
        *,
        overwrite: bool,
        update: Callable[[], "KeptLogs"] | None = None,
        say: Say,
    ) -> None:
        super().__init__(output.absolute() / WORKING, record)
        self.output = output
        if output.exists() and not output.is_dir():
            raise ConfigError("is a file", path=str(output), remedy="give --output a folder")
        if not self.folder.exists() and not (overwrite or update):
            self._refuse_results()
        self._lock = Lock(self.folder / "lock")
        self.done: Any = None
        """What :meth:`commit` was told of these results: a stopped run had made them whole."""
        self.kept: KeptLogs | None = None
        """What stays of results that are brought up to date; their record is that of all logs."""
        self.taken_over = self._lock.before is not None
        """The run before this one ended without a word."""
        try:
            self._enter(update, overwrite=overwrite, say=say)
        except BaseException:
            self._leave()
            raise

    def __enter__(self) -> "Workspace":
        """The folder itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Unlocks it, and removes it where nothing in it is of use."""
        self._leave()

    def _enter(self, update: Callable[[], "KeptLogs"] | None, *, overwrite: bool, say: Say) -> None:
        if self._lock.before:
            say(f"taken over from a run that ended without a word ({self._lock.before})")
        if journal := settle(self.folder):
            what = "results of the last run" if journal.told else "tracks of the last jaxdet track"
            say(f"the {what} were whole and are in their place now")
            record, told = journal.told or (None, b"")
            if record and difference(record, self.record) is None:
                self.done = pickle.loads(told)
                return
        if update and (self.output / MANIFEST).exists():
            self.kept = update()
            self.record = self.kept.record
            for note in self.kept.notes:
                say(note)
        if not overwrite and (self.kept is None or self.kept.all_stay):
            self._refuse_results()
        self._refuse_blocked()
        begun = self.read("plan")
        reason = begun and self._other(begun, updates=bool(update))
        if reason and not overwrite:
            anew = f"remove {self.folder}" if update else "--overwrite to begin anew"
            remedy = "repeat that run's command to go on with it, give another --output, or " + anew
            problem = f"holds an unfinished run, but {reason}"
            raise ConfigError(problem, path=str(self.output), remedy=remedy)
        if reason:
            say(f"dropped an unfinished run: {reason}")
        if reason or not begun:
            self.clear()
        with writing(self.folder):
            shutil.rmtree(self.result, ignore_errors=True)
            self.result.mkdir()
            self.logs.mkdir(exist_ok=True)
        self.write("plan", self.record)

    def _other(self, begun: Mapping[str, Any], *, updates: bool) -> str | None:
        """Why this run can't go on with an unfinished one, for people; None: it can."""
        if updates:
            return difference_but_logs(begun, self.record) or self._missing(begun)
        return difference(begun, self.record)

    def _missing(self, begun: Mapping[str, Any]) -> str | None:
        """What is done of a log that is not among this run's, for people; None: nothing is."""
        inputs, now = begun["about"]["inputs"], self.record["about"]["inputs"]
        for log, name in file_names(inputs).items():
            folder = self.logs / _folder_name(begun, log, name)
            if log not in now and any(folder.glob("*/*.part")):
                return f"the log {log} was among its logs"
        return None

    @cached_property
    def logs(self) -> Path:
        """The folder of all logs."""
        begun = next(self.folder.glob("logs-*"), None)
        return begun or self.folder / f"logs-{secrets.token_hex(4)}"

    @property
    def result(self) -> Path:
        """Where files of the results are made."""
        return self.folder / "result"

    def log_folder(self, log: str, file_name: str) -> Path:
        """The folder of a log, which is another one if the log changes.

        Args:
            log: Its name.
            file_name: What the names of its files begin with.
        """
        return self.logs / _folder_name(self.record, log, file_name)

    def drop(self, files: Mapping[str, Path]) -> None:
        """Nothing is of use but files that people may want to read; those move out."""
        with writing(self.output):
            for name, path in files.items():
                if path.suffix == ".txt":
                    path.replace(self.output / name)
        self.clear()

    def commit(self, files: Mapping[str, Path], told: Any) -> None:
        """Makes files the results of the output folder.

        Args:
            files: By their names there.
            told: Is given to a next run that finds them whole, as ``done``.

        Raises:
            OutputError: The disk is full or broken.
        """
        rest = self.logs.name, "result", "tracks", "plan"
        # Of another version nothing but the record can be read, see done.
        about = self.record, pickle.dumps(told, 5)
        commit(self.folder, files, result_files(self.output), rest, about)
        self.clear()

    def clear(self) -> None:
        """Removes all but the lock."""
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != "lock":
                path.unlink()

    def _leave(self) -> None:
        with stops_held_back():
            if self.kept:
                self.kept.close()
            parts = next(self.folder.glob("logs-*/*/*/*.part"), None)
            if self.done is not None or not (parts or (self.folder / JOURNAL).exists()):
                with suppress(OSError):
                    self.clear()
            self._lock.release()
            for folder in (self.folder, self.output):
                with suppress(OSError):
                    folder.rmdir()  # where nothing is in it

    def _refuse_results(self) -> None:
        found = result_files(self.output)
        if found:
            same = made_by(self.output) == digest(self.record)
            before = None if same else record_of_results(self.output, self.record)
            reason = difference(before, self.record) if before else None
            error = ResultsError(str(self.output), found[0], same=same, reason=reason or "")
            if before and not difference_but_logs(before, self.record):
                error.add_remedy("or --update to do new logs alone and keep the rest")
            raise error
        if found := files_like_results(self.output):
            raise ConfigError(
                f"holds {found[0]}, which is named as results are",
                path=str(self.output),
                remedy="give another --output, or --overwrite to replace files of their names",
            )

    def _refuse_blocked(self) -> None:
        """Finds at the start what results could not take the place of at the end."""
        for path in (self.output / name for name in RESULTS):
            if path.is_dir() and not path.is_symlink():
                self._refuse(path, "is a folder, where a file of the results would be")
        pictures = self.output / "pictures"
        drawn = self.record.get("about", {}).get("pictures")
        if not drawn or not (pictures.is_symlink() or pictures.exists()):
            return
        if not pictures.is_dir():
            self._refuse(pictures, "is no folder, where one of the results would be")
        if pictures.stat().st_dev != self.folder.stat().st_dev:
            self._refuse(pictures, "is on another disk than the folder that it is in")

    def _refuse(self, path: Path, problem: str) -> NoReturn:
        raise ConfigError(problem, path=str(path), remedy="move it or give another --output")


def _folder_name(record: Mapping[str, Any], log: str, file_name: str) -> str:
    return f"{file_name}-{digest({log: record['about']['inputs'][log]})[:12]}"
