"""Objects between processes: their arrays through shared memory, the rest through a pipe."""

import pickle
import shutil
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.errors import WorkerError

_ALIGNMENT = 64
_FOLDER = Path("/dev/shm")


class Packed(NamedTuple):
    """An object on its way through a pipe."""

    head: bytes
    """The object, pickled, with places for its arrays."""
    sizes: tuple[int, ...]
    """Bytes of each array."""
    arrays: tuple[bytes, ...] | None
    """The arrays; None: they are in the shared memory."""

    @property
    def room(self) -> int:
        """Bytes of shared memory that the arrays take."""
        return sum(map(_aligned, self.sizes))


def pack(value: Any, memory_for: Callable[[int], SharedMemory | None]) -> Packed:
    """Pickles an object and writes its arrays into shared memory.

    Args:
        value: Anything that can be pickled; contiguous NumPy arrays count as arrays.
        memory_for: Gives memory of at least so many bytes, or None to send the arrays along.
    """
    found: list[pickle.PickleBuffer] = []
    head = pickle.dumps(value, 5, buffer_callback=found.append)
    views = [buffer.raw() for buffer in found]
    packed = Packed(head, tuple(len(view) for view in views), None)
    memory = memory_for(packed.room) if packed.room else None
    if memory is None:
        return packed._replace(arrays=tuple(map(bytes, views)))
    for view, part in zip(views, _parts(packed.sizes, memory), strict=True):
        part[:] = view
    return packed


def unpack(packed: Packed, memory: SharedMemory | None, *, copy: bool) -> Any:
    """The object that was packed.

    Args:
        packed: What :func:`pack` returned.
        memory: The memory it was packed into, under whatever name.
        copy: Whether its arrays are copied; else they are views of the memory.
    """
    arrays: Sequence[Any] | None = packed.arrays
    if arrays is None:
        assert memory is not None
        arrays = list(_parts(packed.sizes, memory))
    return pickle.loads(packed.head, buffers=map(bytearray, arrays) if copy else arrays)


def make_memory(size: int) -> SharedMemory:
    """Shared memory of at least ``size`` bytes.

    Raises:
        WorkerError: There isn't as much.
    """
    try:
        # Memory beyond the limit of its file system could be made, but not written to.
        if not _FOLDER.is_dir() or shutil.disk_usage(_FOLDER).free >= size:
            return SharedMemory(create=True, size=size)
        problem = f"no room for {size >> 20} MiB in {_FOLDER}"
    except OSError as error:
        problem = f"no shared memory of {size >> 20} MiB ({error.strerror})"
    raise WorkerError(problem, remedy="take fewer workers or smaller batches")


def _parts(sizes: Sequence[int], memory: SharedMemory) -> Iterator[memoryview]:
    start, everything = 0, memory.buf
    assert everything is not None
    for size in sizes:
        yield everything[start : start + size]
        start += _aligned(size)


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT
