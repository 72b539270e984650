"""Publishing of the complete results of a log, which concurrent or killed attempts never mix.

In a bucket::

    RESULTS/run.json                       configuration and versions, created once
    RESULTS/LOG/current.json               names the valid attempt, or the reason why there is none
    RESULTS/LOG/ATTEMPT/...                a results folder as on one machine
    RESULTS/LOG/attempts/VERSION/ATTEMPT   note of an attempt in progress

``VERSION`` is a checksum of input, configuration, jaxdet's version and the last ``--overwrite``.
Each attempt writes under its own name, and then enters this name in ``current.json``. If another
attempt has published meanwhile, it removes its own files instead.

In a folder, results have the layout of local runs, and a complete folder is renamed to its final
path; ``.fleet`` holds attempts and a lock.
"""

import hashlib
import json
import secrets
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.errors import InputError, JaxdetError
from jaxdet.fleet.place import Bucket, Entry, Folder, Place, input_entry, locked, open_place
from jaxdet.fleet.spool import is_dead, process, testify
from jaxdet.results.durable import finish, publish, remove, write_whole, writing
from jaxdet.results.json_files import leads_out
from jaxdet.results.layout import FAILED, FLEET, MANIFEST, REPORT, RUN, SUMMARY
from jaxdet.results.record import digest

CURRENT = "current.json"
MOST_KILLED = 3
"""Number of killed processes after which a log counts as failed."""
MOST_LOST = 9
"""Number of killed processes and of attempts lost with their machines within a day, together, after
which a log counts as failed."""
_DAY_S = 86400.0
_UPLOADS = 8


class Target(NamedTuple):
    """One version of the results of a log."""

    name: str
    """Name of the log's results."""
    version: str
    record: str
    """Checksum of the configuration, the versions and the last ``--overwrite``."""


class Standing(NamedTuple):
    """State of the results of a log at an address."""

    state: str
    """``new`` (no results), ``whole`` or ``failed`` in this version, or ``other`` (version)."""
    current: Mapping[str, Any] | None = None
    """Content of ``current.json``: ``version``, ``record``, and ``attempt`` or ``failure``. In a
    folder, ``record`` and ``failure``."""
    kept: str = ""
    """Key of the folder of complete results of this record, of this or another input; a failure
    doesn't replace them. Empty if there are none."""


def open_results(url: str) -> "Results":
    """Open a place for results."""
    place = open_place(url)
    return BucketResults(place) if isinstance(place, Bucket) else FolderResults(place)


def version_of(record: str, files: Iterable[Entry]) -> str:
    """Return the name of a version, from a record's checksum and the contents of a log's files."""
    text = json.dumps([record, [(file.size, file.tag) for file in files]], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class _Results:
    """Results of logs, and next to them notes of the attempts that are being computed."""

    place: Place

    def notes(self, target: Target) -> str:
        """Return the prefix of the keys of the notes about a version."""
        return f"{target.name}/attempts/{target.version}/"

    def begin(self, target: Target, attempt: str, command: str) -> str:
        """Write the note of an attempt; return the note's key."""
        key = self.notes(target) + attempt
        note = {"process": process(), "time": time.time(), "command": command}
        self.place.put(key, json.dumps(note).encode())
        return key

    def end(self, key: str) -> None:
        """Remove the note of an attempt that ended, with results or without."""
        with suppress(JaxdetError):
            self.place.delete([key])

    def deaths(self, target: Target, command: str | None = None) -> tuple[int, int]:
        """Return the number of attempts whose process was killed, and of those lost with a machine.

        Args:
            target: Log and version.
            command: Count only attempts of this command.
        """
        killed = lost = 0
        for entry in self.place.list(self.notes(target)):
            found = self.place.get(entry.key)
            record = json.loads(found[0]) if found else {}
            if not record or command not in (None, record["command"]):
                continue
            dead = record.get("killed") or is_dead(record["process"])
            if dead and not record.get("killed"):
                testify(self.place.url, entry.key)
            killed += bool(dead)
            lost += dead is None and time.time() - record["time"] < _DAY_S
        return killed, lost

    def note_failure(self, target: Target, failure: Mapping[str, Any]) -> None:
        """Write why a version has no results, next to older results, which are kept."""
        self.place.put(self._failure_key(target), _bytes(failure))

    def failure(self, target: Target, seen: Standing) -> Mapping[str, Any] | None:
        """Return why an earlier attempt failed; None if none did."""
        if seen.kept:
            return self._json(self._failure_key(target))
        return seen.current["failure"] if seen.current and seen.state == "failed" else None

    def _failure_key(self, target: Target) -> str:
        return self.notes(target).rstrip("/") + ".json"

    def forget(self, target: Target) -> None:
        """Remove the notes about a version."""
        notes = [entry.key for entry in self.place.list(self.notes(target))]
        self.place.delete([*notes, self._failure_key(target)])

    def folder(self, name: str) -> str:
        """Return the key of the folder of a log's complete results; empty if there are none."""
        raise NotImplementedError

    def files(self, name: str, run: str = "") -> dict[str, str]:
        """Return the keys of a log's files by their names in its folder; empty without results.

        Args:
            name: Name of the log's results.
            run: Checksum of a configuration; results of others are left out.
        """
        own = self.folder(name)
        manifest = self._json(f"{own}/{MANIFEST}") if own else None
        if not manifest or run not in ("", manifest.get("run")):
            return {}
        if any(map(leads_out, manifest["files"])):
            raise InputError("was changed", path=f"{self.place.url}/{own}/{MANIFEST}")
        return {file: f"{own}/{file}" for file in (*manifest["files"], MANIFEST)}

    def summary(self, seen: Standing) -> dict[str, Any]:
        """Return ``summary.json`` of results of this record; empty if they were replaced."""
        return self._json(f"{seen.kept}/{SUMMARY}") or {}

    def _json(self, key: str) -> dict[str, Any] | None:
        found = self.place.get(key)
        try:
            return json.loads(found[0]) if found else None
        except ValueError:
            raise InputError("is not JSON", path=f"{self.place.url}/{key}") from None


class BucketResults(_Results):
    """Results of logs in a bucket."""

    def __init__(self, place: Bucket) -> None:
        self.place = place

    def standing(self, target: Target) -> Standing:
        """Return the state of a log's results."""
        current = self._json(f"{target.name}/{CURRENT}")
        if not current:
            return Standing("new")
        own = current["record"] == target.record and "attempt" in current
        kept = f"{target.name}/{current['attempt']}" if own else ""
        if current["version"] != target.version:
            return Standing("other", current, kept)
        states = ("whole", "attempt"), ("failed", "failure")
        state = next((state for state, key in states if key in current), "new")
        return Standing(state, current, kept)

    def stage(self, attempt: str, spool: Path, name: str = "results") -> Path:
        """Return the path at which an attempt makes its results folder; its parent is new."""
        with writing(spool):
            (spool / "new").mkdir(parents=True, exist_ok=True)
        return spool / "new" / name

    def publish(self, target: Target, attempt: str, staged: Path, seen: Standing) -> str:
        """Publish a complete folder as the results of a log.

        Args:
            target: Log and version.
            attempt: Name of the attempt.
            staged: Folder with ``manifest.json``.
            seen: State of the log's results when the attempt began.

        Returns:
            ``done``; ``there`` if another attempt published first; ``replaced`` if a run of another
            version published first.
        """
        own = f"{target.name}/{attempt}/"
        paths = [path for path in staged.rglob("*") if path.is_file()]
        keys = [own + path.relative_to(staged).as_posix() for path in paths]
        with ThreadPoolExecutor(_UPLOADS) as pool:
            for put in [pool.submit(self.place.put, *one) for one in zip(keys, paths, strict=True)]:
                put.result()
        # Once this attempt is valid, attempts that began earlier can't be published any more, so
        # their files are removed. Files of attempts that begin later are not in this list.
        before = [entry.key for entry in self.place.list(f"{target.name}/")]
        state = self._point(target, {"attempt": attempt}, seen)
        if state == "done":
            keep = own, f"{target.name}/{CURRENT}"
            self.place.delete([key for key in before if not key.startswith(keep)])
        else:
            self.place.delete(keys)
        return state

    def fail(
        self,
        target: Target,
        failure: Mapping[str, Any],
        seen: Standing,
        staged: Path | None = None,
    ) -> None:
        """Publish the reason why a log has no results, unless results were published meanwhile.

        Args:
            target: Log and version.
            failure: Content of ``failed.json``.
            seen: State of the log's results when the attempt began.
            staged: Folder that the attempt made, with reports of crashes.
        """
        for report in staged.glob(f"*{REPORT}") if staged else ():
            self.place.put(f"{target.name}/{report.name}", report)
        self._point(target, {"failure": failure}, seen)

    def reopen(self, target: Target, seen: Standing) -> None:
        """Remove the failure of a log and the notes of its attempts."""
        self.forget(target)
        if not seen.kept:
            self._point(target, {}, seen)

    def logs(self) -> list[str]:
        """Return the names of all logs, in order."""
        keys = (entry.key.rpartition("/") for entry in self.place.list())
        return sorted(name for name, _, file in keys if file == CURRENT)

    def folder(self, name: str) -> str:
        """Return the key of the folder of a log's complete results; empty if there are none."""
        current = self._json(f"{name}/{CURRENT}") or {}
        return f"{name}/{current['attempt']}" if "attempt" in current else ""

    def _point(self, target: Target, to: Mapping[str, Any], seen: Standing) -> str:
        """Write ``current.json``, unless another attempt has published since ``seen`` was read.

        Returns:
            See :meth:`publish`.
        """
        key = f"{target.name}/{CURRENT}"
        text = _bytes({"version": target.version, "record": target.record, **to})
        while True:
            found = self.place.get(key)
            before = json.loads(found[0]) if found else None
            if before and before != seen.current:
                if before["version"] != target.version:
                    return "replaced"
                if "attempt" in before:
                    return "there"
            if self.place.swap(key, text, found[1]) if found else self.place.create(key, text):
                return "done"


class FolderResults(_Results):
    """Results of logs in a folder that several processes or machines share."""

    def __init__(self, place: Folder) -> None:
        self.place, self.root = place, place.root
        finish(self.root)

    def notes(self, target: Target) -> str:
        return f"{FLEET}/{super().notes(target)}"

    def standing(self, target: Target) -> Standing:
        for file, state in ((MANIFEST, "whole"), (FAILED, "failed")):
            if content := self._json(f"{target.name}/{file}"):
                record = content.get("run", "") + content.get("overwrites", "")
                inputs = map(input_entry, content.get("fetched") or content.get("inputs") or ())
                same = version_of(record, inputs) == target.version
                kept = target.name if state == "whole" and record == target.record else ""
                current = {"record": record, "failure": content}
                return Standing(state if same else "other", current, kept)
        return Standing("new")

    def stage(self, attempt: str, spool: Path, name: str = "results") -> Path:
        new = self.root / FLEET / "staged" / f"{process()}-{attempt}"
        with writing(new):
            new.mkdir(parents=True, exist_ok=True)
            for left in new.parent.glob("*-*-*-*"):
                if is_dead(left.name):
                    remove(left)
        return new / name

    def publish(self, target: Target, attempt: str, staged: Path, seen: Standing) -> str:
        try:
            with writing(self.root), locked(self.root):
                now = self.standing(target)
                if now != seen and now.state in ("whole", "other"):
                    return "there" if now.state == "whole" else "replaced"
                publish(staged, self.root, target.name)
                return "done"
        finally:
            remove(staged.parent)

    def logs(self) -> list[str]:
        return sorted(path.parent.name for path in self.root.glob(f"*/{MANIFEST}"))

    def folder(self, name: str) -> str:
        return name

    def fail(
        self,
        target: Target,
        failure: Mapping[str, Any],
        seen: Standing,
        staged: Path | None = None,
    ) -> None:
        staged = staged or self.stage(f"failed-{secrets.token_hex(4)}", Path())
        with writing(staged):
            staged.mkdir(exist_ok=True)
        write_whole(staged / FAILED, _bytes(failure))
        self.publish(target, "", staged, seen)

    def reopen(self, target: Target, seen: Standing) -> None:
        self.forget(target)
        self.place.delete([f"{target.name}/{FAILED}"])


Results = BucketResults | FolderResults


def result_files(url: str, name: str = "obstacles.parquet") -> list[str]:
    """Return the addresses of one file of every log with results, for readers of tables.

    Results of another configuration or version than ``run.json``, which a run with ``--overwrite``
    has not replaced yet, are left out.

    Args:
        url: Place of results.
        name: Name of the file in a log's folder.
    """
    results = open_results(url)
    found = results.place.get(RUN)
    run = digest(json.loads(found[0])) if found else ""
    with ThreadPoolExecutor(32) as pool:
        logs = pool.map(partial(results.files, run=run), results.logs())
        return [f"{results.place.url}/{files[name]}" for files in logs if name in files]


def download(url: str, name: str, folder: Path) -> Path:
    """Copy the results of one log from a bucket into ``folder``, with the layout of a local run.

    Raises:
        InputError: There are no results, or they were replaced during the copy.
    """
    results = open_results(url)
    files = results.files(name)
    if not files:
        raise InputError("has no results", path=f"{url}/{name}")
    for file, key in files.items():  # the manifest is the last
        if not (found := results.place.get(key)):
            raise InputError("was replaced while it was read", path=f"{url}/{name}")
        with writing(folder / file):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(found[0])
    return folder


def _bytes(value: Mapping[str, Any]) -> bytes:
    return (json.dumps(value, indent=1, sort_keys=True) + "\n").encode()
