"""Sets of points linked slice by slice, and along the grid's rows behind nearer things."""

import numpy as np

from jaxdet.config import REACH, ClusterConfig
from jaxdet.plane import slice_units


def linked_sets(
    x: np.ndarray,
    z: np.ndarray,
    kept: np.ndarray,
    measured: np.ndarray,
    row: np.ndarray,
    depth_gap: np.ndarray,
    depth_unit: float,
    settings: ClusterConfig,
) -> list[np.ndarray]:
    """Groups a frame's kept points by links of two kinds.

    Sideways: depth is cut into slices of ``slice_m``, and again half a slice farther on. In each
    slice, in order of x, neighbours at most ``lateral_gap_m`` apart are linked. That is the
    paper's gap rule with a reach in depth, so that two things which are apart on the floor stay
    apart, whatever else stands at their depths or to their side.

    Behind: what passes behind a nearer thing goes on at its other side. A point of the grid is
    linked with the next one to its left in its row that is not nearer by more than d_z, if that
    is not farther by more than d_z either and at most ``occluder_m`` to the side. Nearer kept
    points are passed over and at most ``max_holes`` pixels without depth; a pixel that shows the
    floor or something out of range ends the search, for one sees between the two.

    Args:
        x: ``(N,)`` int32, to the right [depth units].
        z: ``(N,)`` int32, forward [depth units].
        kept: ``(N,)`` bool, the points to group.
        measured: ``(N,)`` bool, there is a depth.
        row: ``(N,)`` integer, equal for consecutive grid pixels of a row; -1 for corners.
        depth_gap: ``(N,)`` int32, d_z at each point [depth units].
        depth_unit: Metres in one depth unit.
        settings: The distances.

    Returns:
        The sets, as rising indices.
    """
    links = [
        *_sideways(x, z, kept, depth_unit, settings),
        _behind(x, z, kept, measured, row, depth_gap, depth_unit, settings),
    ]
    first, second = np.concatenate(links, axis=1)
    label = components(len(x), first, second)
    points = np.flatnonzero(kept)
    order = points[np.argsort(label[points], kind="stable")]
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(order) else []


def _sideways(
    x: np.ndarray, z: np.ndarray, kept: np.ndarray, depth_unit: float, settings: ClusterConfig
) -> list[np.ndarray]:
    """Links in both cuts of the slices, ``(2, L)`` indices each."""
    depth, gap = slice_units(settings, depth_unit), round(settings.lateral_gap_m / depth_unit)
    points = np.flatnonzero(kept)
    links = []
    for start in (0, depth // 2):
        number = (z[points] + start) // depth
        order = np.lexsort((x[points], number))
        near = (np.diff(number[order]) == 0) & (np.diff(x[points[order]]) <= gap)
        links.append(np.stack([points[order[:-1]][near], points[order[1:]][near]]))
    return links


def _behind(
    x: np.ndarray,
    z: np.ndarray,
    kept: np.ndarray,
    measured: np.ndarray,
    row: np.ndarray,
    depth_gap: np.ndarray,
    depth_unit: float,
    settings: ClusterConfig,
) -> np.ndarray:
    """Links along the rows of the grid, ``(2, L)`` indices."""
    reach = round(settings.occluder_m / depth_unit)
    links = []
    for i in np.flatnonzero(kept & (row >= 0)) if reach else ():
        holes = 0
        for j in range(i - 1, max(i - REACH, 0) - 1, -1):
            if row[j] != row[i]:
                break
            if kept[j]:
                if z[j] < z[i] - depth_gap[i]:
                    continue
                if z[j] <= z[i] + depth_gap[i] and abs(x[i] - x[j]) <= reach:
                    links.append((j, i))
                break
            holes += 1
            if measured[j] or holes > settings.max_holes:
                break
    return np.array(links, np.int64).reshape(-1, 2).T


def components(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The connected components of a graph.

    Args:
        count: Nodes.
        first: ``(L,)`` integer, one end of each link.
        second: ``(L,)`` integer, the other.

    Returns:
        ``(count,)`` int64, the smallest node of each node's component.

    Example:
        >>> components(5, np.array([1, 4]), np.array([3, 3])).tolist()
        [0, 1, 2, 1, 1]
    """
    label = np.arange(count)
    while True:
        before = label.copy()
        ends = label[first], label[second]
        for end in ends:
            np.minimum.at(label, end, np.minimum(*ends))
        while (label != label[label]).any():
            label = label[label]
        if (label == before).all():
            return label
