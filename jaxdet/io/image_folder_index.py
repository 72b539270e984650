"""The messages of a folder of images: by their files' names and sizes, or with their bytes."""

import numpy as np

from jaxdet.io.chunks import PAYLOAD_OFFSET, DamageError
from jaxdet.io.container import Location
from jaxdet.io.file_index import FileIndex, file_index
from jaxdet.io.image_folder import ImageFolder
from jaxdet.io.integrity import FileIntegrity
from jaxdet.io.message_file import indexed_messages, position_of
from jaxdet.io.walk import Handler, Walk


def read_folder_index(folder: ImageFolder) -> FileIndex:
    """What the files' names and sizes tell."""
    channel, log_ns, size = np.array(folder.rows, np.int64).reshape(-1, 3).T
    messages = indexed_messages(np.arange(len(channel)), channel, log_ns, size)
    return file_index(folder.path, folder.infos, messages)


def scan_folder(folder: ImageFolder, handler: Handler) -> FileIntegrity:
    """Gives every message to ``handler``, in order of time; says what was lost.

    Of an image that can't be read it gives what is before: it is a frame, which can't be decoded.

    Raises:
        InputError: The folder was changed meanwhile.
    """
    walk = Walk(folder, handler)
    for number, row in enumerate(folder.rows):
        position = position_of(number)
        try:
            payload = folder.chunk(position)[PAYLOAD_OFFSET:]
        except DamageError as error:
            walk.lose(str(error), 0)
            payload = folder.head(number)
        where = Location(position, PAYLOAD_OFFSET, row.size)
        info = folder.infos[row.channel]
        walk.give(row.channel, info, row.log_ns, memoryview(payload), where)
    return walk.integrity(declared_messages=len(folder.rows), has_end=True)
