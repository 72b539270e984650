"""Layout of results: a folder for each log, with a file that marks it as complete.

::

    RESULTS/
      run.json            configuration and versions of all logs, written once
      drive_1/            a log, see jaxdet.results.names.log_name
        frames.parquet obstacles.parquet summary.json config.json
        map.npz map.png pictures/000012.png
        tracks.parquet track_links.parquet tracks.png
        manifest.json     size and SHA-256 of the others: a folder without it is not a result
      drive_2/
        failed.json       why the log has no results, and how often it was tried
      .jaxdet/            files of a command that writes here, while it runs
        lock
        aside-1a2b/drive_1/ moved aside while RESULTS/drive_1 is replaced

Readers find a log's folder there too, see :mod:`jaxdet.results.durable`.
"""

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError
from jaxdet.results.shapes import AGAIN, LOGS, check_shape

RUN, MANIFEST, FAILED = "run.json", "manifest.json", "failed.json"
SUMMARY, CONFIG = "summary.json", "config.json"
FRAMES, OBSTACLES = "frames.parquet", "obstacles.parquet"
TRACKS, LINKS = "tracks.parquet", "track_links.parquet"
"""Tables that ``jaxdet track`` adds to a log's folder."""
WORKING, ASIDE = ".jaxdet", "aside-"
"""Folder of a command that writes results, and the beginning of names in it."""
FLEET = ".fleet"
"""Folder in results for notes of machines that share a run, see jaxdet.fleet.publish."""


def log_folders(results: Path) -> dict[str, Path]:
    """Return the folders of logs by their names, complete and failed ones, in order."""
    while True:
        aside = set((results / WORKING).glob(f"{ASIDE}*"))
        found = {path.name: path for place in (*aside, results) for path in _with_results(place)}
        # A folder that is moved aside meanwhile would be missing.
        if set((results / WORKING).glob(f"{ASIDE}*")) <= aside:
            return dict(sorted(found.items()))


def _with_results(folder: Path) -> Iterator[Path]:
    try:
        names = [entry.name for entry in os.scandir(folder) if entry.name != WORKING]
    except (FileNotFoundError, NotADirectoryError):
        return
    for path in (folder / name for name in names):
        if is_complete(path) or (path / FAILED).is_file():
            yield path


def is_complete(folder: Path) -> bool:
    """Return whether a folder holds the complete results of a log."""
    return (folder / MANIFEST).is_file()


def is_run(folder: Path) -> bool:
    """Return whether a folder is that of a run, with a folder for each log."""
    return (folder / RUN).is_file()


def check_folder(folder: Path) -> None:
    """Check that there is a folder, which may hold results.

    Raises:
        InputError: It is missing, or a file.
    """
    if not folder.is_dir():
        problem = "a file, not a folder of results" if folder.exists() else "no such folder"
        remedy = "name the folder that jaxdet run --output wrote"
        raise InputError(problem, path=str(folder), remedy=remedy)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file of results.

    Raises:
        InputError: It is missing, can't be read, or holds no JSON object.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        problem = f"has no complete results ({path.name} is missing)"
        raise InputError(problem, path=str(path.parent), remedy=AGAIN) from error
    except OSError as error:
        raise unread(path, error) from error
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON", path=str(path), remedy=AGAIN) from error
    if not isinstance(found, dict):
        raise InputError("is not a JSON object", path=str(path), remedy=AGAIN)
    return found


def unread(path: Path, error: OSError) -> InputError:
    """Return the error for a file that the system can't read."""
    problem = f"can't be read ({os.strerror(error.errno or 0)})"
    return InputError(problem, path=str(path), remedy="check its permissions and its disk")


def leads_out(name: str) -> bool:
    """Return whether the name of a results file points outside of its folder."""
    return Path(name).is_absolute() or ".." in Path(name).parts or "\0" in name


def entries_of(content: Mapping[str, Any], where: Path) -> list[dict[str, Any]]:
    """Return the entries of a log's cameras in ``summary.json`` or ``failed.json``.

    Raises:
        InputError: They have another shape than jaxdet writes.
    """
    check_shape(content, LOGS, where)
    logs: list[dict[str, Any]] = content["logs"]
    for entry in logs:
        names = [entry["file_name"] or "", entry["map"] or "", *entry["pictures"]]
        if not (entry["error"] or entry["camera"]) or any(map(leads_out, names)):
            raise InputError("is not as jaxdet writes it", path=str(where), remedy=AGAIN)
    return logs


def check_regular(folder: Path) -> None:
    """Check that a folder of results holds files and folders only.

    Raises:
        InputError: It holds a pipe, a device or a socket, or a link to one.
    """
    for path in folder.rglob("*"):
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError("is not a regular file", path=str(path), remedy="remove it")
