"""Text files in folders of images."""

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from jaxdet.errors import InputError
from jaxdet.io.message_fields import MAX_ROS2_STAMP_S

SECOND = 1_000_000_000
_MAX_BYTES = 64 << 20


def read_text(path: Path) -> str:
    """Read a text file; invalid bytes are replaced.

    Raises:
        InputError: The file has more than 64 MiB.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise InputError("the file is too large", path=str(path), remedy="split the recording")
    return path.read_text("utf-8", "replace")


def read_table(path: Path, columns: int) -> list[list[str]]:
    """Return the first words of each line; comments start with ``#``.

    Raises:
        InputError: A line has fewer columns.
    """
    lines = read_text(path).replace(",", " ").splitlines()
    rows = [words for line in lines if (words := line.partition("#")[0].split())]
    for words in rows:
        if len(words) < columns:
            problem = f"expected lines of {columns} columns, got {len(words)}"
            raise InputError(problem, path=str(path), remedy="correct it")
    return [words[:columns] for words in rows]


def read_matrix(path: Path, rows: int) -> np.ndarray:
    """Read a square matrix ``(rows, rows)`` float64.

    Raises:
        InputError: The file has something else.
    """
    try:
        return np.array(read_table(path, rows), np.float64).reshape(rows, rows)
    except ValueError as error:
        problem = f"expected {rows} rows of {rows} numbers"
        raise InputError(problem, path=str(path), remedy="correct it") from error


def nanoseconds(text: str, path: Path) -> int:
    """Convert a timestamp in seconds to nanoseconds, exactly.

    Raises:
        InputError: The text is not a timestamp of ROS 2; the error names ``path``.
    """
    problem = f"timestamp {text[:40]!a} is out of range"
    try:
        found = Decimal(text)
        if 0 <= found < MAX_ROS2_STAMP_S:
            return int(found * SECOND)
    except InvalidOperation:  # not a number, or NaN
        problem = f"expected a timestamp in seconds, got {text[:40]!a}"
    raise InputError(problem, path=str(path), remedy="correct it")
