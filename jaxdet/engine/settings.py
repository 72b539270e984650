"""Options of a run, its callbacks, and the settings that all its logs share."""

import os
import pickle
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

from jaxdet.arguments import check_fields
from jaxdet.config import Config
from jaxdet.engine.memory import Memory
from jaxdet.errors import ConfigError
from jaxdet.memory import parse_size
from jaxdet.results.record import digest, make_record
from jaxdet.results.summary import LogSummary
from jaxdet.types import Detections

if TYPE_CHECKING:
    from jaxdet.io import Batch, LogOptions

_VERSIONS = ("jaxdet", "source", "versions")

MAX_WORKERS = 1024
"""Maximum number of worker processes."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that do not change the tables of frames and obstacles.

    Each field is a flag of ``jaxdet run``, an argument of :func:`jaxdet.run` and
    :class:`jaxdet.Runner`, and a key of :func:`jaxdet.engine.run_one`.
    """

    backend: Literal["jax", "reference"] = "jax"
    """jax: compiled, on the GPU if there is one; reference: plain NumPy. Results are equal."""
    batch_size: int | None = None
    """Number of frames that are computed together; results do not depend on it. Default: 16 on the
    CPU; on a GPU 256, or fewer if images are large."""
    workers: int | None = None
    """Number of worker processes, which share logs, or frames of one log; results do not depend on
    it. Default: one per core; on the CPU, a single one for a few short logs."""
    memory: str | None = field(default=None, metadata={"takes": "SIZE"})
    """Maximum memory, for instance 4GiB, of all processes together. It changes no result: with less
    memory there are fewer workers and smaller batches. Default: three quarters of the memory of the
    machine, or of its control group."""
    pictures: int = 8
    """Number of frames of each log to draw, evenly spaced."""
    map: bool = True
    """Make a map of each log that has poses."""
    overwrite: bool = False
    """Replace existing results, even of another configuration or version."""
    update: bool = False
    """Process logs again that failed, lost frames or have changed since."""

    def __post_init__(self) -> None:
        if isinstance(self.workers, int) and not 1 <= self.workers <= MAX_WORKERS:
            remedy = f"pass --workers from 1 to {MAX_WORKERS}"
            raise ConfigError(f"{self.workers} workers", remedy=remedy)
        check_fields(self)
        if self.batch_size is not None and self.batch_size < 1:
            raise ConfigError(f"batches of {self.batch_size}", remedy="pass --batch-size 1 or more")
        if self.memory is not None:
            parse_size(self.memory, "--memory")
        if self.update and self.overwrite:
            raise ConfigError(
                "--update and --overwrite exclude each other", remedy="pass one of them"
            )
        if self.pictures < 0:
            raise ConfigError(f"{self.pictures} pictures", remedy="pass --pictures 0 or more")


class Progress(NamedTuple):
    """Progress of a run, passed to the progress callback before the first unit and after each."""

    log: str
    """Name of the log, followed by the camera's name if the log has several cameras."""
    log_number: int
    num_logs: int
    done: int
    """Number of frames of this log that are done."""
    total: int
    """Number of frames of this log."""
    bad: int
    """Number of frames of this log with another status than ok."""
    frames_per_s: float | None
    bottleneck: str = ""
    """Slowest step, see :attr:`jaxdet.results.summary.LogSummary.bottleneck`."""
    rates: Mapping[str, float] = MappingProxyType({})
    """Frames per second of each step if it were the only one."""
    doing: str = ""
    """Current work, for instance ``opening``, until the first unit is done; then empty."""
    logs_done: int = 0
    """Number of logs that are done."""
    logs_failed: int = 0
    """Number of logs that are done because they failed."""


ProgressCallback = Callable[[Progress], None]


Report = Callable[[LogSummary, str, int, str], None]
"""Function for the progress of a log: summary, label, number of frames, current work."""


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
    need_main: bool
    """Whether observers are defined in the main module, so that workers must import it."""


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
        need_main = b"__main__" in pickle.dumps(observers)
        if need_main and not os.path.isfile(vars(sys.modules["__main__"]).get("__file__", "")):
            raise TypeError("the program that defines them is not a file")
    except Exception as error:
        problem = f"observers can't be sent to other processes ({error})"
        raise ConfigError(problem, remedy="define their classes in a module") from error
    Memory(options.memory, 1)
    given = {"backend": options.backend, "pictures": options.pictures, "map": options.map}
    record = make_record(config, log_options, preset, **given, observers=observers)
    versions = {name: record["about"][name] for name in _VERSIONS}
    about = {**versions, **about, "run": digest(record)}
    return RunSettings(config, log_options, options, observers, record, about, need_main)
