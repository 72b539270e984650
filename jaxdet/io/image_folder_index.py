"""The messages of a folder of images: by their files' names and sizes, or with their bytes."""

import numpy as np

from jaxdet.io.chunks import DamageError
from jaxdet.io.container import Location
from jaxdet.io.file_index import FileIndex, count_channels, indexed_integrity
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.message_file import HEAD_BYTES, POSITION_BITS, position_of
from jaxdet.io.scan import Handler


def read_folder_index(folder: ImageFolder) -> FileIndex:
    """What the files' names and sizes tell."""
    channel, log_ns, size = np.array(folder.rows, np.int64).reshape(-1, 3).T
    position = np.arange(len(channel)) << POSITION_BITS
    return FileIndex(
        folder.infos,
        count_channels(channel, log_ns),
        indexed_integrity(folder.path, len(channel), 0, False),
        channel,
        log_ns,
        position,
        size + HEAD_BYTES,
        np.zeros_like(position),
    )


def scan_folder(folder: ImageFolder, handler: Handler) -> FileIntegrity:
    """Gives every message to ``handler``, in order of time; says what was lost.

    Raises:
        InputError: The folder was changed meanwhile.
    """
    integrity = indexed_integrity(folder.path, len(folder.rows), 0, False)
    messages, lost = 0, dict[str, int]()
    for number, row in enumerate(folder.rows):
        position = position_of(number)
        try:
            payload = folder.chunk(position)[HEAD_BYTES:]
        except DamageError as error:
            lost[str(error)] = lost.get(str(error), 0) + 1
            continue
        messages += 1
        where = Location(position, HEAD_BYTES, row.size)
        handler(folder.infos[row.channel], row.log_ns, memoryview(payload), where)
    folder.check_unchanged()
    return integrity._replace(messages=messages, lost=lost, by_index=False)
