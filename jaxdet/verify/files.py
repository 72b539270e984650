"""Check of the files of a log's results against its manifest."""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError, printable
from jaxdet.results.durable import sha256
from jaxdet.results.layout import MANIFEST
from jaxdet.results.manifest import read_manifest
from jaxdet.verify.report import Report

MOST_NAMED = 3
"""Maximum number of foreign files per folder that are listed by name; otherwise they are counted.
"""


def check_files(folder: Path, report: Report) -> dict[str, Any]:
    """Report files that are missing, changed, or not in the manifest.

    Args:
        folder: Folder of a log.
        report: Report to add to.

    Returns:
        The manifest; empty if it is missing or invalid.
    """
    try:
        manifest = read_manifest(folder)
    except InputError as error:
        report.add("files", MANIFEST, error.problem)
        return {}
    for name, about in manifest["files"].items():
        _check_file(folder, name, about, report)
    others = []
    for name in sorted(_files(folder) - manifest["files"].keys() - {MANIFEST}):
        if name.endswith(".parquet") or name.startswith(("map", "pictures/", "tracks")):
            report.add("files", printable(name), "not in the manifest")
        else:
            others.append(printable(name))
    report.notes += _notes(others)
    return manifest


def _notes(others: list[str]) -> Iterator[str]:
    """Yield a line per foreign file, or per folder with many of them (an export)."""
    for top, names in groupby(others, lambda name: name.partition("/")[0]):
        inside = list(names)
        if len(inside) > MOST_NAMED:
            yield f"{top}/ has {len(inside)} files that are not part of the results"
        else:
            yield from (f"{name} is not part of the results" for name in inside)


def _check_file(folder: Path, name: str, about: dict[str, Any], report: Report) -> None:
    path = folder / name
    try:
        size, digest = path.stat().st_size, sha256(path)
    except FileNotFoundError:
        report.add("files", name, "missing")
    except OSError as error:
        report.add("files", name, f"can't be read ({error.strerror})")
    else:
        report.files += 1
        if size != about["size"]:
            report.add("files", name, f"expected {about['size']} bytes, got {size}")
        elif digest != about["sha256"]:
            report.add("files", name, "changed: its SHA-256 differs from the manifest")


def _files(folder: Path) -> set[str]:
    """Return the names of all files in a folder."""
    found = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file() or p.is_symlink())
    return {path.as_posix() for path in found}
