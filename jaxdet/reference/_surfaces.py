"""Surfaces: connected components of the cells above the floor, cut along creases."""

import numpy as np

from jaxdet.config import SurfaceConfig
from jaxdet.floor.plane import quadratic_table
from jaxdet.reference._cells import margins
from jaxdet.reference._components import components
from jaxdet.reference._rounding import rounded

FRACTION_BITS = 4  # fraction bits of smoothed depths


def surfaces(
    z: np.ndarray, keep: np.ndarray, depth_unit: float, config: SurfaceConfig
) -> np.ndarray:
    """Segment the kept cells of a frame into surfaces.

    Neighbours in a row or column belong to the same surface if their depths differ by at most
    ``step_m + step_per_m z^2``; larger differences are depth discontinuities. Cells on both sides
    of at most ``hole_cells`` unmeasured cells are neighbours, too: dark, glossy or blurred objects
    have holes that would divide them into parts that are too small. Where two objects touch, depth
    is continuous but has a crease (a concave edge): the depth of a cell exceeds the mean of the
    depths ``crease_cells`` before and after. Cells on creases (:func:`creases`) are not linked;
    like components of fewer than ``min_cells`` cells, they are then assigned to the neighbouring
    surface that is nearest in depth.

    Args:
        z: Depths ``(R, C)`` int32 [depth units], 0 = no measurement.
        keep: Whether each cell is in range and above the floor, ``(R, C)`` bool.
        depth_unit: Metres in one depth unit.
        config: Steps and creases.

    Returns:
        Surfaces ``(R, C)`` int64, numbered from 0 in the order of their first cells, row by row; -1
        if there is none.

    Example:
        >>> z = np.array([[900, 910, 1500, 1505]], np.int32)
        >>> surfaces(z, z > 0, 0.001, SurfaceConfig(min_cells=1)).tolist()
        [[0, 0, 1, 1]]
        >>> z = np.array([[900, 905, 0, 0, 910]], np.int32)
        >>> surfaces(z, z > 0, 0.001, SurfaceConfig(min_cells=3)).tolist()
        [[0, 0, -1, -1, 1]]
    """
    z = z.astype(np.int64)
    step = quadratic_table(config.step_m, config.step_per_m, depth_unit)[z]
    linked = keep & ~creases(z, step, keep, depth_unit, config)
    label = _components(z, step, linked)
    together = _across_holes(label, z, step, linked, config.hole_cells)
    size = np.bincount(together.ravel(), minlength=label.size)
    label = np.where(linked & (size[together] >= config.min_cells), label, -1)
    rounds = config.crease_cells + config.crease_margin + 1
    return renumbered(_grown(label, z, step, keep, rounds))


def creases(
    z: np.ndarray, step: np.ndarray, keep: np.ndarray, depth_unit: float, config: SurfaceConfig
) -> np.ndarray:
    """Find kept cells on a concave edge, where objects touch or stand in front of a wall.

    Depth is smoothed twice over the 3 x 3 neighbours within two steps, so that noise of a single
    cell makes no crease. A cell p is on a crease if, in its row or its column and for
    ``s = crease_cells``,

        z(p) - (z(p - s) + z(p + s)) / 2 > crease_m + crease_per_m z^2

    and both differ from z(p) by less than s steps, because a jump in depth is not a crease.
    8-connected components of fewer than ``min_cells`` of these cells are noise. The others are
    dilated by ``crease_margin`` cells: surfaces are 4-connected, so a single missing cell would
    join them.

    Returns:
        Mask ``(R, C)`` bool.
    """
    smooth = z << FRACTION_BITS
    for _ in range(2):
        smooth = _smoothed(smooth, z > 0, 2 * step << FRACTION_BITS)
    limit = quadratic_table(config.crease_m, config.crease_per_m, depth_unit)[z]
    reach, found = config.crease_cells, np.zeros(z.shape, bool)
    for axis in (0, 1):
        before, after = (_shifted(smooth, d, axis) for d in (reach, -reach))
        measured = (_shifted(z, reach, axis) > 0) & (_shifted(z, -reach, axis) > 0)
        bend = 2 * smooth - before - after > 2 * limit << FRACTION_BITS
        farthest = np.maximum(np.abs(before - smooth), np.abs(after - smooth))
        found |= bend & measured & (farthest < reach * step << FRACTION_BITS)
    found = without_small(found & keep, config.min_cells)
    for _ in range(config.crease_margin):
        found = dilated(found)
    return found & keep


def without_bent_floor(
    label: np.ndarray,
    low: np.ndarray,
    forward: np.ndarray,
    height: np.ndarray,
    depth_unit: float,
    config: SurfaceConfig,
) -> np.ndarray:
    """Remove surfaces that are floor, bent up by sensor error.

    Stereo cameras bend flat floor up at the margins of the image and far away. A surface at most
    ``bent_m`` high is such floor if it has no steep front. For that, each of its cells directly
    above a floor cell in the image is compared with that cell: at least two thirds of them must
    rise by more than a third of the distance forward between both. In the :func:`margins` of the
    image they must rise by more than that distance, forward or back, since depths that are too
    small put floor nearer and higher. A surface without such pairs of cells has no front if all of
    it is in the margins and not at the lower edge of the image.

    Args:
        label: Surfaces ``(R, C)``, -1 = none.
        low: Whether a cell is measured and not above the step height, ``(R, C)`` bool.
        forward: Distance forward on the floor, ``(R, C)`` int64 [depth units].
        height: Height above the floor, ``(R, C)`` int64 [depth units].
        depth_unit: Metres in one depth unit.
        config: Maximum height of bent floor.

    Returns:
        Renumbered surfaces ``(R, C)`` int64.

    Example:
        >>> label, low = np.array([[0, 1], [-1, -1]]), np.array([[0, 0], [1, 1]], bool)
        >>> forward, height = np.array([[900, 800], [800, 800]]), np.array([[60, 60], [45, 0]])
        >>> without_bent_floor(label, low, forward, height, 0.001, SurfaceConfig()).tolist()
        [[-1, 0], [-1, -1]]
    """
    count = int(label.max(initial=-1)) + 1
    on = label >= 0
    rises, goes = (a - _shifted(a, -1, 0) for a in (height, forward))
    lowest = on & (_shifted(low.astype(np.int64), -1, 0) > 0)
    outer = np.broadcast_to(margins(label.shape[1]), label.shape)
    rising = np.where(outer, rises > np.abs(goes), 3 * rises > goes)
    steep = np.bincount(label[lowest & rising], minlength=count)
    pairs = np.bincount(label[lowest], minlength=count)
    inner = np.bincount(label[on & ~outer], minlength=count) > 0
    at_edge = np.bincount(label[-1:][on[-1:]], minlength=count) > 0
    flat = np.where(pairs > 0, 3 * steep < 2 * pairs, ~inner & ~at_edge)
    top = np.full(count, -1)
    np.maximum.at(top, label[on], height[on])
    bent = flat & (top <= round(config.bent_m / depth_unit))
    return renumbered(np.where(on & ~np.append(bent, False)[label], label, -1))


def renumbered(label: np.ndarray) -> np.ndarray:
    """Renumber labels as 0, 1, ... in the order of their first cells; negative labels become -1.

    Example:
        >>> renumbered(np.array([7, -1, 3, 7])).tolist()
        [0, -1, 1, 0]
    """
    values, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    none = values < 0
    rank = np.argsort(np.argsort(np.where(none, -1, first))) - np.count_nonzero(none)
    return np.where(none, -1, rank)[inverse.reshape(label.shape)]


def without_small(mask: np.ndarray, least: int) -> np.ndarray:
    """Remove 8-connected components of fewer than ``least`` cells from a mask."""
    first, second = _neighbours(mask, ((0, 1), (1, -1), (1, 0), (1, 1)))
    label = components(mask.size, first, second)
    return mask & (np.bincount(label, minlength=mask.size)[label] >= least).reshape(mask.shape)


def _neighbours(mask: np.ndarray, offsets: tuple[tuple[int, int], ...]) -> np.ndarray:
    """Return pairs of cells of a mask at ``offsets``, as flat indices ``(2, L)``."""
    cell = np.where(mask, np.arange(mask.size).reshape(mask.shape), -1)
    pairs = []
    for dv, du in offsets:
        there = _shifted(_shifted(cell + 1, -dv, 0), -du, 1) - 1
        both = mask & (there >= 0)
        pairs.append(np.stack([cell[both], there[both]]))
    return np.concatenate(pairs, axis=1)


def dilated(mask: np.ndarray) -> np.ndarray:
    """Dilate a mask by a square of 3 x 3."""
    for axis in (0, 1):
        mask = mask | _shifted(mask, 1, axis) | _shifted(mask, -1, axis)
    return mask


def _shifted(a: np.ndarray, by: int, axis: int) -> np.ndarray:
    """Shift an array by ``by`` cells along an axis, with 0 beyond the edge."""
    out = np.zeros_like(a)
    size = a.shape[axis]
    if abs(by) < size:
        to, source = [slice(None)] * 2, [slice(None)] * 2
        to[axis] = slice(max(by, 0), size + min(by, 0))
        source[axis] = slice(max(-by, 0), size + min(-by, 0))
        out[tuple(to)] = a[tuple(source)]
    return out


def _smoothed(values: np.ndarray, measured: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the rounded mean of the measured 3 x 3 neighbours that differ by at most ``near``."""
    total, count = np.zeros_like(values), np.zeros_like(values)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            there = _shifted(_shifted(values, dv, 0), du, 1)
            counts = _shifted(_shifted(measured.astype(np.int64), dv, 0), du, 1) > 0
            counts &= np.abs(there - values) <= near
            total += np.where(counts, there, 0)
            count += counts
    return np.where(measured, rounded(total, np.maximum(count, 1)), 0)


def _components(z: np.ndarray, step: np.ndarray, linked: np.ndarray) -> np.ndarray:
    """Return the smallest flat index of a cell in each cell's component, ``(R, C)``."""
    both = _neighbours(linked, ((0, 1), (1, 0)))
    (one, other), most = z.ravel()[both], step.ravel()[both].min(axis=0)
    return components(z.size, *both[:, np.abs(one - other) <= most]).reshape(z.shape)


def _across_holes(
    label: np.ndarray, z: np.ndarray, step: np.ndarray, linked: np.ndarray, longest: int
) -> np.ndarray:
    """Merge components ``(R, C)`` whose depth is continuous across unmeasured cells.

    Two linked cells of a row or a column are neighbours if there are 1 to ``longest`` cells between
    them, all of which are unmeasured.
    """
    cell = np.where(linked, np.arange(z.size).reshape(z.shape), -1)
    pairs = [np.zeros((2, 0), np.int64)]
    for axis in (0, 1):
        hole = np.ones(z.shape, bool)
        for away in range(1, min(longest, z.shape[axis]) + 1):
            hole &= _shifted(z == 0, -away, axis)
            there = _shifted(cell + 1, -away - 1, axis) - 1
            both = linked & hole & (there >= 0)
            pairs.append(np.stack([cell[both], there[both]]))
    both = np.concatenate(pairs, axis=1)
    (one, other), most = z.ravel()[both], step.ravel()[both].min(axis=0)
    near = label.ravel()[both[:, np.abs(one - other) <= most]]
    return components(z.size, *near)[label]


def _grown(
    label: np.ndarray, z: np.ndarray, step: np.ndarray, keep: np.ndarray, rounds: int
) -> np.ndarray:
    """Grow regions: a kept cell without a label takes that of the neighbour nearest in depth."""
    for _ in range(rounds):
        free = keep & (label < 0)
        best, taken = np.full(z.shape, 1 << 40), label.copy()
        for axis, by in ((1, 1), (1, -1), (0, 1), (0, -1)):
            there = _shifted(label + 1, by, axis) - 1
            apart = np.abs(_shifted(z, by, axis) - z)
            better = free & (there >= 0) & (apart <= step) & (apart < best)
            best, taken = np.where(better, apart, best), np.where(better, there, taken)
        label = taken
    return label
