"""What a check of results has found."""

from dataclasses import dataclass, field
from typing import NamedTuple


class Finding(NamedTuple):
    """Something that is not as it should be."""

    check: str
    """``files``, ``tables``, ``tracks``, ``log`` or ``sample``."""
    where: str
    """A file of the results, a log or a file of it."""
    problem: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


@dataclass
class Report:
    """What was looked at, and what was found."""

    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What could not be looked at, and what is worth knowing."""
    files: int = 0
    """Files whose checksums were computed."""
    frames: int = 0
    """Rows of ``frames.parquet`` that were read."""
    obstacles: int = 0
    """Rows of ``obstacles.parquet`` that were read."""
    linked: int = 0
    """Obstacles that were linked again."""
    frames_of_logs: int = 0
    """Frames whose stamps and poses were compared with their log's."""
    frames_again: int = 0
    """Frames whose rows were computed again."""

    prefix: str = ""
    """What names of files begin with: the folder of a log."""

    def add(self, check: str, where: str, problem: str) -> None:
        """Note something that is not as it should be."""
        named = check in ("files", "tracks") or where.endswith(".parquet")
        inside = named and self.prefix and not where.startswith("/")
        self.findings.append(Finding(check, f"{self.prefix}/{where}" if inside else where, problem))

    def of(self, log: str) -> "Report":
        """Return the report itself, from now on of the folder of a log."""
        self.prefix = log
        return self
