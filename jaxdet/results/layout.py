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

import os
from collections.abc import Iterator
from pathlib import Path

from jaxdet.errors import InputError

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
