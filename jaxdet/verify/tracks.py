"""Check of the tracks, by linking the obstacles again."""

from collections.abc import Collection
from filecmp import cmp
from pathlib import Path
from tempfile import TemporaryDirectory

from jaxdet.errors import InputError
from jaxdet.results.layout import TRACKS
from jaxdet.results.reading import Results
from jaxdet.tracks.folder import is_track_file, tracking, write_tracks
from jaxdet.verify.report import Report


def check_tracks(results: Results, names: Collection[str], report: Report) -> None:
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
