"""The parts of a log that is whole become rows, its summary, its map and what observers say."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxdet.engine.part import Part, load_parts, part_path
from jaxdet.engine.plan import LogPlan
from jaxdet.errors import OutputError
from jaxdet.memory import size_text
from jaxdet.render import draw_map, write_png
from jaxdet.results.durable import writing
from jaxdet.results.occupancy import MAX_CELLS, OccupancyMap, save_map
from jaxdet.results.summary import LogSummary
from jaxdet.results.writer import ResultWriter, Tables

if TYPE_CHECKING:
    from jaxdet.io import Notes

MAX_FRAME_ERRORS = 20
_CELL_BYTES = 28
"""Of a map that is made and drawn: four numbers of 4 bytes, cut out once more, and a pixel."""
WHOLE = "whole"
"""In the folder of a log that is done: its summary."""


def parts_of(plan: LogPlan) -> Iterator[Part]:
    """All parts of a log, in order; they are there.

    Raises:
        OutputError: One is not, or is damaged.
    """
    for unit, part in load_parts(plan.folder, plan.units()):
        if part is None:
            (plan.folder / WHOLE).unlink(missing_ok=True)  # so that the unit is done again
            path = str(part_path(plan.folder, unit))
            remedy = "run the command again"
            raise OutputError("was changed or removed", path=path, remedy=remedy)
        yield part


def join_parts(plan: LogPlan, about: LogSummary, map_bytes: int, others: int = 0) -> list["Notes"]:
    """All that the parts of a log say beside their rows goes into its summary and its map.

    The rows are left for :func:`parts_of` when nothing can fail any more: what is once in a table
    stays there, and a log that fails has no rows.

    Args:
        plan: The log's.
        about: Its summary.
        map_bytes: Memory for maps.
        others: Processes that may make maps at the same time.

    Returns:
        What reading told beside the frames.

    Raises:
        MemoryError: The map takes more than this process's share.
    """
    occupancy, notes = OccupancyMap(), []
    seen: dict[str, list[Any]] = {name: [] for name in plan.observers}
    about.clear()
    for part in parts_of(plan):
        about.add(part.counts)
        occupancy.merge(part.map)
        notes += part.notes
        about.pictures += part.pictures
        about.lost += [part.lost] if part.lost else []
        about.frame_errors += part.errors[: MAX_FRAME_ERRORS - len(about.frame_errors)]
        for name, made in part.seen.items():
            seen[name] += made
    for name, observer in plan.observers.items():
        about.observed[name] = observer.summary(seen[name])
    share = map_bytes // (others + 1)
    if others and share // _CELL_BYTES < occupancy.cells <= MAX_CELLS:
        raise MemoryError("not enough for as many maps at a time")
    _write_map(occupancy, plan, about, map_bytes)
    return notes


def add_rows(writer: ResultWriter, rows: Iterable[Tables], log: str) -> None:
    """Adds the rows of a log to the tables.

    Raises:
        OutputError: The disk is full or broken, or there is no memory for them.
    """
    try:
        for some in rows:
            writer.add(some)
    except MemoryError as error:
        raise OutputError(
            "no memory for its rows", path=log, remedy="end other programs"
        ) from error


def map_files(about: LogSummary, folder: Path) -> dict[str, Path]:
    """The files of a log's map, by their names in the results."""
    return {f"{about.map}.{end}": folder / f"map.{end}" for end in ("npz", "png") if about.map}


def _write_map(occupancy: OccupancyMap, plan: LogPlan, about: LogSummary, map_bytes: int) -> None:
    if not any(path.size for path in occupancy.path):
        about.notes.append("no map: no frame has a pose")
        return
    if occupancy.skipped:
        about.warnings.append(f"{occupancy.skipped} outlines or views have no place on the map")
    if (size := _CELL_BYTES * occupancy.cells) > map_bytes and occupancy.cells <= MAX_CELLS:
        about.warnings.append(f"no map: it takes {size_text(size)}; give --memory more")
        return
    image = occupancy.image()
    if image is None:
        _say_why(occupancy, plan, about)
        return
    about.map = f"map_{plan.file_name}"
    with writing(plan.folder):
        save_map(plan.folder / "map.npz", image)
        write_png(plan.folder / "map.png", draw_map(image, plan.label))


def _say_why(occupancy: OccupancyMap, plan: LogPlan, about: LogSummary) -> None:
    """Why there is no map, though frames have poses."""
    floors = about.floor_sources
    if occupancy.cells:
        about.warnings.append("no map: what was seen is too far apart for one")
    elif plan.config.ground.source == "none":
        about.notes.append("no map: no floor was looked for (--ground.source none)")
    elif floors and floors.total() == floors["none"]:
        about.warnings.append("no map: no frame's floor is known")
    else:
        about.warnings.append("no map: nothing was seen in the world")
