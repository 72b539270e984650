"""The batch axis over several devices of one host."""

from collections import OrderedDict
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxdet.errors import ConfigError
from jaxdet.runtime.calls import uninterrupted
from jaxdet.types import GroundPlane

ROWS = PartitionSpec("frames")  # an array with a row for each frame
WHOLE = PartitionSpec()  # an array that every device needs
_COPIES = 256
PART_BYTES = 96 << 20
"""Of images that the CPU works on together, 64 frames of 640x480: results are what then has memory,
and a call's own time is little beside that of so many frames."""
STAGED_PART_BYTES = 12 << 20
"""The same of a program that goes through its stages with all frames: temporaries of that size are
memory that the process keeps, and larger ones come from the system as fresh pages at every call."""
_FEW = 8  # fewer frames a device are padded

Devices = tuple[jax.Device, ...]
LEAST_CAPABILITY = 8.0
"""Of CUDA's GPUs: from here on a warp adds up integers in one instruction."""


def devices_for(images: Any) -> Devices:
    """The devices that work on images.

    Images on devices are worked on there. Those on the host go to all devices of the default
    kind, or to the one that is chosen as default.

    Raises:
        ConfigError: One is a GPU of an earlier kind than kernels are made for.
    """
    chosen = getattr(jax.config, "jax_default_device", None)
    found: Devices
    if isinstance(images, jax.Array):
        found = tuple(sorted(images.devices(), key=lambda device: device.id))
    else:
        found = (chosen,) if isinstance(chosen, jax.Device) else tuple(jax.local_devices())
    for device in found:
        capability = getattr(device, "compute_capability", None)
        if capability and float(capability) < LEAST_CAPABILITY:
            raise ConfigError(
                f"{device.device_kind} has compute capability {capability}, and "
                f"{LEAST_CAPABILITY} (Ampere) is needed: choose another GPU by "
                "CUDA_VISIBLE_DEVICES, or JAX_PLATFORMS=cpu"
            )
    return found


def on_cuda() -> bool:
    """Whether JAX's default device is a CUDA device."""
    chosen = getattr(jax.config, "jax_default_device", None)
    platform = getattr(chosen, "platform", chosen) or jax.default_backend()
    return platform in ("gpu", "cuda")


def rows_over(among: Devices) -> NamedSharding:
    """Rows in equal parts, the first ones on the first device."""
    return NamedSharding(_mesh(among), ROWS)


def in_parts(
    run: Callable[[tuple[Any, ...], GroundPlane], Any],
    images: tuple[Any, ...],
    plane: GroundPlane,
    staged: bool = False,
) -> Any:
    """What a program finds in a batch of any size, while it is compiled for few sizes.

    A batch is worked on as a whole, on the CPU in parts of at most ``PART_BYTES`` of images a
    device, whose frames are a power of two. Fewer than ``_FEW`` images on the host, and any number
    of them for CUDA, get frames without depth added, until their number is a power of two times
    the devices; what is found in those is left out.

    Args:
        run: Gets images and planes, and returns a tree of arrays with a row for each frame.
        images: Of each kind ``(B, ...)``, ``B`` at least 1.
        plane: ``B`` planes.
        staged: The program goes through its stages with all frames, see ``STAGED_PART_BYTES``.

    Returns:
        The tree for all ``B`` frames: what ``run`` returned, where that needed nothing; of a batch
        in several parts, NumPy arrays.
    """
    count, parts = len(images[0]), len(devices_for(images[0]))
    most = _part_size(images, parts, STAGED_PART_BYTES if staged else PART_BYTES)
    joined: Any = None
    end = 0
    while end < count:
        size = _next_part(count - end, most, parts)
        rows = slice(end, end := end + size)
        some = tuple(image[rows] if size < count else image for image in images)
        planes = GroundPlane(*(np.asarray(values)[rows] for values in plane))
        number = len(some[0])
        missing = 0 if isinstance(some[0], jax.Array) else _bucket(number, parts) - number
        if missing:
            some = tuple(_padded(image, missing, "constant") for image in some)
            planes = GroundPlane(*(_padded(values, missing, "edge") for values in planes))
        part = run(some, planes)
        if missing:
            part = jax.tree.map(lambda values, number=number: values[:number], part)
        if size == count:
            return part
        if joined is None:
            joined = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), part)
        jax.tree.map(partial(_put, rows), joined, part)
        del part  # so that the next finds its memory
    return joined


def _put(rows: slice, whole: np.ndarray, part: jax.Array) -> None:
    whole[rows] = part


def _part_size(images: tuple[Any, ...], parts: int, part_bytes: int) -> int:
    """The most frames that are worked on together."""
    count = len(images[0])
    if on_cuda():
        return count
    frame = sum(image.nbytes for image in images) // count
    return parts << max(part_bytes // frame, 1).bit_length() - 1


def _next_part(left: int, most: int, parts: int) -> int:
    """How many of the frames that are left are worked on together."""
    if left >= most or left < _FEW * parts or on_cuda():
        return min(left, most)
    return parts << (left // parts).bit_length() - 1


def _bucket(count: int, parts: int) -> int:
    """The size that batches of so many frames are padded to."""
    return parts << (-(-count // parts) - 1).bit_length()


def _padded(rows: np.ndarray, missing: int, mode: Any) -> np.ndarray:
    return np.pad(rows, [(0, missing)] + [(0, 0)] * (rows.ndim - 1), mode=mode)


def run(
    program: Callable[..., Any], images: tuple[Any, ...], tables: Any, specs: Any, *static: Any
) -> Any:
    """Call ``program(*images, tables, *static)``, each device with its part of the rows.

    Args:
        program: Jitted; no frame may depend on another.
        images: Each ``(B, ...)``; ``B`` makes equal parts, see :func:`in_parts`.
        tables: A tree of further arrays.
        specs: The same tree, or the upper part of it, with ``ROWS`` or ``WHOLE`` at each end.
        static: Further arguments, hashable.

    Returns:
        What the program returns, its rows on the devices that computed them.
    """
    among = devices_for(images[0])
    if len(among) == 1:
        return uninterrupted(program, *images, tables, *static)
    images = jax.device_put(images, rows_over(among))
    spread = _spread(program, specs, among, len(images), static)
    return uninterrupted(spread, *images, _placed(tables, specs, among))


@lru_cache(maxsize=16)
def _spread(
    program: Callable[..., Any], specs: Any, among: Devices, kinds: int, static: tuple
) -> Any:
    def part(*inputs: Any) -> Any:
        return program(*inputs, *static)

    return jax.jit(
        jax.shard_map(
            part,
            mesh=_mesh(among),
            in_specs=(*[ROWS] * kinds, specs),
            out_specs=ROWS,
            check_vma=False,  # there is no communication to be checked
        )
    )


@lru_cache(maxsize=8)
def _mesh(among: Devices) -> Mesh:
    return Mesh(np.array(among), ("frames",))


def _placed(tables: Any, specs: Any, among: Devices) -> Any:
    """The tables on the devices; those that each needs are copied when they are new."""
    each = jax.tree.broadcast(specs, tables, is_leaf=lambda spec: isinstance(spec, PartitionSpec))
    return jax.tree.map(lambda array, spec: _copy(array, spec, among), tables, each)


_copies: OrderedDict[tuple[int, PartitionSpec, Devices], tuple[Any, jax.Array]] = OrderedDict()


def _copy(array: Any, spec: PartitionSpec, among: Devices) -> jax.Array:
    if spec != WHOLE:
        return jax.device_put(array, NamedSharding(_mesh(among), spec))
    key = id(array), spec, among
    if key not in _copies:
        # The array is kept beside its copy, so that no other gets its id.
        _copies[key] = array, jax.device_put(array, NamedSharding(_mesh(among), spec))
        if len(_copies) > _COPIES:
            _copies.popitem(last=False)
    _copies.move_to_end(key)
    return _copies[key][1]
