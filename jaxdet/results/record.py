"""Record of a run in ``run.json``: the configuration and versions that decide all results."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import jaxdet
from jaxdet.config import Config
from jaxdet.results.json_files import plain
from jaxdet.results.versions import source_digest, versions

if TYPE_CHECKING:
    from jaxdet.io import LogOptions


def make_record(
    config: Config,
    log_options: "LogOptions",
    preset: str | None,
    *,
    backend: str,
    pictures: int,
    map: bool,
    observers: Mapping[str, object],
) -> dict[str, Any]:
    """Return the content of ``run.json``; for the arguments see :meth:`jaxdet.Runner.run`.

    Workers and batches are left out, as they change no result.

    Returns:
        Values for JSON: ``about`` with versions, pictures, map and observers, and ``config``, the
        content of ``config.json`` without the batch size.
    """
    which = {"jaxdet": jaxdet.__version__, "source": source_digest(), "versions": versions()}
    chosen = {"preset": preset, "backend": backend, **plain(config)}
    chosen["log"] = plain(log_options)
    observed = {name: {type(one).__name__: plain(_public(one))} for name, one in observers.items()}
    drawn = {"pictures": pictures, "map": map}
    record = {"about": {**which, **drawn, "observed": observed}, "config": chosen}
    return json.loads(json.dumps(record, default=lambda value: type(value).__name__))


def _public(observer: object) -> dict[str, Any]:
    """Return the public attributes of an observer, which decide its results."""
    return {name: value for name, value in vars(observer).items() if not name.startswith("_")}


def digest(record: Mapping[str, Any]) -> str:
    """Return a checksum of a record; runs with equal checksums make equal results of a log."""
    return hashlib.sha256(json.dumps(_own(record), sort_keys=True).encode()).hexdigest()


def difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Return a text with the first difference of two records; None if they are equal."""
    old, new = dict(_flat(_own(before))), dict(_flat(_own(now)))
    keys = [key for key in {**old, **new} if old.get(key, _NOT) != new.get(key, _NOT)]
    if not keys:
        return None
    key = keys[0]
    was, is_now = (_text(values.get(key, _NOT)) for values in (old, new))
    name = ".".join(part for part in key if part not in ("about", "config"))
    name = "jaxdet's own code" if key == ("about", "source") else name
    return f"{name} was {was} and is {is_now} now"


_NOT = object()


def _own(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries that decide results; the ``run.json`` of a fleet has further entries."""
    return {name: record.get(name) for name in ("about", "config")}


def _flat(value: Any, *key: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the values of nested mappings with their keys."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _flat(part, *key, name)
    else:
        yield key, value


def _text(value: Any) -> str:
    return "not set" if value is _NOT or value is None else json.dumps(value, ensure_ascii=False)
