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
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.results.durable import flush, read_checked, write_checked, writing
from jaxdet.results.manifest import MANIFEST

JOURNAL = "commit"
_OLD = "old"


class Journal(NamedTuple):
    """What is to be done, and what the run says of it when that is done."""

    old: tuple[str, ...]
    """Files of the results folder that leave it."""
    new: dict[str, str]
    """By its name in the results folder, where in the working folder each file is."""
    rest: tuple[str, ...]
    """What of the working folder is of no use when that is done."""
    told: Any
    """Whatever the run wants to know of itself; None: the new files are tracks."""


def commit(
    working: Path,
    files: Mapping[str, Path],
    old: Iterable[str],
    rest: Iterable[str],
    told: Any = None,
) -> None:
    """Makes files the results of the folder that the working folder is in.

    Args:
        working: The working folder, which this process has locked.
        files: The new files by their names in the results folder, the manifest among them.
        old: Names of the files that leave it; the manifest may be among them.
        rest: See :class:`Journal`.
        told: Likewise; is pickled.

    Raises:
        OutputError: The disk is full or broken. Where there is a journal (:data:`JOURNAL`) what is
            left to do is done by :func:`settle`, else the results folder is as it was.
    """
    _begin(working, files, tuple(old), tuple(rest), told)
    settle(working)


def settle(working: Path) -> Journal | None:
    """Carries out the journal of a working folder, whoever wrote it, and removes it.

    Args:
        working: The working folder, which this process has locked.

    Returns:
        The journal; None: there was none.

    Raises:
        OutputError: The disk is broken, or the folder can't be written to; to be called again.
    """
    for torn in working.glob(f"{JOURNAL}.*"):  # of a process that was killed while it wrote
        torn.unlink()
    content = read_checked(working / JOURNAL)
    if content is None:
        return None
    journal: Journal = pickle.loads(content)
    _carry_out(working, journal)
    with writing(working):
        for path in (working / name for name in (*journal.rest, _OLD)):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        (working / JOURNAL).unlink()
    return journal


def _begin(
    working: Path, files: Mapping[str, Path], old: tuple[str, ...], rest: tuple[str, ...], told: Any
) -> None:
    """Writes the journal: from here on the results are the folder's."""
    with writing(working):
        flush(working, *{path.parent for path in files.values()}, *files.values())
    places = {name: str(path.relative_to(working)) for name, path in files.items()}
    journal = Journal(old, places, rest, told)
    write_checked(working / JOURNAL, pickle.dumps(journal, 5))
    with writing(working):
        flush(working)


def _carry_out(working: Path, journal: Journal) -> None:
    """Moves old results out and new ones in; as often as it takes."""
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
        folders = {(output / name).parent for name in (*journal.old, *journal.new)}
        for folder in folders:
            with suppress(OSError):
                folder.rmdir()  # where nothing is in it
        flush(*filter(Path.is_dir, folders))
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
