"""Opens the files of a log and finds what is in them, by their own indexes or by rebuilt ones."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from jaxdet.errors import ChunkMemoryError, InputError, printable
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.contents import ContentsBuilder, LogContents
from jaxdet.io.file_index import FileIndex
from jaxdet.io.files import LogFiles, missing_splits, siblings
from jaxdet.io.formats import open_file
from jaxdet.io.indexed import IndexedLog, open_index, search_index
from jaxdet.io.limits import ReadMemory
from jaxdet.io.options import LogOptions
from jaxdet.io.store import ChunkStore


class OpenedFiles(NamedTuple):
    """A log's open files, and what is wrong with the others."""

    files: tuple[LogFile, ...]
    warnings: tuple[str, ...]
    memory: ReadMemory
    """What reading may take."""


def open_files(log: LogFiles, options: LogOptions, memory: ReadMemory) -> OpenedFiles:
    """Opens a log's files; a split that can't be read is left out with a warning.

    Args:
        log: Its files.
        options: What the user says about it.
        memory: What reading may take.

    Raises:
        InputError: None of its files can be read.
    """
    files: list[LogFile] = []
    failures: list[InputError] = []
    for path in log.paths:
        try:
            files.append(_open(path, options, memory))
        except InputError as error:
            failures.append(error)
    if not files:
        raise failures[0]
    left_out = tuple(f"{error}; the file is left out" for error in failures)
    return OpenedFiles(tuple(files), left_out, memory)


def _open(path: Path, options: LogOptions, memory: ReadMemory) -> LogFile:
    file = open_file(path, options.max_chunk_mib << 20)
    file.memory = memory
    return file


def find_contents(
    opened: OpenedFiles,
    indexes: Sequence[FileIndex],
    store: ChunkStore,
    log: LogFiles,
    options: LogOptions,
    *,
    complete: bool,
) -> IndexedLog:
    """What is in a log, by the indexes of its files.

    Args:
        opened: The files.
        indexes: Theirs.
        store: Their chunks.
        log: The files' names.
        options: What the user says about the log.
        complete: Whether to read all small messages, and the stamps of all images.

    Raises:
        DamageError: An index is wrong.
        RescanError: The first messages are such that all have to be read.
    """
    path = str(log.paths[0])
    found = open_index(opened.files, indexes, store, options.tf, path, complete=complete)
    _finish(found.contents, opened, log, options)
    return found


def _finish(contents: LogContents, opened: OpenedFiles, log: LogFiles, options: LogOptions) -> None:
    if options.tf and not contents.has_static:
        _search_siblings(contents, opened.memory, log, options)
    for tree in contents.trees.values():
        tree.settle()
    contents.warnings += opened.warnings
    _note(contents, log)


def _search_siblings(
    contents: LogContents, memory: ReadMemory, log: LogFiles, options: LogOptions
) -> None:
    """Static transforms and calibration from the recording's other splits, first to last."""
    for path in siblings(log):
        try:
            with closing(_open(path, options, memory)) as file:
                builder = ContentsBuilder(contents, options.tf, images=False)
                try:
                    search_index(file, file.read_index(), builder)
                except DamageError:
                    search_index(file, file.rebuild_index(), builder)
        except ChunkMemoryError:
            raise  # else it would be for the memory to decide what is found
        except (InputError, DamageError) as error:
            contents.warnings.append(f"{error}; the split is not searched for static transforms")
        if contents.has_static:
            contents.warnings.append(f"static transforms are taken from the split {path.name}")
            return


def _note(contents: LogContents, log: LogFiles) -> None:
    if log.note:
        contents.warnings.append(log.note)
    if log.about:
        contents.notes.append(log.about)
    gaps = missing_splits(log)
    if gaps:
        numbers = ", ".join(map(str, gaps[:10]))
        contents.warnings.append(f"splits {numbers} of {log.name} are missing")
    for integrity in contents.integrity:
        if integrity.recovered or integrity.summary_problem not in ("", "no summary"):
            contents.warnings.append(f"{printable(str(integrity.path))}: {integrity.text}")
    unchecked = sum(not integrity.chunks_with_crc for integrity in contents.integrity)
    if unchecked:
        files = f"{unchecked} of {len(contents.integrity)} files"
        contents.notes.append(f"integrity not checkable in {files}: they hold no CRC")
    for name, topic in sorted(contents.topics.items()):
        if topic.trouble:
            contents.warnings.append(f"{printable(name)}: {printable(topic.trouble)}")
