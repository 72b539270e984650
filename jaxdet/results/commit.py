"""How results get into their folder: all of them or none, whatever ends the process on the way.

The folder may hold other files, and may be a mount point, so it isn't replaced itself. Results are
made in a working folder inside it. A journal, written when all of them are whole and on the disk,
is the moment from which the new results are those of the folder: what it says is carried out, or
gone on with by the next run. First the old results leave, their manifest first, then the new ones
arrive, their manifest last. So at no time do old and new files lie beside each other, and a folder
without a manifest holds no whole results.
"""

import os
import pickle
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.results.durable import flush, read_checked, write_checked, writing
from jaxdet.results.manifest import MANIFEST, result_files

JOURNAL = "commit"
_OLD = "old"


class Journal(NamedTuple):
    """What is to be done, and what the run says of it when that is done."""

    old: tuple[str, ...]
    """Files of the results folder that leave it."""
    new: dict[str, str]
    """By its name in the results folder, where in the working folder each file is."""
    told: Any
    """Whatever the run wants to know of itself."""


def begin_commit(working: Path, files: Mapping[str, Path], told: Any) -> None:
    """Writes the journal: from here on the results are the folder's.

    Args:
        working: The working folder, in the results folder.
        files: By their names in the results folder, the manifest among them.
        told: See :class:`Journal`; is pickled.

    Raises:
        OutputError: The disk is full or broken; the results folder is as it was.
    """
    with writing(working):
        for folder in {working, *(path.parent for path in files.values())}:
            flush(folder)
        for path in files.values():
            flush(path)
    places = {name: str(path.relative_to(working)) for name, path in files.items()}
    journal = Journal(result_files(working.parent), places, told)
    write_checked(working / JOURNAL, pickle.dumps(journal, 5))
    with writing(working):
        flush(working)


def read_journal(working: Path) -> Journal | None:
    """The journal of a working folder; None: its results are not whole yet."""
    content = read_checked(working / JOURNAL)
    return None if content is None else pickle.loads(content)


def carry_out(working: Path, journal: Journal) -> None:
    """Moves old results out and new ones in; as often as it takes.

    Raises:
        OutputError: The disk is broken, or the folder can't be written to; to be called again.
    """
    output = working.parent
    with writing(output):
        (working / _OLD).mkdir(exist_ok=True)
        old = [name for name in journal.old if not _arrived(working, journal, name)]
        for number, name in enumerate(sorted(old, key=lambda name: name != MANIFEST)):
            with suppress(FileNotFoundError):
                os.replace(output / name, working / _OLD / f"{number}")
        flush(output)
        for name in journal.new.keys() - {MANIFEST}:
            _arrive(working, journal, name)
        for folder in {(output / name).parent for name in (*journal.old, *journal.new)}:
            with suppress(OSError):
                folder.rmdir()  # where nothing is in it
            if folder.is_dir():
                flush(folder)
        _arrive(working, journal, MANIFEST)
        flush(output)


def _arrive(working: Path, journal: Journal, name: str) -> None:
    if not _arrived(working, journal, name):
        place = working.parent / name
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(working / journal.new[name], place)


def _arrived(working: Path, journal: Journal, name: str) -> bool:
    """Whether a new file is at its place already."""
    place = journal.new.get(name)
    return place is not None and not (working / place).exists()
