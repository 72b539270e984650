"""How a run is made; every field is a flag of ``jaxdet run``."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from jaxdet.errors import ConfigError
from jaxdet.memory import parse_size

MAX_WORKERS = 1024
"""Processes; more than machines have cores."""
_SHARE = re.compile(r"(\d{1,6})/(\d{1,6})", re.ASCII)


@dataclass(frozen=True)
class RunOptions:
    """How to run; nothing here changes a byte of the two tables."""

    output: Path = field(metadata={"takes": "DIR"})
    """Folder for the results."""
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
    parts: str | None = field(default=None, metadata={"takes": "URL"})
    """Where machines share a run's parts: a folder (or s3://BUCKET/PATH). See jaxdet help runs."""
    share: str | None = field(default=None, metadata={"takes": "K/N"})
    """Do the K-th of N shares alone and leave it in --parts; all of them are joined without."""
    pictures: int = 8
    """Frames of each log to draw, evenly spaced."""
    overwrite: bool = False
    """Replace the results in the output folder."""
    update: bool = False
    """Add new, changed and failed logs to the results that are there."""

    def __post_init__(self) -> None:
        if self.batch_size is not None and self.batch_size < 1:
            raise ConfigError(f"batches of {self.batch_size}", remedy="give --batch-size 1 or more")
        if self.memory is not None:
            parse_size(self.memory, "--memory")
        if self.share is not None:
            number, of = self.share_numbers
            if not 1 <= number <= of:
                remedy = "give one from 1/4 to 4/4 to each of four machines, for instance"
                raise ConfigError(f"--share {self.share} is no share", remedy=remedy)
            if self.parts is None:
                raise ConfigError("--share without a place for it", remedy="give --parts as well")
        if self.update and (self.overwrite or self.parts):
            other = "--overwrite" if self.overwrite else "--parts"
            raise ConfigError(f"--update with {other}", remedy="give one of them")
        if self.pictures < 0:
            raise ConfigError(f"{self.pictures} pictures", remedy="give --pictures 0 or more")
        if self.workers is not None and not 1 <= self.workers <= MAX_WORKERS:
            remedy = f"give --workers from 1 to {MAX_WORKERS}"
            raise ConfigError(f"{self.workers} workers", remedy=remedy)

    @property
    def share_numbers(self) -> tuple[int, int]:
        """Which share this run does, from 1, and of how many; (0, 0): none that there can be."""
        found = _SHARE.fullmatch(self.share or "")
        return (int(found[1]), int(found[2])) if found else (0, 0)
