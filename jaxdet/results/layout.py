"""Layout of results: a folder for each log, with a file that marks it as complete.

::

    RESULTS/
      run.json            configuration and versions of all logs, written once
      known_map.yaml known_map.png  map that was passed to jaxdet track --map
      drive_1/            a log, see jaxdet.results.names.log_name
        frames.parquet obstacles.parquet summary.json config.json
        map.npz map.png pictures/000012.png
        tracks.parquet track_links.parquet tracks.png
        manifest.json     size and SHA-256 of the other files; without it results are not complete
      drive_2/
        failed.json       why the log has no results, and how often it was tried
      .jaxdet/            files of a command that writes here, while it runs
        lock
        aside-1a2b/drive_1/ old results, moved aside while RESULTS/drive_1 is replaced

Readers also find the results that are moved aside, see :mod:`jaxdet.results.durable`.
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
REPORT = "report.txt"
"""End of the name of a crash report, in the folder of a log that failed by a bug in jaxdet."""
WORKING, ASIDE = ".jaxdet", "aside-"
"""Folder of a command that writes results, and prefix of folders in it with results moved aside."""
FLEET = ".fleet"
"""Folder in results for notes of machines that share a run, see jaxdet.fleet.publish."""


def log_folders(results: Path) -> dict[str, Path]:
    """Return the folders of complete and of failed logs, by name and in order of the names."""
    while True:
        aside = set((results / WORKING).glob(f"{ASIDE}*"))
        found = {path.name: path for place in (*aside, results) for path in _with_results(place)}
        # A folder that was moved aside meanwhile may be missing in the listing.
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
    """Return whether a folder holds the results of a run, with a folder for each log."""
    return (folder / RUN).is_file()


def check_folder(folder: Path) -> None:
    """Check that a path is a folder, with or without results.

    Raises:
        InputError: The folder is missing, or is a file.
    """
    if not folder.is_dir():
        problem = "a file, not a folder of results" if folder.exists() else "no such folder"
        remedy = "name the folder that jaxdet run --output wrote"
        if ":/" in str(folder):
            remedy = "copy results from a bucket to a folder first, see jaxdet help fleets"
        raise InputError(problem, path=str(folder), remedy=remedy)
