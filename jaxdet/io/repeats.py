"""Removal of repeated images, for example from a recording that was merged with itself."""

from collections import Counter
from collections.abc import Iterable

import deflate
import numpy as np

from jaxdet.errors import InputError, printable
from jaxdet.io.chunks import DamageError
from jaxdet.io.records import read_message
from jaxdet.io.store import ChunkStore
from jaxdet.io.streams import ImageStream
from jaxdet.io.windows import StreamWindows


def may_repeat(stream: ImageStream, log_ns: np.ndarray) -> bool:
    """Return whether images may occur twice, judging by the first images and all log times.

    Args:
        stream: First images.
        log_ns: Log times of all images in order, ``(N,)`` int64 [ns].
    """
    first = Counter((image.stamp_ns, image.size) for image in stream.first)
    several = any(count > 1 for (stamp, _), count in first.items() if stamp)
    return several or bool((np.diff(log_ns) == 0).any())


def drop_repeated(streams: Iterable[StreamWindows], store: ChunkStore) -> list[str]:
    """Drop images that are equal to an earlier one of their topic in timestamp and content.

    Only messages with equal timestamps and sizes are read and compared.

    Args:
        streams: Images by topic, with all timestamps read.
        store: Chunks of the log.

    Returns:
        Warnings for the user.
    """
    warnings = []
    for stream in sorted(streams, key=lambda stream: stream.topic):
        keep = _first_ones(stream, store)
        if not keep.all():
            stream.keep(keep)
            count = int((~keep).sum())
            text = f"{count} images occur twice (same timestamp and content); each counts once"
            warnings.append(f"{printable(stream.topic)}: {text}")
    return warnings


def _first_ones(stream: StreamWindows, store: ChunkStore) -> np.ndarray:
    """Return which images are not equal to an earlier one in the files, ``(N,)`` bool."""
    keys = np.stack([stream.stamp, stream.color_stamp, stream.size], axis=1)
    keep = np.ones(len(keys), bool)
    if not len(keys):
        return keep
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    several = (count[group] > 1) & (keys[:, 0] > 0)
    seen: set[tuple[int, int]] = set()
    for number in stream.in_file_order()[several[stream.in_file_order()]].tolist():
        try:
            data = read_message(store, stream.messages, number)[1]
        except (DamageError, InputError):
            continue
        key = int(group[number]), deflate.crc32(data)
        keep[number] = key not in seen
        seen.add(key)
    return keep
