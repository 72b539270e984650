"""What a unit leaves behind: a file that is whole, and agrees with its checksum, or no file."""

import pickle
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxdet.engine.plan import Unit
from jaxdet.results.durable import read_checked, sha256, write_checked
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.results.summary import Counts
from jaxdet.results.writer import Tables

if TYPE_CHECKING:
    from jaxdet.io import Notes

_LOADED_AHEAD = 4
"""Parts, of 256 frames 2.5 MB each."""


class Part(NamedTuple):
    """The part of a unit."""

    counts: Counts
    rows: Tables
    map: OccupancyMap
    errors: list[str]
    """Frames that could not be used, with the reason."""
    pictures: dict[str, str]
    """Names of the pictures drawn, with their SHA-256."""
    seen: dict[str, list[Any]]
    """What each observer made of the batches."""
    notes: list["Notes"]
    """What reading told beside the frames."""
    lost: str = ""
    """Why its frames have no results, where the processes that worked on it failed."""

    @classmethod
    def load(cls, folder: Path, unit: Unit) -> "Part | None":
        """Reads the part of a unit; None: it or a picture isn't there, or is damaged."""
        content = read_checked(part_path(folder, unit))
        part: Part | None = None if content is None else pickle.loads(content)
        return part if part is not None and part._has_pictures(folder) else None

    def _has_pictures(self, folder: Path) -> bool:
        try:
            return all(sha256(folder / name) == was for name, was in self.pictures.items())
        except OSError:
            return False

    def save(self, folder: Path, unit: Unit) -> None:
        """Writes it; whoever counts on it waits for the disk.

        Raises:
            OutputError: The disk is full or broken.
        """
        write_checked(part_path(folder, unit), pickle.dumps(self, 5), wait=False)


def load_parts(folder: Path, units: Iterable[Unit]) -> Iterator[tuple[Unit, Part | None]]:
    """The parts of units as :meth:`Part.load` has them, in order, a few loaded ahead."""
    waiting: deque[tuple[Unit, Future[Part | None]]] = deque()
    with ThreadPoolExecutor(_LOADED_AHEAD) as disk:
        for unit in units:
            waiting.append((unit, disk.submit(Part.load, folder, unit)))
            if len(waiting) > _LOADED_AHEAD:
                first, part = waiting.popleft()
                yield first, part.result()
        for unit, part in waiting:
            yield unit, part.result()


def part_path(folder: Path, unit: Unit) -> Path:
    """The file of a unit's part in the folder of its log."""
    return folder / part_name(unit)


def part_name(unit: Unit) -> str:
    """The name of that file."""
    return f"{unit.number:08d}.part"
