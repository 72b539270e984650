"""Obstacles from surfaces under ``jax.jit``. Twin of ``jaxdet/reference/_obstacles.py``."""

from typing import NamedTuple

import jax
import numpy as np

from jaxdet.affinity import BEYOND, NO_STEP, Affinity
from jaxdet.config import ObstacleConfig
from jaxdet.stages._teams import TeamKernel
from jaxdet.types import MAX_CONTOUR
from jaxdet_kernels import obstacles as kernel

FARTHEST = 1 << 28
"""Longer than any length that is compared [depth units]; products with it fit in 64 bits."""
MOST_EVIDENCE = (1 << 15) - 1
"""Of a pair; 256 by 256 of them, added up, fit in 32 bits."""

_obstacles = TeamKernel(kernel.obstacles)


class Settings(NamedTuple):
    """The order of the settings of the kernel, as in ``native/obstacles.h`` [depth units]."""

    farthest: int  # end of the range
    lateral_gap: int
    forward_gap: int
    depth_gap: int
    contact: int
    bend: int
    side: int
    min_size: int
    min_cells: int
    no_step: int  # step in depth of surfaces that do not face each other
    offset: int  # evidence to begin with


class View(NamedTuple):
    """:class:`jaxdet.reference._view.View` of a batch, each ``(B, R, C)`` int32 [depth units]."""

    x: jax.Array
    y: jax.Array
    z: jax.Array
    right: jax.Array
    forward: jax.Array
    height: jax.Array
    in_view: jax.Array  # bool


class Trees(NamedTuple):
    """A table of :mod:`jaxdet.affinity`, int32."""

    feature: jax.Array | np.ndarray
    threshold: jax.Array | np.ndarray
    value: jax.Array | np.ndarray


def settings_of(
    farthest: int, unit: float, config: ObstacleConfig, table: Affinity
) -> tuple[np.ndarray, Trees]:
    """What :func:`obstacles` is told, made on the host.

    Args:
        farthest: End of the range [depth units].
        unit: Metres in one depth unit.
        config: The gaps and sizes.
        table: That of the configuration, in the same depth units.

    Returns:
        ``(11,)`` int32, the values of :class:`Settings`, and the trees.

    Raises:
        ValueError: The table's evidence could overflow when it is added up.
    """
    most = int(np.abs(table.value).max(axis=1).sum()) + abs(table.offset)
    if most > MOST_EVIDENCE:
        raise ValueError(f"evidence of up to {most}, but {MOST_EVIDENCE} is the most there may be")
    settings = Settings(
        farthest,
        round(config.lateral_gap_m / unit),
        round(config.forward_gap_m / unit),
        round(config.depth_gap_m / unit),
        round(config.contact_m / unit),
        round(config.bend_m / unit),
        round(config.side_m / unit),
        round(config.min_size_m / unit),
        config.min_cells,
        round(NO_STEP / (1000 * unit)),
        table.offset,
    )
    trees = Trees(
        table.feature.astype(np.int32),
        np.clip(table.threshold, -BEYOND, BEYOND).astype(np.int32),
        table.value.astype(np.int32),
    )
    return np.clip(settings, -FARTHEST, FARTHEST).astype(np.int32), trees


def obstacles(
    label: jax.Array, free: jax.Array, view: View, trees: Trees, settings: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Groups the surfaces of frames into obstacles; inside of ``jax.jit``.

    Takes what the kernel takes; ``trees`` and ``settings`` are of :func:`settings_of`.

    Returns:
        ``(B, R, C)`` int32 obstacles in the order of their nearest z, then of their leftmost point,
        then of their first cell, -1 = none; and ``(B,)`` int32, how many there are.

    Raises:
        ValueError: The grid has more than ``MAX_CONTOUR`` rows or columns.
    """
    batch, rows, columns = label.shape
    if max(rows, columns) > MAX_CONTOUR:
        raise ValueError(f"{columns} x {rows} cells, at most {MAX_CONTOUR} x {MAX_CONTOUR} fit")
    inputs, words = (label, free, *view, *trees, settings), kernel.scratch_words(rows, columns)
    shapes = {"label_out": label.shape, "count_out": (batch,)}
    found, count = _obstacles(*inputs, batch=batch, shapes=shapes, scratch=words)
    return found, count
