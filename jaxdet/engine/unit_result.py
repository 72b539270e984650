"""Results of units, and their assembly into the tables, map and summary of a log."""

import shutil
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow as pa

from jaxdet.engine.plan import Unit
from jaxdet.engine.settings import Observer
from jaxdet.errors import OutputError
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.results.summary import Counts, LogSummary
from jaxdet.results.tables import Tables

if TYPE_CHECKING:
    from jaxdet.io import Notes

MAX_FRAME_ERRORS = 20


class UnitResult(NamedTuple):
    """Results of a unit."""

    counts: Counts
    rows: Path
    """Temporary file with the unit's rows, see :meth:`jaxdet.results.tables.Tables.save`."""
    map: OccupancyMap
    errors: list[str]
    """Messages on frames that could not be used."""
    pictures: list[str]
    """Names of the unit's pictures in the log's folder."""
    seen: dict[str, list[Any]]
    """Results of each observer for the unit's batches."""
    notes: "Notes"
    """Notes of the log reader on the unit's frames."""
    lost: str = ""
    """Reason why the frames have no results, if the processes that worked on the unit were lost."""


UnitResults = Generator[tuple[Unit, UnitResult], None, None]
"""Units with their results."""


def rows_path(scratch: Path, unit: Unit) -> Path:
    """Return the temporary file of a unit's rows."""
    return scratch / f"{unit.number:08d}.arrow"


class Assembly:
    """Puts the results of a log's units, which arrive in any order, in the order of the frames.

    Args:
        scratch: Folder of temporary files, which :meth:`close` removes.
        about: Summary of the log; :meth:`add` adds a unit's counts, :meth:`finish` completes it.
    """

    def __init__(self, scratch: Path, about: LogSummary) -> None:
        self.map = OccupancyMap()
        self._scratch, self._about = scratch, about
        self._parts: dict[int, UnitResult] = {}

    def add(self, unit: Unit, part: UnitResult) -> None:
        """Add the result of a unit."""
        self._about.add(part.counts)
        rest = OccupancyMap()  # counts add up in any order, the path waits for earlier units
        rest.path, part.map.path = part.map.path, []
        self.map.merge(part.map)
        self._parts[unit.number] = part._replace(map=rest)

    def finish(self, observers: Mapping[str, Observer]) -> list["Notes"]:
        """Complete the summary and the map after the last unit.

        Returns:
            Notes of the reader, in the order of the frames.
        """
        about, notes = self._about, []
        seen: dict[str, list[Any]] = {name: [] for name in observers}
        for _, part in sorted(self._parts.items()):
            self.map.merge(part.map)
            notes.append(part.notes)
            about.pictures += part.pictures
            about.lost += [part.lost] if part.lost else []
            about.frame_errors += part.errors[: MAX_FRAME_ERRORS - len(about.frame_errors)]
            for name, made in part.seen.items():
                seen[name] += made
        for name, observer in observers.items():
            about.observed[name] = observer.summary(seen[name])
        return notes

    def rows(self) -> Iterator[Tables]:
        """Yield all rows in order.

        Raises:
            OutputError: A temporary file of rows can't be read.
        """
        for _, part in sorted(self._parts.items()):
            try:
                rows = Tables.load(part.rows)
            except (OSError, pa.ArrowInvalid) as error:
                problem, remedy = f"temporary rows can't be read ({error})", "run the log again"
                raise OutputError(problem, path=str(part.rows), remedy=remedy) from error
            yield rows

    def close(self) -> None:
        """Remove the temporary files."""
        self._parts.clear()
        shutil.rmtree(self._scratch, ignore_errors=True)
