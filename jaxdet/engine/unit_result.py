"""What a unit leaves, and how the units of a log become its tables, map and summary."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.engine.plan import Observer, Unit
from jaxdet.errors import OutputError
from jaxdet.results.durable import writing
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.results.summary import Counts, LogSummary
from jaxdet.results.writer import Tables

if TYPE_CHECKING:
    from jaxdet.io import Notes

MAX_FRAME_ERRORS = 20
HELD_FRAMES = 16384
"""Frames whose rows are held in memory; those of more go to temporary files."""


class UnitResult(NamedTuple):
    """Results of a unit."""

    counts: Counts
    rows: Tables | Path
    """The rows, or the temporary file that has them."""
    map: OccupancyMap
    errors: list[str]
    """Frames that could not be used, with the reason."""
    pictures: list[str]
    """Pictures drawn, by their names in the log's folder."""
    seen: dict[str, list[Any]]
    """What each observer made of the batches."""
    notes: list["Notes"]
    """Notes of the reader, besides the frames."""
    lost: str = ""
    """Why its frames have no results, where the processes that worked on it failed."""

    def saved(self, path: Path) -> "UnitResult":
        """Return the part with its rows in a temporary file.

        Raises:
            OutputError: The disk is full or broken.
        """
        if isinstance(self.rows, Tables):
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
            self.rows.save(path)
        return self._replace(rows=path)


def rows_path(scratch: Path, unit: Unit) -> Path:
    """Return the temporary file of a unit's rows."""
    return scratch / f"{unit.number:08d}.arrow"


class Assembly:
    """Parts of one camera's log, which come in any order, put together in that of the frames.

    Args:
        scratch: Folder for temporary files; made when it is needed.
        about: Summary that gets the counts at once and the rest in :meth:`finish`.
    """

    def __init__(self, scratch: Path, about: LogSummary) -> None:
        self.map = OccupancyMap()
        self._scratch, self._about = scratch, about
        self._parts: dict[int, UnitResult] = {}
        self._paths: dict[int, list[Any]] = {}
        self._held = 0

    def add(self, unit: Unit, part: UnitResult) -> None:
        """Take in the part of a unit.

        Raises:
            OutputError: The disk is full or broken.
        """
        self._about.add(part.counts)
        if isinstance(part.rows, Tables):
            self._held += part.rows.frames.num_rows
            if self._held > HELD_FRAMES:
                part = part.saved(rows_path(self._scratch, unit))
        self._paths[unit.number], part.map.path = part.map.path, []
        self.map.merge(part.map)  # counts only, which add up in any order
        self._parts[unit.number] = part._replace(map=OccupancyMap())

    def finish(self, observers: Mapping[str, Observer]) -> list["Notes"]:
        """Complete the summary and the map; all parts are there.

        Returns:
            Notes of the reader, in the order of the frames.
        """
        about, notes = self._about, []
        seen: dict[str, list[Any]] = {name: [] for name in observers}
        for number in sorted(self._parts):
            part = self._parts[number]
            self.map.path += self._paths[number]
            notes += part.notes
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
            OutputError: There is no memory for them.
        """
        try:
            for number in sorted(self._parts):
                rows = self._parts[number].rows
                yield rows if isinstance(rows, Tables) else Tables.load(rows)
        except MemoryError as error:
            problem, remedy = "no memory for its rows", "end other programs"
            raise OutputError(problem, path=self._about.log, remedy=remedy) from error

    def close(self) -> None:
        """Remove the temporary files."""
        self._parts.clear()
        shutil.rmtree(self._scratch, ignore_errors=True)
