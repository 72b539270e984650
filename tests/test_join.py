"""The parts of a log become its summary and its map."""

from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxdet.config import Config, GroundConfig
from jaxdet.engine import Unit
from jaxdet.engine.join import MAX_FRAME_ERRORS, join_parts
from jaxdet.engine.part import Part
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.results.summary import Counts, LogSummary
from jaxdet.results.writer import Tables


def joined(
    folder: Path,
    maps: list[OccupancyMap],
    map_bytes: int = 1 << 30,
    config: Config | None = None,
    floor: str = "frame",
    others: int = 0,
) -> LogSummary:
    """The summary of a log whose parts have these maps, 15 bad frames and one floor each."""
    units = [Unit(number, number, number + 1) for number in range(len(maps))]
    for unit, one in zip(units, maps, strict=True):
        bad = [f"frame {unit.number}.{number}" for number in range(15)]
        counts = Counts(frames=15, floor_sources=Counter({floor: 1}))
        Part(counts, Tables.joined(()), one, bad, {}, {}, []).save(folder, unit)
    about = {"config": config or Config(), "file_name": "a", "label": "a"}
    plan: Any = SimpleNamespace(folder=folder, observers={}, units=lambda: units, **about)
    about = LogSummary("a", (), frames=99)  # as counted so far
    join_parts(plan, about, map_bytes, others)
    return about


def seen(*places: float) -> OccupancyMap:
    """A metre of floor covered at each X [m], on the path."""
    found = OccupancyMap()
    found.add_path(np.broadcast_to(np.eye(4), (1, 4, 4)))
    for x in places:
        found.add(np.array([[x, 0, x + 1, 0, x + 1, 1, x, 1]]))
    return found


def test_the_first_bad_frames_are_told(tmp_path: Path) -> None:
    about = joined(tmp_path, [OccupancyMap(), OccupancyMap(), OccupancyMap()])
    told = [f"frame {number // 15}.{number % 15}" for number in range(MAX_FRAME_ERRORS)]
    assert about.frame_errors == told
    assert about.frames == 45
    assert about.notes == ["no map: no frame has a pose"]


@pytest.mark.parametrize(
    ("places", "map_bytes", "warnings"),
    [
        ([], 1 << 30, ["no map: nothing was seen in the world"]),
        ([0.0, 1e6], 1 << 10, ["no map: what was seen is too far apart for one"]),
        ([0.0, 2.0], 1 << 10, ["no map: it takes "]),
        ([0.0, 1e12], 1 << 30, ["1 outlines or views have no place on the map"]),
        ([0.0, 2.0], 1 << 30, []),
    ],
    ids=["nothing", "wide", "memory", "far", "fits"],
)
def test_why_there_is_no_map(
    tmp_path: Path, places: list[float], map_bytes: int, warnings: list[str]
) -> None:
    about = joined(tmp_path, [OccupancyMap(), seen(*places)], map_bytes)
    assert len(about.warnings) == len(warnings)
    assert all(map(str.startswith, about.warnings, warnings))
    made = {path.name for path in tmp_path.glob("map.*")}
    assert made == ({"map.npz", "map.png"} if about.map else set())
    assert bool(about.map) == (not any(text.startswith("no map") for text in warnings))


def test_processes_share_the_memory_for_maps(tmp_path: Path) -> None:
    some = seen(0.0, 2.0)
    room = 28 * some.cells
    assert joined(tmp_path, [some], room).map
    assert joined(tmp_path, [some], 3 * room, others=2).map
    assert not joined(tmp_path, [seen(0.0, 1e6)], room, others=2).map  # too wide for any memory
    with pytest.raises(MemoryError):
        joined(tmp_path, [some], 2 * room, others=2)


def test_a_map_lacks_floors(tmp_path: Path) -> None:
    about = joined(tmp_path, [seen()], floor="none")
    assert about.warnings == ["no map: no frame's floor is known"] and not about.notes
    none = Config(GroundConfig(source="none"))
    about = joined(tmp_path, [seen()], config=none, floor="none")
    assert about.notes == ["no map: no floor was looked for (--ground.source none)"]
    assert not about.warnings and about.map is None
