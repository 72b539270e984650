"""Settings of a run: its configuration, its options, and their record for ``run.json``."""

import pickle
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.config import Config
from jaxdet.engine.options import RunOptions
from jaxdet.engine.plan import Observer
from jaxdet.errors import ConfigError
from jaxdet.results.record import digest, make_record

if TYPE_CHECKING:
    from jaxdet.io import LogOptions

_VERSIONS = ("jaxdet", "source", "versions")


class RunSettings(NamedTuple):
    """Settings that all logs of a run share; they are sent to worker processes."""

    config: Config
    log_options: "LogOptions"
    options: RunOptions
    observers: Mapping[str, Observer]
    record: Mapping[str, Any]
    """Content of ``run.json``, see :func:`jaxdet.results.record.make_record`."""
    about: Mapping[str, Any]
    """Entries of each log's manifest: versions, and ``run``, the digest of the record."""


def make_settings(
    config: Config,
    log_options: "LogOptions",
    options: RunOptions,
    preset: str | None,
    observers: Mapping[str, Observer] | None = None,
    about: Mapping[str, Any] | None = None,
) -> RunSettings:
    """Return the settings of a run.

    Args:
        config: Configuration.
        log_options: Options of reading logs.
        options: Options of the run.
        preset: Name of the preset that the configuration started from.
        observers: See :meth:`jaxdet.Runner.run`.
        about: Additional entries of the logs' manifests.

    Raises:
        ConfigError: Observers can't be sent to other processes.
    """
    observers = observers or {}
    _check_observers(observers)
    record = make_record(
        config,
        log_options,
        preset,
        backend=options.backend,
        pictures=options.pictures,
        map=options.map,
        observers=observers,
    )
    versions = {name: record["about"][name] for name in _VERSIONS}
    about = {**versions, **(about or {}), "run": digest(record)}
    return RunSettings(config, log_options, options, observers, record, about)


def _check_observers(observers: Mapping[str, Observer]) -> None:
    try:
        pickle.dumps(dict(observers))
    except Exception as error:
        problem = f"observers can't be sent to other processes ({error})"
        raise ConfigError(problem, remedy="define their classes in a module") from error
