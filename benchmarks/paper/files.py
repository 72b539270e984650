"""Files from which a stopped run continues: simulated frames and the results of tasks."""

import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import zstandard


def save(path: Path, value: Any) -> None:
    """Write a value to a file that is complete or absent."""
    part = path.with_suffix(".part")
    part.write_bytes(zstandard.compress(pickle.dumps(value, protocol=5), 1))
    part.rename(path)


def load(path: Path) -> Any:
    """Return the value in a file that :func:`save` wrote."""
    return pickle.loads(zstandard.decompress(path.read_bytes()))


class KeptTask(NamedTuple):
    """Task whose result is stored in a file."""

    folder: Path
    function: Callable[[Any], Any]
    item: Any
    """Argument of the function; items are equal if their ``repr`` is."""


def run_kept(task: KeptTask) -> Any:
    """Return the result of a task; it is computed unless its file exists."""
    name = f"{task.function.__module__}.{task.function.__qualname__}"
    key = hashlib.sha256(f"{name} {task.item!r}".encode()).hexdigest()[:24]
    path = task.folder / f"{key}.result"
    if path.exists():
        return load(path)
    result = task.function(task.item)
    save(path, result)
    return result


def fingerprint(*folders: Path) -> str:
    """Return a checksum of the source files and tables in some folders, or of files."""
    files = [f for each in folders for f in ([each] if each.is_file() else each.rglob("*"))]
    suffixes = {".py", ".h", ".npz", ".json", ".txt", ".toml"}
    sources = sorted(f for f in files if f.suffix in suffixes and "__pycache__" not in f.parts)
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]
