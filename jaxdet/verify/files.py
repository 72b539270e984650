"""The files of a results folder against its manifest."""

from pathlib import Path
from typing import Any

from jaxdet.errors import InputError, printable
from jaxdet.results.commit import JOURNAL
from jaxdet.results.durable import sha256
from jaxdet.results.manifest import MANIFEST, WORKING, is_like_result, read_manifest
from jaxdet.verify.report import Report


def check_files(folder: Path, report: Report) -> dict[str, Any]:
    """Finds files that are missing, changed, or among the results and not of them.

    Args:
        folder: The results folder.
        report: Gets what is found.

    Returns:
        The manifest; empty where it can't be trusted.
    """
    if (folder / WORKING / JOURNAL).is_file():
        problem = "a command was stopped while its files moved here; repeat it"
        report.add("files", WORKING, problem)
    elif (folder / WORKING).is_dir():
        report.notes.append("a run that will replace these results goes on here, or was stopped")
    try:
        manifest = read_manifest(folder)
    except InputError as error:
        report.add("files", MANIFEST, error.problem)
        return {}
    for name, about in manifest["files"].items():
        _check_file(folder, name, about, report)
    for name in sorted(_files(folder) - manifest["files"].keys() - {MANIFEST}):
        if name.endswith(".parquet") or is_like_result(name):
            report.add("files", printable(name), "is not in the manifest")
        else:
            report.notes.append(f"{printable(name)} is no file of the results")
    return manifest


def _check_file(folder: Path, name: str, about: dict[str, Any], report: Report) -> None:
    path = folder / name
    try:
        size, digest = path.stat().st_size, sha256(path)
    except FileNotFoundError:
        report.add("files", name, "is missing")
    except OSError as error:
        report.add("files", name, f"can't be read ({error.strerror})")
    else:
        report.files += 1
        if size != about["size"]:
            report.add("files", name, f"has {size} bytes, {about['size']} were written")
        elif digest != about["sha256"]:
            report.add("files", name, "was changed: its SHA-256 is not that of the manifest")


def _files(folder: Path) -> set[str]:
    """Names of all files in a folder but those of an unfinished run."""
    found = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file() or p.is_symlink())
    return {path.as_posix() for path in found if path.parts[0] != WORKING}
