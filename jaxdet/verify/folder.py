"""All checks of a results folder."""

from collections.abc import Sequence
from pathlib import Path

from jaxdet.errors import InputError
from jaxdet.export.recordings import find, recorded
from jaxdet.results.reading import Results, check_folder
from jaxdet.verify.files import check_files
from jaxdet.verify.logs import check_inputs, check_log
from jaxdet.verify.report import Report
from jaxdet.verify.tables import check_tables
from jaxdet.verify.tracks import check_tracks

SAMPLE = 8
"""Frames of each log that are computed again, unless it is asked for otherwise."""


def verify(folder: Path, against: Sequence[str] = (), sample: int = SAMPLE) -> Report:
    """Checks that results are whole, unchanged, of their logs and right.

    Each file is compared with its checksum in the manifest. All rows are read: the tables must be
    in order, belong together and agree with ``summary.json``, with a row for every frame. Tracks
    are made once more, and must be the same to the byte. Where
    the logs are found, their files must be those that were read, and stamps and poses of all
    frames the same. Some frames are computed again by the NumPy reference: their rows must be
    equal to the byte.

    Args:
        folder: What a run wrote.
        against: Files, folders and globs where the logs are now; those not among them are looked
            for where the run found them.
        sample: So many frames of each log are computed again, spread evenly.

    Returns:
        What was found. Errors in the results are findings too.

    Raises:
        InputError: There is no such folder, or ``against`` names something else than its logs.
    """
    check_folder(folder)
    report = Report()
    manifest = check_files(folder, report)
    inputs = manifest.get("inputs")
    try:
        results = Results(folder)
    except InputError as error:
        if manifest:
            report.add("tables", error.path, error.problem)
        else:  # which has been said
            report.notes.append(f"the tables were not read: {error}")
        return report
    with results:
        given = find(results, against)
        check_tables(results, inputs, report)
        if any(finding.check == "tables" for finding in report.findings):
            report.notes.append("the logs were not looked at, as the tables are damaged")
            return report
        check_tracks(results, manifest.get("files", ()), report)
        seen: set[str] = set()
        for log in results.logs:
            try:
                files = given.get(log.name) or recorded(log, "--against")
            except InputError as error:
                text = f"{error.path}: {error.problem}; name it with --against"
                report.notes.append(f"{log.label} was not compared: {text}")
                continue
            if log.name not in seen and inputs is not None:
                check_inputs(files, inputs[log.name], report)
            seen.add(log.name)
            check_log(results, log, files, sample, report)
    return report
