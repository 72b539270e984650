"""Obstacles from surfaces under ``jax.jit``. Twin of ``jaxdet/reference/_obstacles.py``."""

import numpy as np

from jaxdet.affinity import BEYOND, NO_STEP, Affinity
from jaxdet.config import ObstacleConfig
from jaxdet.stages._tables import Tables, kernel_tables

FARTHEST = 1 << 28
"""Longer than any length that is compared [depth units]; products with it fit in 64 bits."""
MOST_EVIDENCE = (1 << 15) - 1  # of a pair; 256 by 256 of them, added up, fit in 32 bits


def tables(farthest: int, unit: float, config: ObstacleConfig, table: Affinity) -> Tables:
    """The tables and settings of the step, made on the host.

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
        obstacle_settings=np.clip(settings, -FARTHEST, FARTHEST),
    )
