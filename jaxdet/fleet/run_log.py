"""One log from a place to a place: fetch, run, publish; what every engine calls."""

import hashlib
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

import jaxdet
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

RUN = "run.json"
RESULT_KEYS = ("preset", "config", "log", "backend", "pictures")
"""Keys of ``how`` that decide results."""
ENGINE_KEYS = (*RESULT_KEYS, "workers", "memory", "batch_size")
"""Keys of ``how`` that :func:`jaxdet.engine.run_one` takes."""


def run_log(log: Log, place: str, how: Mapping[str, Any]) -> dict[str, Any]:
    """Find the obstacles of one log, unless its results are there; safe to repeat and to race.

    Args:
        log: One of :func:`jaxdet.fleet.list_logs`.
        place: Address of the results.
        how: Plain values, all optional: the keys of :func:`jaxdet.engine.run_one`; ``update``
            (replace results of another input, try failed logs again), ``overwrite`` (replace all
            results), ``tracks``, ``spool`` (folder on local disk), ``spool_size`` (most bytes of
            logs there, per process). :func:`prepare` returns it with what is decided once per run.

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
    """Run logs one after the other, as :func:`run_log`, the next one fetched meanwhile.

    At most two logs are on local disk, and never more than ``spool_size`` bytes of them.
    """
    how = prepare(place, how) if "record" in how else _prepared(place, json.dumps(how))
    work = _Work(open_results(address(place)), how, Event())
    sweep(how.get("spool"))
    following, waiting = None, []
    with ThreadPoolExecutor(1) as ahead:
        try:
            for number, log in enumerate(logs):
                one = following.result() if following else None
                if one is None:  # none was fetched ahead, or there was no room
                    one = work.fetched(log)
                waiting = [one]
                following = None
                if number + 1 < len(logs):
                    later, held = logs[number + 1], one.held
                    following = ahead.submit(work.fetched_ahead, later, held)
                outcome = one.outcome or work.computed(one)
                one.close()
                yield {**_NOTHING, **outcome}
        finally:
            work.stop.set()
            if following:
                with suppress(BaseException):
                    waiting += filter(None, [following.result()])
            for one in waiting:
                one.close()


_NOTHING = {"error": None, "frames": 0, "obstacles": 0, "lost": [], "warnings": []}
_NOTHING |= {"fetch_s": 0.0, "run_s": 0.0, "publish_s": 0.0}


class _Fetched(NamedTuple):
    """A log on local disk, or an outcome without one."""

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


class _Work(NamedTuple):
    """What the logs of a run share."""

    results: Results
    how: Mapping[str, Any]
    stop: Event

    def fetched_ahead(self, log: Log, held: int) -> _Fetched | None:
        """Fetch a log; None: there is no room next to the one that is computed."""
        try:
            check_room(self.how.get("spool"), _held(log), self.how.get("spool_size"), held)
        except InputError:
            return None
        return self.fetched(log)

    def fetched(self, log: Log) -> _Fetched:
        """Fetch a log, unless that is not needed."""
        target = Target(
            log["name"], version_of(self.how["record"], entries_of(log)), self.how["record"]
        )
        seen = self.results.standing(target)
        one = _Fetched(log, target, seen)
        if outcome := self._standing(one):
            return one._replace(outcome=outcome)
        begin, spool = time.monotonic(), None
        try:
            check_room(self.how.get("spool"), _held(log), self.how.get("spool_size"), 0)
            spool = Spool(self.how.get("spool"))
            path = _fetch(log, spool.path, self.stop)
        except InputError as error:  # of this moment or machine, so nothing is noted
            if spool:
                spool.close()
            return one._replace(outcome=self._outcome(one, "failed", error=str(error)))
        except BaseException:
            if spool:
                spool.close()
            raise
        taken = time.monotonic() - begin
        return one._replace(spool=spool, path=path, held=_held(log), seconds=taken)

    def _standing(self, one: _Fetched) -> dict[str, Any] | None:
        """Return the outcome of a log that has one already."""
        target, seen, how = one.target, one.seen, self.how
        if seen.state == "whole":
            return self._outcome(one, "there", **self._tracked(target))
        if seen.state == "failed":
            if not how.get("update") or seen.failure.get("run") == how["run"]:
                return self._outcome(one, "failed", error=seen.failure["reason"])
            self.results.reopen(target)
        replace = how.get("update") or how.get("overwrite") or seen.state != "other"
        if not replace and (seen.current is None or seen.current["record"] == how["record"]):
            error = "there are results of another input; --update replaces them"
            return self._outcome(one, "failed", error=error)
        killed, lost = self.results.deaths(target)
        if killed < MOST_KILLED and killed + lost < MOST_LOST:
            return None
        error = f"{killed + lost} processes that worked on it died"
        self._fail(one, error)
        return self._outcome(one, "failed", error=error)

    def computed(self, one: _Fetched) -> dict[str, Any]:
        """Run a log and publish its results."""
        assert one.spool
        attempt = secrets.token_hex(6)
        key = self.results.begin(one.target, attempt)
        try:
            one.spool.witness(self.results.place.url, key)
            begin = time.monotonic()
            staged = self.results.stage(attempt, one.spool.path)
            found = _run_one(one, staged, self.how)
            run_s = time.monotonic() - begin
            error, state = found.pop("error"), "failed"
            if error:
                self._fail(one, error)
            else:
                extra = self._link(staged) if self.how.get("tracks") else ""
                state = self.results.publish(one.target, attempt, staged, one.seen)
                if extra is None and state == "done" and isinstance(self.results, BucketResults):
                    self.results.publish_tracks(one.target, attempt, staged)
                error = extra or _REPLACED.get(state)
            spent = time.monotonic() - begin - run_s
            return self._outcome(one, state, **found, error=error, run_s=run_s, publish_s=spent)
        finally:
            with suppress(JaxdetError):
                self.results.end(key)

    def _fail(self, one: _Fetched, error: str) -> None:
        failure = {"log": one.log["log"], "reason": error, "run": self.how["run"]}
        killed, lost = self.results.deaths(one.target)
        failure["attempts"] = max(1, killed + lost)
        self.results.fail(one.target, failure, one.seen)

    def _link(self, folder: Path) -> str | None:
        """Add tracks to results; return why not."""
        from jaxdet.tracks import track_results

        try:
            track_results(folder)
        except InputError as error:
            return f"has no tracks: {error}"
        return None

    def _tracked(self, target: Target) -> dict[str, Any]:
        """Add tracks to results in a bucket that lack them; return what went wrong."""
        results = self.results
        if not (self.how.get("tracks") and isinstance(results, BucketResults)):
            return {}
        if results.has_tracks(target):
            return {}
        spool = Spool(self.how.get("spool"))
        try:
            folder = download(results.place.url, target.name, spool.path / "results")
            error = self._link(folder)
            if error is None:
                results.publish_tracks(target, secrets.token_hex(6), folder)
            return {"error": error}
        finally:
            spool.close()

    def _outcome(self, one: _Fetched, state: str, **values: Any) -> dict[str, Any]:
        about = {"log": one.log["log"], "name": one.log["name"], "bytes": size_of(one.log)}
        return {**about, "state": state, "fetch_s": round(one.seconds, 3), **values}


_REPLACED = {"replaced": "another run published results of another version meanwhile"}


def _held(log: Log) -> int:
    return size_of(log) if log["url"] else 0


def _fetch(log: Log, folder: Path, stop: Event) -> Path:
    """Copy a log to local disk; local ones are read where they are."""
    entries = entries_of(log)
    if not log["url"] and len(entries) == 1:
        return Path(entries[0].key)
    folder = folder / "log"
    folder.mkdir()
    place = open_place(log["url"]) if log["url"] else None
    for entry in entries:
        path = folder / Path(entry.key).name
        if isinstance(place, Bucket):
            place.fetch(entry, path, stop)
        else:
            path.symlink_to(entry.key)
    return folder if len(entries) > 1 else path


def _run_one(one: _Fetched, staged: Path, how: Mapping[str, Any]) -> dict[str, Any]:
    """Run the engine on one log; what goes wrong with the log is in ``error``."""
    from jaxdet import engine

    chosen = {key: how[key] for key in ENGINE_KEYS if how.get(key) is not None}
    try:
        found = engine.run_one(str(one.path), staged, {**chosen, "name": one.log["log"]})
    except (ConfigError, OutputError):
        raise
    except JaxdetError as error:
        return {"error": str(error)}
    except Exception as error:
        return {"error": f"an error in jaxdet itself ({type(error).__name__}: {error})"}
    return {key: found[key] for key in ("frames", "obstacles", "lost", "warnings", "error")}


def prepare(place: str, how: Mapping[str, Any]) -> dict[str, Any]:
    """Compare a run with the ``run.json`` of its place, or create that; once per run.

    Returns:
        ``how`` with ``record``, ``overwrites`` and ``run``, which all machines of a run share.

    Raises:
        ConfigError: The place has results of another configuration or version, the store ignores
            conditional writes, or this machine's versions are not those of the run.
    """
    url, how = address(place), dict(how)
    own = _record(how)
    if "record" in how:
        if _digest({**own, "overwrites": how["overwrites"]}) != how["record"]:
            problem = "this machine's jaxdet, or a package that results depend on, is another one"
            raise ConfigError(problem, path=url, remedy="install the same versions everywhere")
        return how
    now = _opened(url, own, bool(how.get("overwrite")))
    run = secrets.token_hex(6)
    return {**how, "record": _digest(now), "overwrites": now["overwrites"], "run": run}


@cache
def _prepared(place: str, how: str) -> dict[str, Any]:
    """Prepare a run that is a process."""
    return prepare(place, json.loads(how))


def _opened(url: str, own: Mapping[str, Any], overwrite: bool) -> dict[str, Any]:
    """Return the ``run.json`` of a place."""
    from jaxdet.engine.record import difference

    place = open_place(url)
    if isinstance(place, Bucket):
        probe(place)
    while True:
        found = place.get(RUN)
        before = json.loads(found[0]) if found else None
        if before is not None and not overwrite:
            reason = difference(before, {**own, "overwrites": before.get("overwrites")})
            if reason is None:
                return before
            remedy = "name another --output, or --overwrite to replace the results"
            raise ConfigError(f"holds results, but {reason}", path=url, remedy=remedy)
        now = {**own, "overwrites": secrets.token_hex(6) if before else ""}
        text = (json.dumps(now, indent=1) + "\n").encode()
        if place.swap(RUN, text, found[1]) if found else place.create(RUN, text):
            return now


def _record(how: Mapping[str, Any]) -> dict[str, Any]:
    """Return what decides results but their input."""
    from jaxdet.results.versions import source_digest, versions

    about = {"jaxdet": jaxdet.__version__, "source": source_digest(), "versions": versions()}
    chosen = {key: how[key] for key in RESULT_KEYS if how.get(key) is not None}
    return json.loads(json.dumps({"about": about, "config": chosen}))


def _digest(record: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:16]
