"""Settings of a run: its configuration, its options, and their record for ``run.json``."""

import pickle
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from jaxdet.config import Config
from jaxdet.engine.memory import Memory
from jaxdet.engine.options import RunOptions
from jaxdet.errors import ConfigError
from jaxdet.results.record import digest, make_record
from jaxdet.types import Detections

if TYPE_CHECKING:
    from jaxdet.io import Batch, LogOptions

_VERSIONS = ("jaxdet", "source", "versions")


class Observer(Protocol):
    """Callback that gets each batch with its detections, for instance to compare with ground truth.

    The observer is pickled and sent to the processes that work on a log. Its results may depend
    only on the log and on the observer's public attributes, which are part of the run's record. If
    it has an attribute ``needs_color`` that is True, colour images are read for every frame.
    """

    def __call__(self, batch: "Batch", found: Detections, /) -> Any:
        """Return a picklable result for a batch, whose detections ``found`` are NumPy arrays."""
        ...

    def summary(self, seen: Sequence[Any], /) -> Any:
        """Return the entry of a log in ``summary.json``, from the results for its batches."""
        ...


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
    observers: Mapping[str, Observer] = MappingProxyType({}),
    about: Mapping[str, Any] = MappingProxyType({}),
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
        ConfigError: Observers can't be sent to other processes, or there is too little memory for
            any log.
    """
    observers = dict(observers)
    try:
        pickle.dumps(observers)
    except Exception as error:
        problem = f"observers can't be sent to other processes ({error})"
        raise ConfigError(problem, remedy="define their classes in a module") from error
    Memory(options.memory, 1)
    given = {"backend": options.backend, "pictures": options.pictures, "map": options.map}
    record = make_record(config, log_options, preset, **given, observers=observers)
    versions = {name: record["about"][name] for name in _VERSIONS}
    about = {**versions, **about, "run": digest(record)}
    return RunSettings(config, log_options, options, observers, record, about)
