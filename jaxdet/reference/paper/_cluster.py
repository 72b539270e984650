"""Stage 4, cluster: gaps in depth, then sideways (Section 3.4)."""

import numpy as np

from jaxdet.config import Config
from jaxdet.floor.plane import gap_units
from jaxdet.types import Features, Labels


def cluster(features: Features, depth_unit: float, config: Config) -> Labels:
    """Group the kept features of each frame into obstacles (Eq. 6, Section 3.4).

    Sorted by depth, neighbours with ``|P_n - P_n+1| <= d_z`` share a set; sets of ``min_points``
    points or fewer are dropped. Each set is split in the same way along x with ``d_x``, and such
    small sets are dropped again. This is single-linkage clustering on a line, twice (Steps 1-5; the
    printed Algorithm 1 compares only with the set's seed, which contradicts Step 3).

    Args:
        features: Points ``(B, N)``; only ``kept`` ones are clustered.
        depth_unit: Metres per depth unit.
        config: Configuration, of which the gaps and ``min_points`` of ``cluster`` are used.

    Returns:
        Labels in the order of nearest z, then smallest x, then first slot; -1 for no obstacle.

    Example:
        >>> z = np.array([[500, 501, 502, 900, 901, 902]], np.int32)
        >>> yes = np.ones((1, 6), bool)
        >>> points = Features(z, z, 0 * z, z, z, yes, yes, np.array([False]))
        >>> from dataclasses import replace
        >>> config = replace(Config(), cluster=replace(Config().cluster, min_points=2))
        >>> cluster(points, 0.001, config).labels.tolist()
        [[0, 0, 0, 1, 1, 1]]
    """
    settings = config.cluster
    depth_gap, lateral_gap = gap_units(settings, depth_unit)
    labels = np.full(features.z.shape, -1, np.int32)
    for b, kept in enumerate(features.kept):
        z, x = features.z[b], features.x[b]
        sets = [
            part
            for column in _split(np.flatnonzero(kept), z, depth_gap, settings.min_points)
            for part in _split(column, x, lateral_gap, settings.min_points)
        ]
        sets.sort(key=lambda s, z=z, x=x: (z[s].min(), x[s].min(), s.min()))
        for label, part in enumerate(sets):
            labels[b, part] = label
    return Labels(labels, (labels.max(axis=1, initial=-1) + 1).astype(np.int32))


def _split(points: np.ndarray, axis: np.ndarray, gap: int, min_points: int) -> list[np.ndarray]:
    """Split ``points`` (indices) where neighbours along ``axis`` are more than ``gap`` apart.

    Returns:
        Parts of more than ``min_points`` points.
    """
    points = points[np.argsort(axis[points], kind="stable")]
    starts = np.flatnonzero(np.diff(axis[points]) > gap) + 1
    return [part for part in np.split(points, starts) if len(part) > min_points]
