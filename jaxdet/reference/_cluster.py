"""Stage 4, cluster: gaps in depth, then sideways (Section 3.4)."""

import numpy as np

from jaxdet.config import ClusterConfig, Config
from jaxdet.plane import gap_table
from jaxdet.reference._footprint import to_ground
from jaxdet.reference._slices import Points, linked_sets
from jaxdet.types import MAX_LATERAL, Features, GroundPlane, Labels


def cluster(features: Features, plane: GroundPlane, depth_unit: float, config: Config) -> Labels:
    """Groups the kept features of each frame into obstacles (Eq. 6, Section 3.4).

    Sorted by depth, neighbours with ``|P_n - P_n+1| <= d_z`` share a set; sets of N points or
    fewer are dropped; each set is split the same way along x with ``d_x``, and again sets of N
    points or fewer are dropped. That is single linkage on a line, twice (Steps 1-5; the printed
    Algorithm 1 compares with the set's seed only, which contradicts Step 3).

    Beyond the paper, by configuration: the gap in depth grows with z squared as the sensor's noise
    does (taken at the nearer of the two points), the two splits are repeated, the distances are
    measured on the floor instead of along the camera's axes, and the sideways gaps are looked for
    slice by slice (:func:`jaxdet.reference._slices.linked_sets`), which is the default.

    Args:
        features: ``(B, N)`` points; only ``kept`` ones take part.
        plane: The floor of each frame, used when the distances are measured on it.
        depth_unit: Metres in one depth unit.
        config: The gaps, N and the options of its cluster part.

    Returns:
        Labels numbered in order of nearest z, then smallest x, then first slot, with -1 for no
        obstacle.

    Example:
        >>> z = np.array([[500, 501, 502, 900, 901, 902]], np.int32)
        >>> yes = np.ones((1, 6), bool)
        >>> points = Features(z, z, 0 * z, z, z, yes, yes, np.array([False]))
        >>> from dataclasses import replace
        >>> from jaxdet.plane import unknown_plane
        >>> config = replace(Config(), cluster=replace(Config().cluster, min_points=2, slice_m=0))
        >>> cluster(points, unknown_plane(1), 0.001, config).labels.tolist()
        [[0, 0, 0, 1, 1, 1]]
    """
    settings = config.cluster
    depth_gaps, surface_gaps = gap_table(settings, depth_unit)
    lateral_gap = round(settings.lateral_gap_m / depth_unit)
    lateral, depth = features.x, features.z
    if settings.on_floor:
        lateral, depth = np.moveaxis(to_ground(features, plane), -1, 0)
        lateral, depth = np.clip(lateral, -MAX_LATERAL, MAX_LATERAL), np.clip(depth, 0, 65535)
    labels = np.full(features.z.shape, -1, np.int32)
    for b, kept in enumerate(features.kept):
        z, x = depth[b], lateral[b]
        gaps = depth_gaps[z]
        if settings.slice_m:
            row = np.where(np.arange(len(z)) < config.features.max_corners, -1, features.v[b])
            points = Points(x, features.y[b], z, kept, features.z[b] > 0, row)
            parts = linked_sets(points, gaps, surface_gaps[z], depth_unit, settings)
            sets = [part for part in parts if len(part) > settings.min_points]
        else:
            sets = _gap_sets(x, z, np.flatnonzero(kept), gaps, lateral_gap, settings)
        sets.sort(key=lambda s, z=z, x=x: (z[s].min(), x[s].min(), s.min()))
        for label, part in enumerate(sets):
            labels[b, part] = label
    return Labels(labels, (labels.max(axis=1, initial=-1) + 1).astype(np.int32))


def _gap_sets(
    x: np.ndarray,
    z: np.ndarray,
    points: np.ndarray,
    depth_gaps: np.ndarray,
    lateral_gap: int,
    settings: ClusterConfig,
) -> list[np.ndarray]:
    """The sets of Steps 1-5, from the indices of a frame's kept points."""
    lateral_gaps = np.full_like(x, lateral_gap)
    sets = [points]
    for _ in range(settings.rounds):
        sets = [
            part
            for whole in sets
            for column in _split(whole, z, depth_gaps, settings.min_points)
            for part in _split(column, x, lateral_gaps, settings.min_points)
        ]
    return sets


def _split(
    points: np.ndarray, axis: np.ndarray, gap: np.ndarray, min_points: int
) -> list[np.ndarray]:
    """Splits ``points`` (indices) where neighbours along ``axis`` are too far apart.

    The largest step from a point to the next one is its ``gap``.

    Returns:
        The parts of more than ``min_points`` points.
    """
    points = points[np.argsort(axis[points], kind="stable")]
    starts = np.flatnonzero(np.diff(axis[points]) > gap[points[:-1]]) + 1
    return [part for part in np.split(points, starts) if len(part) > min_points]
