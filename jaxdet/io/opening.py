"""Opens the files of a log and makes its index."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from jaxdet.cores import cores
from jaxdet.errors import InputError
from jaxdet.io.container import McapFile
from jaxdet.io.files import LogFiles, missing_splits, siblings
from jaxdet.io.index import IndexBuilder, LogIndex
from jaxdet.io.options import LogOptions
from jaxdet.io.scan import scan
from jaxdet.io.topics import printable


class OpenedFiles(NamedTuple):
    """A log's open files and what is in them."""

    files: tuple[McapFile, ...]
    contents: LogIndex

    def close(self) -> None:
        """Closes the files."""
        for file in self.files:
            file.close()


def open_files(log: LogFiles, options: LogOptions) -> OpenedFiles:
    """Opens and indexes a log; a split that can't be read is left out with a warning.

    Raises:
        InputError: None of its files can be read.
    """
    max_bytes = options.max_chunk_mib << 20
    index, files = LogIndex(), []
    failures: list[InputError] = []
    for path in log.paths:
        try:
            files.append(McapFile(path, max_bytes))
        except InputError as error:
            failures.append(error)
    if not files:
        raise failures[0]
    index.warnings += [f"{error}; the file is left out" for error in failures]
    try:
        with ThreadPoolExecutor(cores(), thread_name_prefix="jaxdet-open") as pool:
            _index_files(index, files, options, pool)
            if options.tf and not index.tree.has_static:
                _search_siblings(index, log, options, pool)
    except BaseException:
        for file in files:
            file.close()
        raise
    index.tree.settle()
    _note(index, log)
    return OpenedFiles(tuple(files), index)


def _index_files(
    index: LogIndex, files: Sequence[McapFile], options: LogOptions, pool: ThreadPoolExecutor
) -> None:
    builder = IndexBuilder(index, options.tf)
    for file in files:
        builder.next_file()
        index.integrity.append(scan(file, builder.add, pool))


def _search_siblings(
    index: LogIndex, log: LogFiles, options: LogOptions, pool: ThreadPoolExecutor
) -> None:
    """Static transforms and calibration from the recording's other splits, first to last."""
    for path in siblings(log):
        builder = IndexBuilder(index, options.tf, images=False)
        try:
            file = McapFile(path, options.max_chunk_mib << 20)
        except InputError:
            continue
        try:
            scan(file, builder.add, pool)
        finally:
            file.close()
        if index.tree.has_static:
            index.warnings.append(f"static transforms are taken from the split {path.name}")
            return


def _note(index: LogIndex, log: LogFiles) -> None:
    gaps = missing_splits(log)
    if gaps:
        index.warnings.append(f"splits {', '.join(map(str, gaps[:10]))} of {log.name} are missing")
    for integrity in index.integrity:
        if integrity.recovered:
            index.warnings.append(f"{integrity.path}: {integrity.text}")
    for name, topic in sorted(index.topics.items()):
        if topic.problem:
            index.warnings.append(f"{printable(name)}: {printable(topic.problem)}")
        elif topic.undecodable:
            text = f"{topic.undecodable} messages can't be decoded"
            index.warnings.append(f"{printable(name)}: {text}")
