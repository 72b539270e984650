"""All checks of results: of the folder of a run, or of one log."""

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
"""Frames of each log that are computed again, unless another number is requested."""


def verify(folder: Path, against: Sequence[str] = (), sample: int = SAMPLE) -> Report:
    """Check that results are complete, unchanged, of their logs and right.

    Each file is compared with its checksum in the manifest of its log. All rows are read: the
    tables must be in order, belong together and agree with ``summary.json``, with a row for every
    frame. Tracks are made once more, and must be the same to the byte. Where the logs are found,
    their files must be those that were read, and stamps and poses of all frames the same. Some
    frames are computed again by the NumPy reference: their rows must be equal to the byte.

    Args:
        folder: What a run wrote, or the folder of one log in it.
        against: Files, folders and globs where the logs are now; those not among them are looked
            for where the run found them.
        sample: Frames of each log that are computed again, spread evenly.

    Returns:
        What was found. Errors in the results are findings too.

    Raises:
        InputError: There is no such folder, or ``against`` names something else than its logs.
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
                "files", path.name, "has results and no manifest: they are not complete"
            )
        else:
            report.notes.append(f"{path.name} is no log's results")
    report.of("")
    if (folder / WORKING).is_dir():
        report.notes.append("a run works here, or was stopped; the same command goes on")
    try:
        with Results(folder) as results:
            report.notes += [
                f"{name} is of another configuration or version than {RUN}"
                for name in results.stale
            ]
    except InputError as error:
        if not report.findings:
            report.add("tables", error.path, error.problem)
    return report


def _given(folder: Path, against: Sequence[str]) -> Mapping[str, LogFiles]:
    """Return the logs that are named, by their names in the results."""
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
        else:  # which has been said
            report.notes.append(f"the tables were not read: {error}")
        return
    with results:
        before = len(report.findings)
        check_tables(results, report)
        if len(report.findings) > before:
            report.notes.append("the log was not looked at, as the tables are damaged")
            return
        check_tracks(results, manifest.get("files", ()), report)
        seen = False
        for log in results.logs:
            try:
                files = given.get(log.name) or recorded(log, "--against")
            except InputError as error:
                text = f"{error.path}: {error.problem}; name it with --against"
                report.notes.append(f"{log.label} was not compared: {text}")
                continue
            if not seen and manifest:
                check_inputs(files, manifest.get("inputs", ()), report)
            seen = True
            check_log(results, log, files, sample, report)
