"""Options of a run."""

from dataclasses import dataclass, field
from typing import Literal

from jaxdet.errors import ConfigError
from jaxdet.memory import parse_size

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
        if self.batch_size is not None and self.batch_size < 1:
            raise ConfigError(f"batches of {self.batch_size}", remedy="give --batch-size 1 or more")
        if self.memory is not None:
            parse_size(self.memory, "--memory")
        if self.update and self.overwrite:
            raise ConfigError(
                "--update and --overwrite exclude each other", remedy="give one of them"
            )
        if self.pictures < 0:
            raise ConfigError(f"{self.pictures} pictures", remedy="give --pictures 0 or more")
        if self.workers is not None and not 1 <= self.workers <= MAX_WORKERS:
            remedy = f"give --workers from 1 to {MAX_WORKERS}"
            raise ConfigError(f"{self.workers} workers", remedy=remedy)
