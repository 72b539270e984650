"""Run of a log from one address to another: fetch, run, publish; every scheduler calls it."""

import json
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

from jaxdet.errors import ConfigError, InputError, JaxdetError, OutputError
from jaxdet.fleet.logs import Log, entries_of, size_of
from jaxdet.fleet.place import Bucket, address, open_place, probe
from jaxdet.fleet.publish import (
    MOST_KILLED,
    MOST_LOST,
    BucketResults,
    Results,
    Standing,
    Target,
    download,
    open_results,
    version_of,
)
from jaxdet.fleet.spool import Spool, check_room, sweep
from jaxdet.results.layout import FAILED, RUN
from jaxdet.results.publish import remove


def run_log(log: Log, place: str, how: Mapping[str, Any]) -> dict[str, Any]:
    """Find the obstacles of one log, unless it has results; calls may be repeated and may race.

    Args:
        log: One of :func:`jaxdet.fleet.list_logs`.
        place: Address of the results.
        how: Plain values, all optional: the keys of :func:`jaxdet.engine.run_one`; ``update``
            (replace results of another input, try failed logs again), ``overwrite`` (replace all
            results), ``tracks``, ``spool`` (folder on local disk), ``spool_size`` (maximum bytes
            of logs there, per process). :func:`prepare` adds values that all machines share.

    Returns:
        Plain values: ``log``, ``name``, ``state`` (``done``, ``there``, ``failed`` or
        ``replaced``), ``error``, ``bytes``, ``frames``, ``obstacles``, ``lost``, ``warnings``,
        and seconds: ``fetch_s``, ``run_s``, ``publish_s``.

    Raises:
        ConfigError: ``how`` is wrong, or the place holds results of another configuration.
        OutputError: A disk or a bucket can't be used.
    """
    return next(run_logs([log], place, how))


def run_logs(logs: Sequence[Log], place: str, how: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Run logs one after the other by :func:`run_log`, while the next one is fetched.

    At most two logs, of ``spool_size`` bytes together, are on local disk.
    """
    how = prepare(place, how) if "record" in how else _prepared(place, json.dumps(how))
    work = _Work(open_results(address(place)), how, Event())
    sweep(how.get("spool"))
    one, following = None, None
    with ThreadPoolExecutor(1) as ahead:
        try:
            for number, log in enumerate(logs):
                # Without room for two logs, none was fetched ahead.
                one = (following.result() if following else None) or work.fetched(log)
                assert one
                following = None
                if number + 1 < len(logs):
                    following = ahead.submit(work.fetched, logs[number + 1], one.held)
                outcome = one.outcome or work.computed(one)
                one.close()
                yield _OUTCOME | outcome
        finally:
            work.stop.set()
            with suppress(BaseException):
                if following and (fetched := following.result()):
                    fetched.close()
            if one:
                one.close()


_OUTCOME = {"error": None, "frames": 0, "obstacles": 0, "lost": [], "warnings": []}
_OUTCOME |= {"fetch_s": 0.0, "run_s": 0.0, "publish_s": 0.0}


class _Fetched(NamedTuple):
    """Log on local disk, or the outcome of a log that is not needed there."""

    log: Log
    target: Target
    seen: Standing
    outcome: dict[str, Any] | None = None
    spool: Spool | None = None
    path: Path = Path()
    held: int = 0
    """Bytes on local disk."""
    seconds: float = 0.0

    def close(self) -> None:
        if self.spool:
            self.spool.close()

    def renamed(self, text: str) -> str:
        """Replace the path on local disk in a text by the log's address."""
        log = self.log
        first = log["files"][0]["key"]
        return text.replace(str(self.path), f"{log['url']}/{first}") if log["url"] else text

    def about(self, how: Mapping[str, Any]) -> dict[str, Any]:
        """Return additional entries of the manifest: the log's files, and the last overwrite."""
        log, overwrites = self.log, how["overwrites"]
        about: dict[str, Any] = {"overwrites": overwrites} if overwrites else {}
        if log["url"]:
            about["fetched"] = [
                {"path": f"{log['url']}/{entry.key}", "size": entry.size, **entry.tag}
                for entry in entries_of(log)
            ]
        return about

    def as_outcome(self, state: str, **values: Any) -> dict[str, Any]:
        about = {"log": self.log["log"], "name": self.log["name"], "bytes": size_of(self.log)}
        return {**about, "state": state, "fetch_s": round(self.seconds, 3), **values}


class _Work(NamedTuple):
    """Fetching, computing and publishing of logs with the same options and output address."""

    results: Results
    how: Mapping[str, Any]
    stop: Event

    def fetched(self, log: Log, held: int = 0) -> _Fetched | None:
        """Fetch a log, unless it has an outcome already.

        Args:
            log: The log.
            held: Bytes of another log on local disk; None is returned if there is no room for both.
        """
        record, where = self.how["record"], self.how.get("spool")
        target = Target(log["name"], version_of(record, entries_of(log)), record)
        one = _Fetched(log, target, self.results.standing(target))
        if outcome := self._standing(one):
            return one._replace(outcome=outcome)
        size, begin, spool = size_of(log) if log["url"] else 0, time.monotonic(), None
        try:
            check_room(where, size, self.how.get("spool_size"), held)
            spool = Spool(where)
            path = _fetch(log, spool.path, self.stop)
        except BaseException as error:
            if spool:
                spool.close()
            elif held and isinstance(error, InputError):
                return None
            if not isinstance(error, InputError):
                raise
            return one._replace(
                outcome=one.as_outcome("failed", error=str(error))
            )  # not published, so that a later call tries again
        return one._replace(spool=spool, path=path, held=size, seconds=time.monotonic() - begin)

    def _standing(self, one: _Fetched) -> dict[str, Any] | None:
        """Return the outcome of a log that needs no work; else None."""
        target, seen, how = one.target, one.seen, self.how
        if seen.state == "whole":
            return one.as_outcome("there", error=self._add_tracks(target))
        if seen.state == "failed":
            if not how.get("update") or seen.failure.get("command") == how["command"]:
                return one.as_outcome("failed", error=seen.failure["reason"])
            self.results.reopen(target)
        replace = how.get("update") or how.get("overwrite") or seen.state != "other"
        if not replace and (seen.current is None or seen.current["record"] == how["record"]):
            error = "there are results of another input; --update replaces them"
            return one.as_outcome("failed", error=error)
        killed, lost = self._deaths(target)
        if killed < MOST_KILLED and killed + lost < MOST_LOST:
            return None
        error = f"{killed + lost} processes that worked on it died"
        self._fail(one, error, None)
        return one.as_outcome("failed", error=error)

    def computed(self, one: _Fetched) -> dict[str, Any]:
        """Run a log and publish its results."""
        assert one.spool
        attempt, begin = secrets.token_hex(6), time.monotonic()
        key = self.results.begin(one.target, attempt, self.how["command"])
        staged = self.results.stage(attempt, one.spool.path)
        try:
            one.spool.witness(self.results.place.url, key)
            found = _run_one(one, staged, self.how)
            found["run_s"] = round(time.monotonic() - begin, 3)
            if found["error"]:
                self._fail(one, found["error"], staged)
                return one.as_outcome("failed", **found)
            results, tracks = self.results, self.how.get("tracks")
            if tracks and not isinstance(results, BucketResults):
                found["error"] = _link(staged)
            state = results.publish(one.target, attempt, staged, one.seen)
            if tracks and isinstance(results, BucketResults) and state == "done":
                found["error"] = self._publish_tracks(results, one.target, staged)
            if state == "replaced":
                found["error"] = "another run published results of another input meanwhile"
            found["publish_s"] = round(time.monotonic() - begin - found["run_s"], 3)
            return one.as_outcome(state, **found)
        finally:
            remove(staged)
            with suppress(JaxdetError):
                self.results.end(key)

    def _deaths(self, target: Target) -> tuple[int, int]:
        """Return the numbers of killed and of lost attempts at a log.

        A driver such as Ray's may end all tasks of a command: then only attempts of this command
        are counted.
        """
        return self.results.deaths(target, self.how["command"] if self.how.get("driven") else None)

    def _fail(self, one: _Fetched, error: str, staged: Path | None) -> None:
        """Publish why a log has no results, with ``failed.json`` in ``staged`` if it is there."""
        killed, lost = self._deaths(one.target)
        noted = {"attempts": max(1, killed + lost), "command": self.how["command"]}
        path = staged / FAILED if staged else None
        if path and path.exists():
            content = json.loads(one.renamed(path.read_text(encoding="utf-8")))
        else:
            from jaxdet.results.manifest import fingerprint
            from jaxdet.results.summary import LogSummary

            inputs = [fingerprint(Path(file["key"])) for file in one.log["files"]]
            entry = {**LogSummary(one.log["log"], ()).to_dict(), "error": error}
            content = {"reason": error, "log": one.log["log"], "logs": [entry], "inputs": inputs}
            run = self.how["record"].removesuffix(self.how["overwrites"])
            content |= {"run": run, **one.about(self.how)}
        self.results.fail(one.target, {**content, **noted}, one.seen)

    def _add_tracks(self, target: Target) -> str | None:
        """Add tracks to results in a bucket that lack them; return the error if that fails."""
        results = self.results
        if not (self.how.get("tracks") and isinstance(results, BucketResults)):
            return None
        if results.has_tracks(target):
            return None
        spool = Spool(self.how.get("spool"))
        try:
            folder = download(results.place.url, target.name, spool.path / "results")
            return self._publish_tracks(results, target, folder)
        finally:
            spool.close()

    def _publish_tracks(self, results: BucketResults, target: Target, folder: Path) -> str | None:
        error = _link(folder)
        if error is None:
            results.publish_tracks(target, secrets.token_hex(6), folder)
        return error


def _link(folder: Path) -> str | None:
    """Add tracks to results on local disk; return the error if that fails."""
    from jaxdet.tracks import TrackConfig
    from jaxdet.tracks.folder import add_tracks

    try:
        add_tracks(folder, TrackConfig())
    except InputError as error:
        return f"has no tracks: {error}"
    return None


def _fetch(log: Log, folder: Path, stop: Event) -> Path:
    """Copy a log to local disk; a local log is read where it is."""
    entries = entries_of(log)
    if not log["url"] and not all(Path(entry.key).exists() for entry in entries):
        raise InputError("is not on this machine", path=entries[0].key)
    if not log["url"] and len(entries) == 1:
        return Path(entries[0].key)
    folder = folder / "log"
    folder.mkdir()
    place = open_place(log["url"]) if log["url"] else None
    paths = [folder / Path(entry.key).name for entry in entries]
    for entry, path in zip(entries, paths, strict=True):
        if isinstance(place, Bucket):
            place.fetch(entry, path, stop)
        else:
            path.symlink_to(entry.key)
    return folder if len(paths) > 1 else paths[0]


def _run_one(one: _Fetched, staged: Path, how: Mapping[str, Any]) -> dict[str, Any]:
    """Run the engine on one log; errors of the log are in ``error``."""
    from jaxdet import engine

    given = {**how, "name": one.log["log"], "about": one.about(how)}
    try:
        found = engine.run_one(str(one.path), staged, given)
    except (ConfigError, OutputError):
        raise
    except JaxdetError as error:
        return {"error": one.renamed(str(error))}
    except Exception as error:
        return {"error": f"an error in jaxdet itself ({type(error).__name__}: {error})"}
    error = one.renamed(found["error"]) if found["error"] else None
    kept = {key: found[key] for key in ("frames", "obstacles", "lost", "warnings")}
    return {**kept, "error": error}


def prepare(place: str, how: Mapping[str, Any]) -> dict[str, Any]:
    """Compare a run with the ``run.json`` at its address, or create that file; once per run.

    Returns:
        ``how`` with ``record``, ``overwrites`` and ``command``, which all machines of a run share.

    Raises:
        ConfigError: The address has results of another configuration or version, the store ignores
            conditional writes, or this machine's versions are not those of the run.
    """
    from jaxdet.engine.single_log import record_of
    from jaxdet.results.record import difference, digest

    url, how, own = address(place), dict(how), record_of(how)
    if "record" in how:
        if digest(own) + how["overwrites"] != how["record"]:
            problem = "this machine's jaxdet, or a package that results depend on, is another one"
            raise ConfigError(problem, path=url, remedy="install the same versions everywhere")
        return how
    at = open_place(url)
    if isinstance(at, Bucket):
        probe(at)
    while True:
        found = at.get(RUN)
        before = json.loads(found[0]) if found else {}
        overwrites = before.get("overwrites", "")
        if found and how.get("overwrite"):
            overwrites = secrets.token_hex(6)
        elif found and (reason := difference(before, own)):
            remedy = "name another --output, or --overwrite to replace the results"
            raise ConfigError(f"holds results, but {reason}", path=url, remedy=remedy)
        now = {**own, "overwrites": overwrites} if overwrites else own
        text = (json.dumps(now, indent=1) + "\n").encode()
        if now == before or (at.swap(RUN, text, found[1]) if found else at.create(RUN, text)):
            about = {"record": digest(own) + overwrites, "overwrites": overwrites}
            return {**how, **about, "command": secrets.token_hex(6)}


@cache
def _prepared(place: str, how: str) -> dict[str, Any]:
    """Prepare a run once in this process."""
    return prepare(place, json.loads(how))
