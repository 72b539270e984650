"""All checks of results, for the folder of a run or of a single log."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from filecmp import cmp
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jaxdet.errors import InputError, printable
from jaxdet.export.recordings import find, recorded
from jaxdet.io import LogFiles
from jaxdet.results.durable import sha256
from jaxdet.results.layout import (
    FAILED,
    FLEET,
    MANIFEST,
    RUN,
    TRACKS,
    WORKING,
    check_folder,
    is_complete,
    is_run,
)
from jaxdet.results.manifest import read_manifest
from jaxdet.results.reading import Results
from jaxdet.tracks.folder import is_track_file, tracking, write_tracks
from jaxdet.verify.logs import check_inputs, check_log
from jaxdet.verify.report import Report
from jaxdet.verify.tables import check_tables

SAMPLE = 8
"""Default number of frames per log that are computed again."""
MOST_NAMED = 3
"""Maximum number of foreign files per folder that are named; more are only counted."""


def verify(folder: Path, against: Sequence[str] = (), sample: int = SAMPLE) -> Report:
    """Check that results are complete, unchanged, consistent with their logs, and reproducible.

    Each file is compared with its checksum in the manifest of its log. All table rows are read: the
    tables must be in order, refer to each other correctly, agree with ``summary.json``, and have a
    row for every frame. Tracks are computed again and must be equal byte for byte. If a log is
    available, its files must be the files that the run read, and the timestamps and poses of
    all frames must be equal. A sample of frames is computed again by the NumPy reference, and their
    rows must be equal byte for byte.

    Args:
        folder: Results of a run, or the folder of one log in them.
        against: Files, folders and globs with the logs; other logs are expected at their original
            paths.
        sample: Number of frames per log to compute again, evenly spaced.

    Returns:
        Report; unreadable results are also findings, not exceptions.

    Raises:
        InputError: The folder does not exist, or ``against`` has a log that is not in the results.
    """
    check_folder(folder)
    report = Report()
    if not is_run(folder) or is_complete(folder):
        _verify_log(folder, _given(folder, against), sample, report)
        return report
    given = _given(folder, against)
    for path in sorted(folder.iterdir()):
        if path.name in (RUN, WORKING, FLEET):
            continue
        if is_complete(path):
            _verify_log(path, given, sample, report.of(path.name))
        elif (path / FAILED).is_file():
            report.notes.append(f"{path.name} failed in the run and has no results")
        elif path.is_dir() and ({*path.glob("*.parquet")} or (path / "summary.json").exists()):
            report.of("").add(
                "files", path.name, "the results are incomplete: there is no manifest"
            )
        else:
            report.notes.append(f"{path.name} is not the results of a log")
    report.of("")
    if (folder / WORKING).is_dir():
        report.notes.append("a run is active here or was interrupted; the same command resumes it")
    try:
        with Results(folder) as results:
            report.notes += [
                f"{name} has another configuration or version than {RUN}" for name in results.stale
            ]
    except InputError as error:
        if not report.findings:
            report.add("tables", error.path, error.problem)
    return report


def _given(folder: Path, against: Sequence[str]) -> Mapping[str, LogFiles]:
    """Return the logs that were passed, by their names in the results."""
    if not against:
        return {}
    with Results(folder) as results:
        return find(results, against)


def _verify_log(folder: Path, given: Mapping[str, LogFiles], sample: int, report: Report) -> None:
    """Check the folder of one log."""
    manifest = check_files(folder, report)
    try:
        results = Results(folder)
    except InputError as error:
        if manifest:
            report.add("tables", error.path, error.problem)
        else:  # already reported
            report.notes.append(f"the tables were not read: {error}")
        return
    with results:
        before = len(report.findings)
        check_tables(results, report)
        if len(report.findings) > before:
            report.notes.append("the log was not checked, as the tables are damaged")
            return
        _check_tracks(results, manifest.get("files", ()), report)
        seen = False
        for log in results.logs:
            try:
                files = given.get(log.name) or recorded(log, "--against")
            except InputError as error:
                text = f"{error.path}: {error.problem}; pass it with --against"
                report.notes.append(f"{log.label} was not compared: {text}")
                continue
            if not seen and manifest:
                check_inputs(files, manifest.get("inputs", ()), report)
            seen = True
            check_log(results, log, files, sample, report)


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


def _check_tracks(results: Results, names: Collection[str], report: Report) -> None:
    """Link the obstacles again, and compare the files of tracks byte for byte.

    Args:
        results: Results.
        names: Names of the files in the manifest; files with findings are not compared again.
        report: Report to add to.
    """
    folder = results.folder
    known = {finding.where.rpartition("/")[2] for finding in report.findings}
    expected = {name for name in names if is_track_file(name)}
    if not expected or TRACKS in known:
        return
    with TemporaryDirectory(prefix="jaxdet-verify-") as made:
        try:
            linked = write_tracks(results, tracking(folder), Path(made))
        except InputError as error:  # from the tracks, or from a map on which they are drawn
            if (name := Path(error.path).name) not in known:
                report.add("tracks", name, error.problem)
            return
        report.linked = sum(log.linked for log in linked)
        found = {path.name for path in Path(made).iterdir()}
        for name in sorted((found | expected) - known):
            if name not in found:
                report.add("tracks", name, "not created by linking the obstacles again")
            elif name not in expected:
                report.add("tracks", name, "missing, but created by linking the obstacles again")
            elif not cmp(Path(made) / name, folder / name, shallow=False):
                report.add("tracks", name, "differs from linking the obstacles again")
