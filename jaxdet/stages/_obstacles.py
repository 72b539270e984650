"""Obstacles from surfaces under ``jax.jit``. Twin of ``jaxdet/reference/_obstacles.py``."""

from collections.abc import Sequence

import jax
import numpy as np

from jaxdet.affinity import BEYOND, NO_STEP, Affinity
from jaxdet.config import ObstacleConfig
from jaxdet.stages._teams import Tables, TeamKernel, kernel_tables
from jaxdet.types import MAX_CONTOUR, MAX_LABELS, MAX_SURFACES
from jaxdet_kernels import obstacles as kernel

FARTHEST = 1 << 28
"""Longer than any length that is compared [depth units]; products with it fit in 64 bits."""
MOST_EVIDENCE = (1 << 15) - 1  # of a pair; 256 by 256 of them, added up, fit in 32 bits

_obstacles = TeamKernel(kernel.obstacles)


def tables(farthest: int, unit: float, config: ObstacleConfig, table: Affinity) -> Tables:
    """The tables and settings of :func:`obstacles`, made on the host.

    Args:
        farthest: End of the range [depth units].
        unit: Metres in one depth unit.
        config: The gaps and sizes.
        table: That of the configuration, in the same depth units.

    Raises:
        ValueError: The table's evidence could overflow when it is added up.
    """
    most = int(np.abs(table.value).max(axis=1).sum()) + abs(table.offset)
    if most > MOST_EVIDENCE:
        raise ValueError(f"evidence of up to {most}, but {MOST_EVIDENCE} is the most there may be")
    gaps = config.lateral_gap_m, config.forward_gap_m, config.depth_gap_m, config.contact_m
    sizes = config.bend_m, config.side_m, config.min_size_m
    lengths = (round(m / unit) for m in (*gaps, *sizes))
    settings = farthest, *lengths, config.min_cells, round(NO_STEP / (1000 * unit)), table.offset
    return kernel_tables(
        feature=table.feature,
        threshold=np.clip(table.threshold, -BEYOND, BEYOND),
        value=table.value,
        settings=np.clip(settings, -FARTHEST, FARTHEST),
    )


def obstacles(
    label: jax.Array, free: jax.Array, view: Sequence[jax.Array], shared: Tables
) -> tuple[jax.Array, jax.Array]:
    """Groups the surfaces of frames into obstacles; inside of ``jax.jit``.

    Takes what the kernel takes, ``shared`` as of :func:`tables`; ``view`` is what
    :class:`jaxdet.reference._view.View` has, of a batch.

    Returns:
        ``(B, R, C)`` int32 obstacles in the order of their nearest z, then of their leftmost point,
        then of their first cell, -1 = none; and ``(B,)`` int32, how many there are.

    Raises:
        ValueError: The grid has more than ``MAX_CONTOUR`` rows or columns.
    """
    batch, rows, columns = label.shape
    if max(rows, columns) > MAX_CONTOUR:
        raise ValueError(f"{columns} x {rows} cells, at most {MAX_CONTOUR} x {MAX_CONTOUR} fit")
    inputs = label, free, *view
    words = kernel.scratch_words(rows, columns, MAX_SURFACES, MAX_LABELS)
    shapes = {"label_out": label.shape, "count_out": (batch,)}
    found, count = _obstacles(*inputs, **shared, batch=batch, shapes=shapes, scratch=words)
    return found, count
