"""The files of ``jaxdet track`` against the obstacles that they link."""

from collections.abc import Collection
from filecmp import cmp
from pathlib import Path
from tempfile import TemporaryDirectory

from jaxdet.errors import InputError
from jaxdet.results.reading import TRACKS, Results
from jaxdet.tracks.folder import is_track_file, tracking, write_tracks
from jaxdet.verify.report import Report


def check_tracks(results: Results, names: Collection[str], report: Report) -> None:
    """Links the obstacles once more: the same files come of it, byte for byte.

    Args:
        results: The results.
        names: Their files; those with a finding are not looked at again.
        report: Gets what is found.
    """
    folder = results.folder
    known = {finding.where.rpartition("/")[2] for finding in report.findings}
    told = {name for name in names if is_track_file(name)}
    if not told or TRACKS in known:
        return
    with TemporaryDirectory(prefix="jaxdet-verify-") as made:
        try:
            linked = write_tracks(results, tracking(folder), Path(made))
        except InputError as error:  # of the tracks, or of a map that they are drawn on
            if (name := Path(error.path).name) not in known:
                report.add("tracks", name, error.problem)
            return
        report.linked = sum(log.linked for log in linked)
        found = {path.name for path in Path(made).iterdir()}
        for name in sorted((found | told) - known):
            if name not in found:
                report.add("tracks", name, "is no file that linking the obstacles gives")
            elif name not in told:
                report.add("tracks", name, "is missing: linking the obstacles gives it")
            elif not cmp(Path(made) / name, folder / name, shallow=False):
                report.add("tracks", name, "is not what linking the obstacles gives")
