"""Options of a run; every field is a flag of ``jaxdet run``."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from jaxdet.errors import ConfigError
from jaxdet.memory import parse_size

MAX_WORKERS = 1024
"""Largest number of processes; no machine has as many cores."""
OF_RUNNER = ("backend", "workers", "memory")
"""Options that are arguments of :class:`jaxdet.Runner`."""
OF_RUN = ("batch_size", "pictures", "map")
"""Options that are arguments of :meth:`jaxdet.Runner.run`."""
AGAIN = ("overwrite", "update")
"""More of these, which choose the logs that are done again."""


@dataclass(frozen=True)
class RunOptions:
    """How to run; nothing here changes a byte of the two tables."""

    output: Path = field(metadata={"takes": "DIR"})
    """Folder or s3://BUCKET/PATH for the results, a folder for each log."""
    backend: Literal["jax", "reference"] = "jax"
    """jax: compiled, on the GPU when there is one; reference: plain NumPy. Equal results."""
    batch_size: int | None = None
    """Frames computed together; changes no result. By default 16 on the CPU; 256 on a GPU, fewer
    where images are large."""
    workers: int | None = None
    """Processes to share the logs, or the frames of a log; changes no result. By default one a
    core; on the CPU one for a few short logs."""
    memory: str | None = field(default=None, metadata={"takes": "SIZE"})
    """Most memory of all processes together, 4GiB for instance. Fewer workers, smaller batches and
    less read ahead take less; changes no result. By default three quarters of the machine's, or of
    its control group's."""
    pictures: int = 8
    """Frames of each log to draw, evenly spaced."""
    map: bool = True
    """Make a map of each log that has poses."""
    overwrite: bool = False
    """Replace the results of the logs; also those of another configuration or version."""
    update: bool = False
    """Also do logs again that failed, lost frames or have changed since."""

    def __post_init__(self) -> None:
        if self.batch_size is not None and self.batch_size < 1:
            raise ConfigError(f"batches of {self.batch_size}", remedy="give --batch-size 1 or more")
        if self.memory is not None:
            parse_size(self.memory, "--memory")
        if self.update and self.overwrite:
            raise ConfigError("--update with --overwrite", remedy="give one of them")
        if self.pictures < 0:
            raise ConfigError(f"{self.pictures} pictures", remedy="give --pictures 0 or more")
        if self.workers is not None and not 1 <= self.workers <= MAX_WORKERS:
            remedy = f"give --workers from 1 to {MAX_WORKERS}"
            raise ConfigError(f"{self.workers} workers", remedy=remedy)
