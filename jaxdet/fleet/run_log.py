"""Run of a log at an address: fetch it, run it, publish its results; for use by any scheduler."""

import json
import os
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack
from functools import cache, partial
from itertools import zip_longest
from pathlib import Path
from threading import Event
from typing import Any

from jaxdet.errors import ConfigError, InputError, JaxdetError, OutputError, WorkerStartError
from jaxdet.fleet.logs import Log, entries_of, size_of
from jaxdet.fleet.place import Bucket, address, open_place, probe
from jaxdet.fleet.publish import (
    MOST_KILLED,
    MOST_LOST,
    Results,
    Target,
    download,
    open_results,
    version_of,
)
from jaxdet.fleet.spool import Spool, check_room, sweep
from jaxdet.io.splits import METADATA
from jaxdet.results.durable import remove, writing
from jaxdet.results.json_files import read_json
from jaxdet.results.layout import FAILED, RUN, SUMMARY, TRACKS, is_complete
from jaxdet.results.summary import LogSummary, failure_record, problems
from jaxdet.signals import called_at_end


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
    results, stop, fetching = open_results(address(place)), Event(), None
    sweep(how.get("spool"))
    jobs = [_Job(log, results, how) for log in logs]
    with ThreadPoolExecutor(1) as ahead:
        try:
            for job, later in zip_longest(jobs, jobs[1:]):
                if not (fetching and fetching.result()):
                    job.fetch(stop)  # the first log, or there was no room for two logs
                fetching = ahead.submit(later.fetch, stop, job.held) if later else None
                outcome = job.outcome or job.computed()
                job.close()
                yield outcome
        finally:
            stop.set()
            wait([fetching] if fetching else [])
            for job in jobs:
                job.close()


class _Job:
    """Work on one log.

    Args:
        log: The log.
        results: Place of the results.
        how: Options, as returned by :func:`prepare`.

    Attributes:
        outcome: Outcome of the log; None until it is known.
        paths: Files of the log on local disk.
        held: Size of the log's copy on local disk [bytes].
    """

    def __init__(self, log: Log, results: Results, how: Mapping[str, Any]) -> None:
        self.log, self.results, self.how = log, results, how
        version = version_of(how["record"], entries_of(log))
        self.target = Target(log["name"], version, how["record"])
        self.outcome: dict[str, Any] | None = None
        self.spool: Spool | None = None
        self.paths: list[Path] = []
        self.held, self.attempts, self.fetch_s = 0, 0, 0.0

    def close(self) -> None:
        """Remove the log from local disk."""
        if self.spool:
            self.spool.close()

    def fetch(self, stop: Event, held: int = 0) -> bool:
        """Fetch the log, unless it has an outcome already.

        Args:
            stop: Set when copying must end.
            held: Size of another log's copy on local disk [bytes].

        Returns:
            False if there is no room for both logs, so that the call must be repeated later.
        """
        if not self._needs_work():
            return True
        log, where, begin = self.log, self.how.get("spool"), time.monotonic()
        self.held = size_of(log) if log["url"] else 0
        try:
            check_room(where, self.held, self.how.get("spool_size"), held)
            self.spool = Spool(where)
            self.paths = _fetch(log, self.spool.path, stop)
        except InputError as error:
            if held and not self.spool:
                return False
            # The failure is not published, so that a later call tries again.
            self._end("failed", error=str(error))
        self.fetch_s = time.monotonic() - begin
        return True

    def _needs_work(self) -> bool:
        """Return whether the log must be computed; otherwise set its outcome."""
        how = self.how
        self.seen = seen = self.results.standing(self.target)
        current = seen.current or {}
        if seen.state == "whole":
            about = self.results.summary(seen)
            incomplete = any(log["lost"] or log["error"] for log in about.get("logs", ()))
            if not (incomplete and how.get("update")):
                found = self._reported(about)
                self._end("there", **_joined(found, self._add_tracks()))
                return False
        replace = how.get("update") or how.get("overwrite")
        if seen.state == "other" and current["record"] == how["record"] and not replace:
            error = "there are results of another input; --update replaces them"
            self._end("failed", error=error)
            return False
        if failure := self.results.failure(self.target, seen):
            if not how.get("update") or failure.get("command") == how["command"]:
                self._end("failed", error=failure["reason"])
                return False
            self.attempts = failure.get("attempts", 0)
            self.results.reopen(self.target, seen)
        killed, lost = self._deaths()
        if killed >= MOST_KILLED or killed + lost >= MOST_LOST:
            self._fail(f"{killed + lost} processes that worked on it died")
            return False
        return True

    def computed(self) -> dict[str, Any]:
        """Compute the log and publish its results; return the outcome."""
        assert self.spool
        attempt, begin = secrets.token_hex(6), time.monotonic()
        key = self.results.begin(self.target, attempt, self.how["command"])
        with called_at_end(partial(self.results.end, key)), ExitStack() as last:
            staged = self.results.stage(attempt, self.spool.path, self.target.name)
            last.callback(remove, staged.parent)
            self.spool.witness(self.results.place.url, key)
            found = self._run(staged)
            found["run_s"] = round(time.monotonic() - begin, 3)
            if not is_complete(staged):
                if not all(path.exists() for path in self.paths):  # a later call tries again
                    return self._end("failed", **found)
                return self._fail(staged=staged, **found)
            if self.how.get("tracks"):
                found = _joined(found, _link(staged))
            state = self.results.publish(self.target, attempt, staged, self.seen)
            if state == "replaced":
                found["error"] = "another run published results of another input meanwhile"
            found["publish_s"] = round(time.monotonic() - begin - found["run_s"], 3)
            return self._end(state, **found)

    def _run(self, staged: Path) -> dict[str, Any]:
        """Run the engine and return entries of the outcome; ``error`` has errors of the log."""
        from jaxdet import engine

        given = {**self.how, "name": self.log["log"], "about": self._about()}
        given["remarks"] = self.log.get("remarks")
        try:
            found = engine.run_one(list(map(str, self.paths)), staged, given)
        except (ConfigError, OutputError, WorkerStartError):
            raise  # the log is not the cause
        except JaxdetError as error:
            return {"error": self._renamed(str(error), self.paths)}
        except Exception as error:
            return {"error": f"an error in jaxdet itself ({type(error).__name__}: {error})"}
        if is_complete(staged):
            return self._reported(read_json(staged / SUMMARY))
        error = self._renamed(found["error"], self.paths)
        return {"error": error, "warnings": found["warnings"]}

    def _reported(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        """Return entries of the outcome from the ``summary.json`` of a log."""
        logs = summary.get("logs", ())
        paths = [Path(path) for log in logs for path in log["paths"]]
        lost = [frames for log in logs for frames in log["lost"]]
        errors = [line for line in problems(summary) if line not in lost] if logs else []
        return {
            "error": self._renamed("; ".join(errors), paths) or None,
            "frames": summary.get("frames", 0),
            "obstacles": summary.get("obstacles", 0),
            "lost": lost,
            "warnings": [warning for log in logs for warning in log["warnings"]],
        }

    def _end(self, state: str, **values: Any) -> dict[str, Any]:
        """Set the outcome, and return it."""
        about = {"log": self.log["log"], "name": self.log["name"], "bytes": size_of(self.log)}
        fetch_s = round(self.fetch_s, 3)
        self.outcome = {**_OUTCOME, **about, "state": state, "fetch_s": fetch_s, **values}
        return self.outcome

    def _fail(self, error: str, staged: Path | None = None, **values: Any) -> dict[str, Any]:
        """Publish the reason why the log has no results: ``failed.json``, if ``staged`` has one."""
        if staged and (staged / FAILED).exists():
            text = (staged / FAILED).read_text("utf-8")
            content = json.loads(self._renamed(text, self.paths, in_json=True))
        else:
            from jaxdet.results.manifest import fingerprint

            inputs = [fingerprint(Path(file["key"])) for file in self.log["files"]]
            run = self.how["record"].removesuffix(self.how["overwrites"])
            about = {"log": self.log["log"], "inputs": inputs, "run": run, **self._about()}
            content = failure_record(about, [LogSummary(self.log["log"], (), error=error)])
        content["attempts"] = self.attempts + max(1, sum(self._deaths()))
        content["command"] = self.how["command"]
        if self.seen.kept:
            self.results.note_failure(self.target, content)
        else:
            self.results.fail(self.target, content, self.seen, staged)
        return self._end("failed", error=error, **values)

    def _deaths(self) -> tuple[int, int]:
        """Return the numbers of killed and of lost attempts at the log.

        With a driver such as Ray's, which may end all tasks of a command, only the attempts of the
        current command count.
        """
        command = self.how["command"] if self.how.get("driven") else None
        return self.results.deaths(self.target, command)

    def _about(self) -> dict[str, Any]:
        """Return additional entries of the manifest: the log's files, and the last overwrite."""
        log, overwrites = self.log, self.how["overwrites"]
        about: dict[str, Any] = {"overwrites": overwrites} if overwrites else {}
        if log["url"]:
            about["fetched"] = [
                {"path": f"{log['url']}/{entry.key}", "size": entry.size, **entry.tag}
                for entry in entries_of(log)
            ]
        return about

    def _renamed(self, text: str, paths: Sequence[Path], *, in_json: bool = False) -> str:
        """Replace the paths of the log's local copy in a text by addresses."""
        url = self.log["url"]
        origin = f"{url}/{self.log['files'][0]['key']}".rpartition("/")[0]
        origin = json.dumps(origin, ensure_ascii=False)[1:-1] if in_json else origin
        for copy in {path.parent for path in paths if url}:
            text = text.replace(str(copy), origin)
        return text

    def _add_tracks(self) -> str | None:
        """Add missing tracks to results; return the error if that fails."""
        results, name, attempt = self.results, self.target.name, secrets.token_hex(6)
        if not self.how.get("tracks") or TRACKS in results.files(name):
            return None
        spool = Spool(self.how.get("spool"))
        staged = results.stage(attempt, spool.path, name)
        try:
            error = _link(download(results.place.url, name, staged))
            if error is None:
                results.publish(self.target, attempt, staged, self.seen)
            return error
        except InputError as error:  # another machine may have published results with tracks
            return None if TRACKS in results.files(name) else str(error)
        finally:
            remove(staged.parent)
            spool.close()


_MOST_NAME = 255
"""Maximum length of a file name [bytes]."""
_OUTCOME = {"error": None, "frames": 0, "obstacles": 0, "lost": [], "warnings": []}
_OUTCOME |= {"fetch_s": 0.0, "run_s": 0.0, "publish_s": 0.0}


def _joined(values: dict[str, Any], error: str | None) -> dict[str, Any]:
    """Add an error to the entries of an outcome."""
    errors = filter(None, (values["error"], error))
    return {**values, "error": "; ".join(errors) or None}


def _link(folder: Path) -> str | None:
    """Add tracks to results on local disk; return the error if that fails."""
    from jaxdet.tracks import TrackConfig
    from jaxdet.tracks.folder import add_tracks

    try:
        add_tracks(folder, TrackConfig())
    except InputError as error:
        return f"has no tracks: {error}"
    return None


def _fetch(log: Log, folder: Path, stop: Event) -> list[Path]:
    """Copy a log of a bucket to a folder; return the paths of its recordings on local disk."""
    entries = entries_of(log)
    if not log["url"]:
        paths = [Path(entry.key) for entry in entries]
        if not all(path.exists() for path in paths):
            raise InputError("is not on this machine", path=str(paths[0]))
        return paths
    place = open_place(log["url"])
    assert isinstance(place, Bucket)
    paths = [folder / "log" / Path(entry.key).name for entry in entries]
    if long := [path.name for path in paths if len(os.fsencode(path.name)) > _MOST_NAME]:
        problem = f"a name of more than {_MOST_NAME} bytes can't be on local disk"
        raise InputError(problem, path=f"{log['url']}/.../{long[0][:40]}...")
    with writing(folder):
        paths[0].parent.mkdir()
    for entry, path in zip(entries, paths, strict=True):
        place.fetch(entry, path, stop)
    return [path for path in paths if path.name != METADATA]


def prepare(place: str, how: Mapping[str, Any]) -> dict[str, Any]:
    """Compare a run with the ``run.json`` at its address, or create it; called once per run.

    Returns:
        The argument ``how``, completed by ``record``, ``overwrites`` and ``command``, which are the
        same on all machines of a run.

    Raises:
        ConfigError: The address has results of another configuration or version, the store ignores
            conditional writes, or this machine's versions differ from the run's.
    """
    from jaxdet.engine.runner import record_of
    from jaxdet.results.record import difference, digest

    url, how, own = address(place), dict(how), record_of(how)
    if "record" in how:
        if digest(own) + how["overwrites"] != how["record"]:
            problem = "this machine's jaxdet, or a package that results depend on, is another one"
            raise ConfigError(problem, path=url, remedy="install the same versions everywhere")
        return how
    at = open_place(url)
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
