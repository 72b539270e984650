"""What decides a run's results: written before anything is worked on, and compared to go on."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jaxdet
from jaxdet.config import Config
from jaxdet.engine.options import RunOptions
from jaxdet.engine.plan import Observer
from jaxdet.errors import JaxdetError
from jaxdet.results.manifest import fingerprint, read_manifest
from jaxdet.results.summary import plain
from jaxdet.results.versions import source_digest, versions

if TYPE_CHECKING:
    from jaxdet.io import LogFiles, LogOptions


def make_record(
    logs: Sequence["LogFiles"],
    config: Config,
    log_options: "LogOptions",
    options: RunOptions,
    observers: Mapping[str, Observer],
    preset: str | None,
) -> dict[str, Any]:
    """The record of a run; arguments as of :func:`jaxdet.engine.run`.

    Workers and batches are not in it, as they change no result.

    Returns:
        What JSON can hold: ``about``, which goes into the manifest of the results, with versions,
        inputs, the number of pictures and what they are compared with, and ``config``, most of
        ``config.json``.
    """
    inputs = {log.name: [fingerprint(path) for path in log.paths] for log in logs}
    which = {"jaxdet": jaxdet.__version__, "source": source_digest(), "versions": versions()}
    chosen = {"preset": preset, "backend": options.backend, **plain(config)}
    chosen["log"] = plain(log_options)
    observed = {name: {type(one).__name__: plain(_public(one))} for name, one in observers.items()}
    about = {**which, "inputs": inputs, "pictures": options.pictures, "observed": observed}
    record = {"about": about, "config": chosen}
    return json.loads(json.dumps(record, default=lambda value: type(value).__name__))


def _public(observer: Observer) -> dict[str, Any]:
    """The attributes of an observer that decide what it says."""
    return {name: value for name, value in vars(observer).items() if not name.startswith("_")}


def inputs_of(
    record: Mapping[str, Any], log: "LogFiles"
) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """The files of a log, each with its fingerprint as the record has it."""
    yield from zip(log.paths, record["about"]["inputs"][log.name], strict=True)


def digest(record: Mapping[str, Any]) -> str:
    """A checksum of a record: two runs with the same one make the same results."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """The first thing in which two records differ, for people; None: in nothing."""
    old, new = dict(_flat(before)), dict(_flat(now))
    keys = [key for key in {**old, **new} if old.get(key, _NOT) != new.get(key, _NOT)]
    if not keys:
        return None
    key = keys[0]
    if key[:2] == ("about", "inputs"):
        return _of_inputs(before["about"]["inputs"], now["about"]["inputs"])
    was, is_now = (_said(values.get(key, _NOT)) for values in (old, new))
    name = ".".join(part for part in key if part not in ("about", "config"))
    name = "jaxdet's own code" if key == ("about", "source") else name
    return f"{name} was {was} and is {is_now} now"


def difference_but_logs(before: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """The first thing beside the logs in which two records differ, likewise."""
    about = {**before["about"], "inputs": now["about"]["inputs"]}
    return difference({**before, "about": about}, now)


def record_of_results(folder: Path, like: Mapping[str, Any]) -> dict[str, Any] | None:
    """The record of whole results.

    Args:
        folder: Where they are.
        like: Another record, of this version.

    Returns:
        As of :func:`make_record`; None: they are not whole, or of another version.
    """
    try:
        manifest = read_manifest(folder)
        config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        about = {name: manifest[name] for name in like["about"]}
        return {"about": about, "config": {name: config[name] for name in like["config"]}}
    except (JaxdetError, OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


_NOT = object()


def _flat(value: Any, *key: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The values of nested mappings with their keys."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _flat(part, *key, name)
    else:
        yield key, value


def _said(value: Any) -> str:
    return "not set" if value is _NOT or value is None else json.dumps(value, ensure_ascii=False)


def _of_inputs(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """How the inputs differ."""
    for log, files in now.items():
        if log not in before:
            return f"the log {log} was not among its logs"
        for was, is_now in zip(before[log], files, strict=False):
            if was != is_now:
                changed = Path(was["path"]) == Path(is_now["path"])
                return f"{is_now['path']} {'has changed' if changed else 'was ' + was['path']}"
        if len(before[log]) != len(files):
            return f"{log} had {len(before[log])} files and has {len(files)} now"
    missing = next(log for log in before if log not in now)
    return f"the log {missing} was among its logs"
