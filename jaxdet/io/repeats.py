"""Images that a log holds twice, as where a recording was merged with itself: each counts once."""

from collections import Counter

import deflate
import numpy as np

from jaxdet.errors import InputError, printable
from jaxdet.io.chunks import DamageError
from jaxdet.io.contents import LogContents
from jaxdet.io.store import ChunkStore, Place
from jaxdet.io.streams import NUM_PROBES, ImageStream

_COLUMNS = ("stamp", "color_stamp", "size")


def may_repeat(stream: ImageStream, log_ns: np.ndarray) -> bool:
    """Return whether images may occur twice, by the first ones and by all log times.

    Args:
        stream: The first images, at least.
        log_ns: ``(N,)`` int64, log times of all images in order.
    """
    stamps, sizes = (stream.column(name)[:NUM_PROBES] for name in ("stamp", "size"))
    first = Counter(zip(stamps.tolist(), sizes.tolist(), strict=True))
    several = any(count > 1 for (stamp, _), count in first.items() if stamp)
    return several or bool((np.diff(log_ns) == 0).any())


def drop_repeated(contents: LogContents, store: ChunkStore) -> None:
    """Drop images that are equal to an earlier one of their topic, in stamp and in content.

    Only messages of equal stamps and sizes are read and compared.
    """
    for topic, stream in sorted(contents.streams.items()):
        keep = _first_ones(stream, store)
        if not keep.all():
            stream.keep(keep)
            count = int((~keep).sum())
            text = f"{count} images occur twice, equal in stamp and content; each counts once"
            contents.warnings.append(f"{printable(topic)}: {text}")


def _first_ones(stream: ImageStream, store: ChunkStore) -> np.ndarray:
    """Return ``(N,)`` bool, images that are not equal to an earlier one."""
    keys = np.stack([stream.column(name) for name in _COLUMNS], axis=1)
    keep = np.ones(len(keys), bool)
    if not len(keys):
        return keep
    _, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    where = np.flatnonzero((count[group] > 1) & (keys[:, 0] > 0))
    places = np.stack([stream.column(name) for name in ("file", "chunk", "offset")], axis=1)
    seen: set[tuple[int, int]] = set()
    for row in where.tolist():
        file, chunk, offset = places[row].tolist()
        try:
            data = store.peek(Place(file, chunk), offset, int(keys[row, 2]))
        except (DamageError, InputError):
            continue
        key = int(group[row]), deflate.crc32(data)
        keep[row] = key not in seen
        seen.add(key)
    return keep
