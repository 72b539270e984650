"""Opening of a log, by the indexes in its files or by rebuilt indexes."""

from collections.abc import Sequence
from contextlib import closing, suppress
from functools import partial
from os import PathLike

from jaxdet.arguments import of_type
from jaxdet.errors import (
    CalibrationError,
    ChunkMemoryError,
    InputError,
    RescanError,
    TopicError,
    printable,
)
from jaxdet.io.body_frames import is_body_frame
from jaxdet.io.chunks import DamageError
from jaxdet.io.container import LogFile
from jaxdet.io.contents import ContentsBuilder, LogContents
from jaxdet.io.description import describe_topics
from jaxdet.io.file_index import FileIndex
from jaxdet.io.files import LogFiles, find_logs, missing_splits, siblings
from jaxdet.io.findings import check_sampled, find
from jaxdet.io.formats import open_file
from jaxdet.io.indexed import IndexedLog, open_index, search_index
from jaxdet.io.limits import ReadMemory
from jaxdet.io.log import Log
from jaxdet.io.options import LogOptions
from jaxdet.io.store import ChunkStore


def open_log(
    source: str | PathLike[str] | LogFiles,
    options: LogOptions | None = None,
    memory: ReadMemory | None = None,
) -> Log:
    """Open one camera of a log by its index, which is rebuilt if it is missing or wrong.

    Args:
        source: File, folder or glob with exactly one log, or a log from :func:`find_logs`.
        options: Options of the user; by default everything is determined from the log.
        memory: Limits of the memory for reading; frames do not depend on them.

    Raises:
        InputError: No file can be read, there are several logs, no frame is selected, or a chunk or
            the index needs more memory.
        CamerasError: The log has several cameras, and none is selected.
        TopicError: No or several topics can be depth, or a topic in the options does not exist.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
    """
    options = of_type("options", LogOptions() if options is None else options, LogOptions)
    if not isinstance(source, LogFiles):
        if not isinstance(source, str | PathLike):
            problem = f"expected a path, got {type(source).__name__}"
            raise InputError(problem, topic="source", remedy="pass a file or a folder")
        logs = find_logs([source])
        if len(logs) > 1:
            problem, remedy = f"expected one log, found {len(logs)}", "pass one of them"
            raise InputError(problem, path=str(source), remedy=remedy)
        source = logs[0]
    memory = memory or ReadMemory()
    files, left_out = open_files(source, options, memory)
    store = ChunkStore(files, most_bytes=memory.chunk)
    try:
        if not options.scan:
            with suppress(DamageError):
                indexes = [file.read_index() for file in files]
                for complete in (False, True):
                    with suppress(RescanError):
                        found = _find_contents(indexes, store, source, options, complete=complete)
                        return _opened(source, found, options, left_out)
        indexes = [file.rebuild_index() for file in files]
        found = _find_contents(indexes, store, source, options, complete=True)
        return _opened(source, found, options, left_out)
    except BaseException:
        store.close()
        raise


def _opened(
    files: LogFiles, known: IndexedLog, options: LogOptions, left_out: Sequence[str]
) -> Log:
    """Create the log, and again if the depth images show that their frame is a body frame.

    Raises:
        JaxdetError: See :func:`open_log`; the error lists damaged files and topics.
        RescanError: The first messages show that all messages must be read.
    """
    contents, store = known.contents, known.store
    contents.warnings += left_out
    contents.warnings += [
        f"{printable(str(file.path))}: {file.note}" for file in store.files if file.note
    ]
    _note(contents, files)
    try:
        found = find(known, options)
    except (TopicError, CalibrationError) as error:
        if isinstance(error, CalibrationError):
            check_sampled(known, error)
        error.topics = describe_topics(contents)
        for file in [file for file in contents.integrity if file.recovered][:2]:
            error.add_remedy(f"{file.path.name} is {file.text}")
        bad = [(name, about) for name, about in contents.topics.items() if about.undecodable]
        for name, about in bad[:2]:
            if about.trouble not in str(error):
                error.add_remedy(f"{name}: {about.trouble}")
        raise
    log = Log(files, contents, found, store, options)
    given = options.camera_frame is not None or found.calibrated.T_frame_camera is not None
    places = log.has_poses or log.T_base_camera is not None
    if given or not places:
        return log
    if is_body_frame(log.num_frames, log.T_base_camera, lambda some: log.read(some).frames):
        return Log(files, contents, find(known, options, is_body=True), store, options)
    return log


def open_files(
    log: LogFiles, options: LogOptions, memory: ReadMemory
) -> tuple[list[LogFile], list[str]]:
    """Return the open files of a log, and warnings about unreadable splits.

    Args:
        log: Names of the files.
        options: Options of the user.
        memory: Limits of the memory for reading.

    Raises:
        InputError: None of the files can be read.
    """
    files: list[LogFile] = []
    failures: list[InputError] = []
    for path in log.paths:
        try:
            files.append(open_file(path, options.max_chunk_mib << 20, memory))
        except InputError as error:
            failures.append(error)
    if not files:
        raise failures[0]
    return files, [f"{error}; the file is left out" for error in failures]


def _find_contents(
    indexes: Sequence[FileIndex],
    store: ChunkStore,
    log: LogFiles,
    options: LogOptions,
    *,
    complete: bool,
) -> IndexedLog:
    """Read the contents of a log by the indexes of its files.

    Args:
        indexes: Indexes of the files.
        store: Chunks of the files.
        log: Paths of the files.
        options: Options of the user.
        complete: Whether to read all small messages, and the timestamps of all images.

    Raises:
        DamageError: An index is wrong.
        RescanError: The first messages show that all messages must be read.
    """
    found = open_index(indexes, store, options.tf, str(log.paths[0]), complete=complete)
    if options.tf and not found.contents.has_static:
        _search_siblings(found.contents, store.files[0].memory, log, options)
    for tree in found.contents.trees.values():
        tree.settle()
    return found


def _search_siblings(
    contents: LogContents, memory: ReadMemory, log: LogFiles, options: LogOptions
) -> None:
    """Read static transforms and calibration from the other splits of the recording, in order."""
    for path in siblings(log):
        try:
            with closing(open_file(path, options.max_chunk_mib << 20, memory)) as file:
                builder = ContentsBuilder(contents, options.tf, images=False)
                file.by_index(partial(search_index, file, builder=builder))
        except ChunkMemoryError:
            raise  # otherwise the result would depend on the available memory
        except (InputError, DamageError) as error:
            contents.warnings.append(f"{error}; the split is not searched for static transforms")
        if contents.has_static:
            contents.warnings.append(f"static transforms were read from the split {path.name}")
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
        contents.notes.append(f"no integrity check of {files}, which have no CRCs")
    for name, topic in sorted(contents.topics.items()):
        if topic.count and topic.trouble:
            contents.warnings.append(f"{printable(name)}: {printable(topic.trouble)}")
