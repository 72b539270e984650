"""What a file's own checks say about it."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from jaxdet.errors import printable


class FileIntegrity(NamedTuple):
    """What was read of a file, and what was lost."""

    path: Path
    messages: int = 0
    """Messages found."""
    declared_messages: int | None = None
    """Messages the file's statistics speak of; None without."""
    has_end: bool = True
    """Whether the data end and the file's closing magic are there."""
    chunks: int = 0
    chunks_with_crc: int = 0
    lost: Mapping[str, int] = {}
    """How many records or chunks were rejected, by reason."""
    lost_bytes: int = 0
    lost_spans_ns: tuple[tuple[int, int], ...] = ()
    """Log times of the rejected chunks, by their own word."""
    last_log_time_ns: int = 0
    """Of the messages found."""
    missing: Mapping[str, int] = {}
    """How many messages of each topic statistics or message indexes count that were not found."""
    summary_problem: str = ""
    """Why the file has no summary that can be read; empty where it has one."""
    by_index: bool = False
    """Whether the messages are those of the file's own index, not of a walk over the whole file.
    Then the chunks are checked when frames are read from them, and the first one's CRC stands for
    all."""

    @property
    def recovered(self) -> bool:
        """Whether something is missing."""
        declared = self.declared_messages
        counted = declared in (None, self.messages) and not self.missing
        return bool(self.lost) or not self.has_end or not counted

    @property
    def text(self) -> str:
        """One line for people."""
        if self.by_index and self.chunks_with_crc:
            return "has an index; the CRC of each chunk is checked when it is read"
        crc = f"CRC checked in {self.chunks_with_crc} of {self.chunks} chunks"
        crc = crc if self.chunks_with_crc else "not checkable (no CRC in file)"
        if self.summary_problem:
            crc += f"; nothing tells what is missing ({self.summary_problem})"
        if not self.recovered:
            return crc
        parts = [f"{self.messages} messages"]
        if self.declared_messages not in (None, self.messages):
            parts[0] += f" of the {self.declared_messages} declared"
        if self.lost:
            reasons = ", ".join(f"{reason} ({count})" for reason, count in self.lost.items())
            parts.append(f"{self.lost_bytes} bytes lost: {reasons}")
        for topic, count in [*self.missing.items()][:8]:
            parts.append(f"{count} messages of {printable(topic)} missing")
        for start, end in self.lost_spans_ns[:3]:
            parts.append(f"log time {_utc(start)} to {_utc(end)} lost")
        if not self.has_end:
            upto = f"; data up to {_utc(self.last_log_time_ns)}" if self.messages else ""
            parts.append(f"no end of file{upto}")
        parts.append(crc)
        return "recovered: " + "; ".join(parts)


def _utc(stamp_ns: int) -> str:
    whole, rest = divmod(stamp_ns, 1_000_000_000)
    try:
        text = datetime.fromtimestamp(whole, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    except (OverflowError, ValueError, OSError):
        return f"{stamp_ns} ns"
    return f"{text}.{rest // 1_000_000:03d}Z"
