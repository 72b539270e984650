"""All checks of results, for the folder of a run or of a single log."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxdet.errors import InputError
from jaxdet.export.recordings import find, recorded
from jaxdet.io import LogFiles
from jaxdet.results.layout import FAILED, FLEET, RUN, WORKING, check_folder, is_complete, is_run
from jaxdet.results.reading import Results
from jaxdet.verify.files import check_files
from jaxdet.verify.logs import check_inputs, check_log
from jaxdet.verify.report import Report
from jaxdet.verify.tables import check_tables
from jaxdet.verify.tracks import check_tracks

SAMPLE = 8
"""Default number of frames per log that are computed again."""


def verify(folder: Path, against: Sequence[str] = (), sample: int = SAMPLE) -> Report:
    """Check that results are complete, unchanged, consistent with their logs, and reproducible.

    Each file is compared with its checksum in the manifest of its log. All table rows are read: the
    tables must be in order, refer to each other correctly, agree with ``summary.json``, and have a
    row for every frame. Tracks are computed again and must be equal byte for byte. If a log is
    available, its files must be those that were read in the run, and the timestamps and poses of
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
        check_tracks(results, manifest.get("files", ()), report)
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
