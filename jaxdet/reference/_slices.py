"""Sets of points linked slice by slice, and along the surfaces that a grid of pixels shows."""

from typing import NamedTuple

import numpy as np

from jaxdet.config import REACH, ClusterConfig
from jaxdet.plane import SLOPE_BITS, slice_units, slope_units
from jaxdet.reference._components import components


class Points(NamedTuple):
    """A frame's points, each ``(N,)``: corners, then the grid's pixels row by row."""

    x: np.ndarray
    """int32, to the right [depth units]."""
    y: np.ndarray
    """int32, down in the camera [depth units]."""
    z: np.ndarray
    """int32, forward [depth units], 0 = no depth."""
    kept: np.ndarray
    """bool, the points to group."""
    row: np.ndarray
    """Integer, equal for consecutive grid pixels of a row; -1 for corners."""


def linked_sets(
    points: Points,
    depth_gap: int,
    surface_gap: np.ndarray,
    depth_unit: float,
    settings: ClusterConfig,
) -> list[np.ndarray]:
    """Groups a frame's kept points by links of three kinds.

    Sideways: depth is cut into slices of ``slice_m``, and again half a slice farther on. In each
    slice, in order of x, neighbours at most ``lateral_gap_m`` apart are linked. That is the
    paper's gap rule with a reach in depth, so that two things which are apart on the floor stay
    apart, whatever else stands at their depths or to their side.

    Behind: what passes behind a nearer thing goes on at its other side. A point of the grid is
    linked with the next one to its left in its row that is not nearer by more than d_z, if that
    is not farther by more than d_z either and at most ``occluder_m`` to the side; d_z grows by
    ``occluder_slope`` for each metre to the side. Nearer kept points are passed over and at most
    ``max_holes`` pixels without depth; a pixel that shows the floor or something out of range ends
    the search, for one sees between the two. Something has to be between.

    Surface: a point of the grid is linked with the one to its left and the one above it when their
    depths differ by no more than the surface gap at the nearer of the two.

    Points linked behind or by surface are a surface. One whose grid points reach at least
    ``surface_height_m`` from the highest to the lowest (along the camera's y) stands on its own:
    links sideways never make two of these one, neither directly nor through others. All else that
    links sideways lead to from one goes to the one with the fewest links in between, of equal ones
    to that with the smallest slot; what none is linked to is grouped by all links.

    Args:
        points: Of the frame.
        depth_gap: d_z [depth units].
        surface_gap: ``(N,)`` int32, the largest step from each point to a neighbour in its surface
            [depth units].
        depth_unit: Metres in one depth unit.
        settings: The distances.

    Returns:
        The sets, as rising indices.
    """
    sideways = np.concatenate(_sideways(points, depth_unit, settings), axis=1)
    behind = _behind(points, depth_gap, depth_unit, settings)
    height = round(settings.surface_height_m / depth_unit)
    if height:
        surface = components(
            len(points.x), *np.concatenate([behind, _neighbours(points, surface_gap)], axis=1)
        )
        tall = _is_tall(points, surface, height)
        label = _apart(surface, tall, sideways)
    else:
        label = components(len(points.x), *np.concatenate([sideways, behind], axis=1))
    kept = np.flatnonzero(points.kept)
    order = kept[np.argsort(label[kept], kind="stable")]
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(order) else []


def _sideways(points: Points, depth_unit: float, settings: ClusterConfig) -> list[np.ndarray]:
    """Links in both cuts of the slices, ``(2, L)`` indices each."""
    depth, gap = slice_units(settings, depth_unit), round(settings.lateral_gap_m / depth_unit)
    kept = np.flatnonzero(points.kept)
    x, z = points.x[kept], points.z[kept]
    links = []
    for start in (0, depth // 2):
        number = (z + start) // depth
        order = np.lexsort((x, number))
        near = (np.diff(number[order]) == 0) & (np.diff(x[order]) <= gap)
        links.append(np.stack([kept[order[:-1]][near], kept[order[1:]][near]]))
    return links


def _behind(
    points: Points, depth_gap: int, depth_unit: float, settings: ClusterConfig
) -> np.ndarray:
    """Links along the rows of the grid, ``(2, L)`` indices."""
    x, _, z, kept, row = points
    reach, slope = round(settings.occluder_m / depth_unit), slope_units(settings)
    links = []
    for i in np.flatnonzero(kept & (row >= 0)) if reach else ():
        holes = 0
        for j in range(i - 1, max(i - REACH, 0) - 1, -1):
            if row[j] != row[i]:
                break
            if kept[j]:
                aside = abs(int(x[i]) - int(x[j]))
                gap = depth_gap + (slope * aside >> SLOPE_BITS)
                if z[j] < z[i] - gap:
                    continue
                if z[j] <= z[i] + gap and aside <= reach and j < i - 1:
                    links.append((j, i))
                break
            holes += 1
            if z[j] > 0 or holes > settings.max_holes:
                break
    return np.array(links, np.int64).reshape(-1, 2).T


def _neighbours(points: Points, surface_gap: np.ndarray) -> np.ndarray:
    """Links of the grid's pixels with those to the left and above, ``(2, L)`` indices.

    The grid has as many columns as its first row has pixels.
    """
    z, kept, row = points.z, points.kept, points.row
    first = int(np.count_nonzero(row < 0))
    if first == len(row):
        return np.zeros((2, 0), np.int64)
    columns = int(np.argmax(np.append(row[first:] != row[first], True)))
    links = []
    for back, in_row in ((1, True), (columns, False)):
        there = np.arange(first + back, len(row))
        here = there - back
        near = np.abs(z[there] - z[here]) <= np.minimum(surface_gap[there], surface_gap[here])
        near &= kept[there] & kept[here]
        if in_row:
            near &= row[there] == row[here]
        links.append(np.stack([here[near], there[near]]))
    return np.concatenate(links, axis=1)


def _is_tall(points: Points, surface: np.ndarray, height: int) -> np.ndarray:
    """Whether the surface of each number has grid points so far apart in y, ``(N,)`` bool."""
    grid = points.kept & (points.row >= 0)
    top, bottom = np.full(len(surface), np.inf), np.full(len(surface), -np.inf)
    np.minimum.at(top, surface[grid], points.y[grid])
    np.maximum.at(bottom, surface[grid], points.y[grid])
    return bottom - top >= height


def _apart(surface: np.ndarray, tall: np.ndarray, links: np.ndarray) -> np.ndarray:
    """Groups surfaces by links, but leaves tall ones apart.

    Args:
        surface: ``(N,)`` integer, each point's surface, by its smallest slot.
        tall: ``(N,)`` bool, by that slot.
        links: ``(2, L)`` indices of points.

    Returns:
        ``(N,)`` int64, a number a group.

    Example:
        >>> tall = np.array([True, False, False, True, False])
        >>> links = np.array([[0, 1, 2], [1, 2, 3]])
        >>> _apart(np.arange(5), tall, links).tolist()
        [0, 0, 3, 3, 9]
    """
    count = len(surface)
    nobody = count
    owner = np.where(tall, np.arange(count), nobody)
    one, two = surface[np.concatenate([links, links[::-1]], axis=1)]
    while True:
        reached = (owner[one] == nobody) & (owner[two] != nobody)
        if not reached.any():
            break
        np.minimum.at(owner, one[reached], owner[two[reached]])
    rest = (owner[one] == nobody) & (owner[two] == nobody)
    other = components(count, one[rest], two[rest])
    return np.where(owner == nobody, count + other, owner)[surface]
