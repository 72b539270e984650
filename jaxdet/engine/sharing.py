"""The parts of a run that several machines share: what lies where, and what may be joined.

::

    5d4140.../          a run, by what decides its results
      run.json          that, for people, and for runs that find another one's parts
      00012/0/          a log by its number, and its camera
        floors          what is known of its floor before its frames are looked at
        00000003.part   what a unit leaves behind, with its pictures

Each is put there at once, and agrees with its checksum. What a unit leaves behind is the same
whichever machine it was on, so nothing is locked: done twice, it is replaced by its equal.
"""

import json
import pickle
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from jaxdet.engine.floors import Planes
from jaxdet.engine.part import Part, part_name, part_path
from jaxdet.engine.part_store import PartStore
from jaxdet.engine.plan import LogPlan, Unit, UnitSizes, units_of
from jaxdet.engine.record import difference, digest
from jaxdet.errors import ConfigError
from jaxdet.results.durable import checked, checksum, write_whole

SIZES = UnitSizes(256, 0, 256)
"""Of the units of a run whose parts are shared, whatever machines they are done on."""
_RUN, _FLOORS = "run.json", "floors"
_FETCHED_AT_ONCE = 8


def open_store(url: str, record: Mapping[str, Any], *, begin: bool) -> PartStore:
    """The place of a run's parts.

    Args:
        url: Where machines share parts.
        record: What decides the results, see :func:`jaxdet.engine.record.make_record`.
        begin: There may be none yet.

    Raises:
        ConfigError: There are parts of another run, or none at all; or it is no address.
        OutputError: It can't be reached.
    """
    record = _of_any_machine(record)
    store, own = PartStore(url), digest(record)
    runs = store.names()
    if own not in runs:
        for name in sorted(runs):
            if content := store.within(name).get(_RUN):
                problem = f"holds parts of another run: {_reason(content, record)}"
                raise ConfigError(problem, path=str(store), remedy="give another --parts")
        if not begin:
            remedy = "do its shares first, with --share 1/N to N/N"
            raise ConfigError("holds no parts of this run", path=str(store), remedy=remedy)
        content = json.dumps(record, indent=2).encode()
        store.within(own).put(_RUN, content)
    return store.within(own)


def _reason(content: bytes, record: Mapping[str, Any]) -> str | None:
    """What tells a run from the one that left this."""
    try:
        return difference(json.loads(content), record)
    except (ValueError, TypeError, KeyError, AttributeError):
        return f"its {_RUN} can't be read"


def _of_any_machine(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record but for where the logs lie, and since when."""
    inputs = {
        log: [
            {"path": PurePath(file["path"]).name}
            | {key: file.get(key) for key in ("size", "fingerprint")}
            for file in files
        ]
        for log, files in record["about"]["inputs"].items()
    }
    return {**record, "about": {**record["about"], "inputs": inputs}}


class SharedLog:
    """What machines leave of a log for each other.

    Args:
        run: The place of the run's parts.
        folder: The log's in the working folder.
        share: The log's number, and which share of how many this run does, or (0, 0).
        scan: The log is read as a whole: then other frames may be in it.

    Raises:
        OutputError: The place can't be reached; so do all methods.
    """

    def __init__(
        self, run: PartStore, folder: Path, share: tuple[int, int, int], *, scan: bool
    ) -> None:
        self.store = run.within(f"{share[0]:05d}/{folder.name}{'-scan' * scan}")
        self._share = share

    def floors(self) -> Planes | None:
        """What is known of its floor, if another machine has looked for it."""
        return _load(self.store, _FLOORS)

    def keep_floors(self, planes: Planes) -> None:
        """Leaves that for others."""
        _save(self.store, _FLOORS, planes)

    def left(self, frames: range) -> list[Unit]:
        """The units of the share that nobody has left a part of."""
        there, (log, number, of) = self.store.names(), self._share
        share = (unit for unit in units_of(frames, SIZES) if (log + unit.number) % of == number - 1)
        return [unit for unit in share if part_name(unit) not in there]

    def fetch(self, plan: LogPlan) -> int:
        """Takes over the parts that are not in the plan's folder; returns how many there were."""
        there = self.store.names()
        units = [
            unit
            for unit in plan.units()
            if part_name(unit) in there and not part_path(plan.folder, unit).exists()
        ]
        with ThreadPoolExecutor(_FETCHED_AT_ONCE) as threads:
            return sum(threads.map(partial(_fetch, self.store, plan), units))


class _Sent(NamedTuple):
    """What a unit leaves behind."""

    floors: str
    """Those that the plan gave its frames; they are the same on all machines."""
    files: dict[str, bytes]
    """By their names in the folder of the log: its pictures, then its part."""


def send(store: PartStore, plan: LogPlan, unit: Unit) -> None:
    """Leaves the part of a unit for other machines, if it has results.

    Raises:
        OutputError: The place can't be reached.
    """
    part = Part.load(plan.folder, unit)
    if part is not None and not part.lost:
        names = *part.pictures, part_name(unit)
        files = {name: (plan.folder / name).read_bytes() for name in names}
        _save(store, part_name(unit), _Sent(repr(plan.planes.records), files))


def _fetch(store: PartStore, plan: LogPlan, unit: Unit) -> bool:
    """Takes over the part of a unit; whether it was whole, and of the plan."""
    sent: _Sent | None = _load(store, part_name(unit))
    if sent is None or sent.floors != repr(plan.planes.records):
        return False
    for name, content in sent.files.items():
        write_whole(plan.folder / name, content)
    return True


def _save(store: PartStore, name: str, value: Any) -> None:
    content = pickle.dumps(value, 5)
    store.put(name, checksum(content) + content)


def _load(store: PartStore, name: str) -> Any:
    """What :func:`_save` left; None: nothing, or it is damaged."""
    data = store.get(name)
    content = checked(data) if data else None
    return None if content is None else pickle.loads(content)
