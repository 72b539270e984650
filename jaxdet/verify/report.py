"""Report of a check of results."""

from dataclasses import dataclass, field
from typing import NamedTuple


class Finding(NamedTuple):
    """A problem found in the results."""

    check: str
    """Name of the check: ``files``, ``tables``, ``tracks``, ``log`` or ``sample``."""
    where: str
    """Name of the file in the results, of the log, or of the log's file."""
    problem: str
    """Description of the problem."""

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


@dataclass
class Report:
    """Findings of a check, with counts of what was checked."""

    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Remarks, and parts that could not be checked."""
    files: int = 0
    """Number of files whose checksums were computed."""
    frames: int = 0
    """Number of rows read from ``frames.parquet``."""
    obstacles: int = 0
    """Number of rows read from ``obstacles.parquet``."""
    linked: int = 0
    """Number of obstacles that were linked again."""
    frames_of_logs: int = 0
    """Number of frames whose timestamps and poses were compared with the log."""
    frames_again: int = 0
    """Number of frames that were computed again."""

    prefix: str = ""
    """Prefix of file names: the folder of the current log."""

    def add(self, check: str, where: str, problem: str) -> None:
        """Add a finding."""
        named = check in ("files", "tracks") or where.endswith(".parquet")
        inside = named and self.prefix and not where.startswith("/")
        self.findings.append(Finding(check, f"{self.prefix}/{where}" if inside else where, problem))

    def of(self, log: str) -> "Report":
        """Set the folder of the current log, and return the report."""
        self.prefix = log
        return self
