"""Publishing of complete results of a log, which attempts that race or die never mix.

In a bucket::

    RESULTS/run.json                          configuration and versions, created once
    RESULTS/LOG/current.json                  the current version, swapped by If-Match
    RESULTS/LOG/VERSION/manifest.json         names the valid attempt; written last, if absent
    RESULTS/LOG/VERSION/ATTEMPT/...           a results folder as on one machine
    RESULTS/LOG/VERSION/tracks.json, tracks-ATTEMPT/...    the same for its tracks
    RESULTS/LOG/VERSION/attempts/ATTEMPT      note of an attempt in progress
    RESULTS/LOG/VERSION/failed.json           why there are no results

``VERSION`` is a checksum of input, configuration, jaxdet's version and the last ``--overwrite``.
Each attempt writes under its own name, so two never mix, even if their files differ. An attempt
that finds a manifest, or another ``current.json`` than when it began, removes its own files.

In a folder, a log has the layout of local runs, renamed into place; ``.fleet`` holds attempts.
"""

import hashlib
import json
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.errors import InputError
from jaxdet.fleet.place import Bucket, Entry, Folder, Place, input_entry, open_place
from jaxdet.fleet.spool import is_dead, process, testify
from jaxdet.results.durable import sha256, writing
from jaxdet.results.layout import FAILED, FLEET, MANIFEST
from jaxdet.results.publish import finish, publish, remove

TRACKS, CURRENT = "tracks.json", "current.json"
MOST_KILLED = 3
"""Number of killed processes after which a log counts as failed."""
MOST_LOST = 9
"""Number of killed processes and of attempts lost with their machines within a day, together, after
which a log counts as failed."""
_DAY_S = 86400.0
_NOTES = f"{FLEET}/"
_UPLOADS = 8


class Target(NamedTuple):
    """One version of the results of a log."""

    name: str
    """Name of the log's results."""
    version: str
    record: str
    """Checksum of the configuration, the versions and the last ``--overwrite``."""

    @property
    def base(self) -> str:
        """Prefix of the keys of the version's objects."""
        return f"{self.name}/{self.version}"


class Standing(NamedTuple):
    """State of the results of a log at an address."""

    state: str
    """``new`` without results, ``whole`` or ``failed`` in this version, or ``other`` version."""
    current: Mapping[str, Any] | None = None
    """Content of ``current.json``, or the part of it that is known in a folder."""
    failure: Mapping[str, Any] = {}
    """Content of ``failed.json``."""


def open_results(url: str) -> "Results":
    """Open a place for results."""
    place = open_place(url)
    return BucketResults(place) if isinstance(place, Bucket) else FolderResults(place)


def version_of(record: str, files: Iterable[Entry]) -> str:
    """Return the name of a version, from a record's checksum and the contents of a log's files."""
    text = json.dumps([record, [(file.size, file.tag) for file in files]], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class _Attempts:
    """Notes of the attempts that are being computed, stored next to the results."""

    notes = ""
    """Prefix of the notes' keys."""
    place: Place

    def begin(self, target: Target, attempt: str, command: str) -> str:
        """Write the note of an attempt; return the note's key."""
        key = f"{self.notes}{target.base}/attempts/{attempt}"
        note = {"process": process(), "time": time.time(), "command": command}
        self.place.put(key, json.dumps(note).encode())
        return key

    def end(self, key: str) -> None:
        """Remove the note of an attempt that ended, with results or without."""
        self.place.delete([key])

    def deaths(self, target: Target, command: str | None = None) -> tuple[int, int]:
        """Return the numbers of attempts whose process was killed, and whose machine was lost.

        Args:
            target: Log and version.
            command: Count only attempts of this command.
        """
        killed = lost = 0
        for entry in self.place.list(f"{self.notes}{target.base}/attempts/"):
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


class BucketResults(_Attempts):
    """Results of logs in a bucket."""

    def __init__(self, place: Bucket) -> None:
        self.place = place

    def standing(self, target: Target) -> Standing:
        """Return the results of a log."""
        current = self._json(f"{target.name}/{CURRENT}")
        same = bool(current and current["version"] == target.version)
        if current and same and current["state"] == "whole":
            return Standing("whole", current)
        if self._json(f"{target.base}/{MANIFEST}"):  # an attempt died before it wrote current.json
            state = "whole" if self._point(target, current) else "other"
            return Standing(state, self._json(f"{target.name}/{CURRENT}"))
        if failure := self._json(f"{target.base}/{FAILED}"):
            return Standing("failed", current, failure)
        return Standing("other" if current and not same else "new", current)

    def stage(self, attempt: str, spool: Path) -> Path:
        """Return the path at which an attempt makes its results folder."""
        return spool / "results"

    def publish(self, target: Target, attempt: str, staged: Path, seen: Standing) -> str:
        """Publish a complete folder as the results of a log.

        Args:
            target: Log and version.
            attempt: Name of the attempt.
            staged: Folder with ``manifest.json``.
            seen: Results of the log when the attempt began.

        Returns:
            ``done``; ``there`` if another attempt published first; ``replaced`` if a run of another
            version did.
        """
        first = self._upload(target.base, attempt, staged, None, MANIFEST)
        if not self._point(target, seen.current):
            self._clear(f"{target.base}/")
            return "replaced"
        if first:
            self._clear(f"{target.base}/", keep=(f"{attempt}/", "tracks", MANIFEST))
            if seen.current and seen.current["version"] != target.version:
                self._clear(f"{target.name}/{seen.current['version']}/")
        return "done" if first else "there"

    def publish_tracks(self, target: Target, attempt: str, staged: Path) -> None:
        """Add the tracks of a log, with a ``manifest.json`` that lists them too."""
        known = (self._json(f"{target.base}/{MANIFEST}") or {"files": {}})["files"]
        names = [name for name in _files(staged) if name not in known or name == MANIFEST]
        self._upload(target.base, f"tracks-{attempt}", staged, names, TRACKS)

    def has_tracks(self, target: Target) -> bool:
        """Return whether a log has tracks."""
        return self._json(f"{target.base}/{TRACKS}") is not None

    def fail(self, target: Target, failure: Mapping[str, Any], seen: Standing) -> None:
        """Publish why a log has no results, unless it has some."""
        self.place.put(f"{target.base}/{FAILED}", _bytes(failure))
        self._point(target, seen.current)

    def reopen(self, target: Target) -> None:
        """Remove the failure of a log and the notes of its attempts."""
        noted = [entry.key for entry in self.place.list(f"{target.base}/attempts/")]
        self.place.delete([*noted, f"{target.base}/{FAILED}"])

    def files(self, name: str) -> dict[str, str]:
        """Return the keys of a log's files by their names in its folder; empty without results."""
        current = self._json(f"{name}/{CURRENT}")
        if not current or current["state"] != "whole":
            return {}
        base = f"{name}/{current['version']}"
        found = {}
        for which in (MANIFEST, TRACKS):
            manifest = self._json(f"{base}/{which}") or {"files": {}}
            found |= {file: f"{base}/{manifest['attempt']}/{file}" for file in manifest["files"]}
        return found

    def _upload(
        self, base: str, attempt: str, staged: Path, names: list[str] | None, manifest: str
    ) -> bool:
        """Put files, then their manifest if there is none; otherwise remove the files again."""
        names = _files(staged) if names is None else names
        about = {
            name: {"size": (staged / name).stat().st_size, "sha256": sha256(staged / name)}
            for name in names
        }
        with ThreadPoolExecutor(_UPLOADS) as pool:
            puts = [
                pool.submit(self.place.put, f"{base}/{attempt}/{name}", staged / name)
                for name in names
            ]
            for put in puts:
                put.result()
        content = _bytes({"attempt": attempt, "files": about})
        if self.place.create(f"{base}/{manifest}", content):
            return True
        self._clear(f"{base}/{attempt}/")
        return False

    def _point(self, target: Target, seen: Mapping[str, Any] | None) -> bool:
        """Make ``current.json`` name a version; False if a run of another version changed it."""
        key = f"{target.name}/{CURRENT}"
        while True:
            found = self.place.get(key)
            before = json.loads(found[0]) if found else None
            if before and before["version"] != target.version and before != seen:
                return False
            state = "whole" if self._json(f"{target.base}/{MANIFEST}") else "failed"
            now = {"version": target.version, "record": target.record, "state": state}
            if before == now:
                return True
            text = _bytes(now)
            if self.place.swap(key, text, found[1]) if found else self.place.create(key, text):
                return True

    def _json(self, key: str) -> dict[str, Any] | None:
        found = self.place.get(key)
        return json.loads(found[0]) if found else None

    def _clear(self, prefix: str, keep: tuple[str, ...] = ()) -> None:
        kept = tuple(prefix + name for name in keep)
        keys = (entry.key for entry in self.place.list(prefix))
        self.place.delete([key for key in keys if not (kept and key.startswith(kept))])


class FolderResults(_Attempts):
    """Results of logs in a folder that several processes or machines share."""

    notes = _NOTES

    def __init__(self, place: Folder) -> None:
        self.place, self.root = place, place.root
        finish(self.root)

    def standing(self, target: Target) -> Standing:
        for file, state in ((MANIFEST, "whole"), (FAILED, "failed")):
            if found := self.place.get(f"{target.name}/{file}"):
                content = json.loads(found[0])
                record = content.get("run", "") + content.get("overwrites", "")
                inputs = map(input_entry, content.get("fetched") or content.get("inputs") or ())
                if version_of(record, inputs) == target.version:
                    return Standing(state, None, content if file == FAILED else {})
                return Standing("other", {"record": record})
        return Standing("new")

    def stage(self, attempt: str, spool: Path) -> Path:
        parent = self.root / _NOTES / "staged"
        with writing(parent):
            parent.mkdir(parents=True, exist_ok=True)
            for left in parent.iterdir():
                if is_dead(left.name):
                    remove(left)
        return parent / f"{process()}-{attempt}"

    def publish(self, target: Target, attempt: str, staged: Path, seen: Standing) -> str:
        return self._place(target, staged, ("whole",))

    def fail(self, target: Target, failure: Mapping[str, Any], seen: Standing) -> None:
        staged = self.stage("failed", Path())
        with writing(staged):
            staged.mkdir()
            (staged / FAILED).write_bytes(_bytes(failure))
        self._place(target, staged, ("whole", "failed"))

    def reopen(self, target: Target) -> None:
        noted = [entry.key for entry in self.place.list(f"{_NOTES}{target.base}/")]
        self.place.delete([*noted, f"{target.name}/{FAILED}"])

    def _place(self, target: Target, staged: Path, unless: tuple[str, ...]) -> str:
        def is_there() -> bool:
            return self.standing(target).state in unless

        try:
            return "done" if publish(staged, self.root, target.name, is_there) else "there"
        finally:
            remove(staged)


Results = BucketResults | FolderResults


def result_files(url: str, name: str = "obstacles.parquet") -> list[str]:
    """Return the addresses of one file of every log with results, for readers of tables.

    Args:
        url: Place of results.
        name: Name of the file in a log's folder.
    """
    results = open_results(url)
    if isinstance(results, FolderResults):
        return sorted(str(path) for path in results.root.glob(f"*/{name}"))
    with ThreadPoolExecutor(32) as pool:
        found = pool.map(results.files, _names(results.place))
        return [f"{results.place.url}/{files[name]}" for files in found if name in files]


def download(url: str, name: str, folder: Path) -> Path:
    """Copy the results of one log from a bucket into ``folder``, as a local run leaves them.

    Raises:
        InputError: There are no results, or they were replaced during the copy.
    """
    results = open_results(url)
    assert isinstance(results, BucketResults)
    files = results.files(name)
    for file, key in sorted(files.items(), key=lambda item: item[0] == MANIFEST):
        if not (found := results.place.get(key)):
            raise InputError("was replaced while it was read", path=f"{url}/{name}")
        with writing(folder / file):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(found[0])
    if not files:
        raise InputError("has no results", path=f"{url}/{name}")
    return folder


def _names(place: Place) -> list[str]:
    return sorted(
        entry.key.partition("/")[0] for entry in place.list() if entry.key.endswith(f"/{CURRENT}")
    )


def _files(folder: Path) -> list[str]:
    """Return the files of a folder, by name."""
    paths = (path for path in folder.rglob("*") if path.is_file())
    return sorted(path.relative_to(folder).as_posix() for path in paths)


def _bytes(value: Mapping[str, Any]) -> bytes:
    return (json.dumps(value, indent=1, sort_keys=True) + "\n").encode()
