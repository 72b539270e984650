"""Which detection is which obstacle: votes of the features, then one to one."""

import numpy as np
from scipy.optimize import linear_sum_assignment


def feature_objects(
    obstacle_id: np.ndarray, is_wall: np.ndarray, u: np.ndarray, v: np.ndarray, tolerance: int
) -> np.ndarray:
    """The object each feature votes for.

    It is the object the feature lies on, or the nearest one within ``tolerance`` (a square),
    since the corners of a contour fall beside the object; obstacles go before walls and walls
    before floor.

    Args:
        obstacle_id: ``(H, W)`` integer.
        is_wall: ``(J,)`` bool.
        u: ``(n,)`` columns.
        v: ``(n,)`` rows.
        tolerance: How far away it may lie [pixel].

    Returns:
        ``(n,)`` int64 object numbers, 0 = floor.
    """
    around = _around(np.pad(obstacle_id, tolerance), u, v, tolerance).astype(np.int64)
    best = np.argmax(_rank(is_wall)[around], axis=1)
    return np.take_along_axis(around, best[:, None], 1)[:, 0]


def measured_objects(
    obstacle_id: np.ndarray,
    depth_m: np.ndarray,
    is_wall: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    z_m: np.ndarray,
    slack_m: np.ndarray,
    tolerance: int,
) -> np.ndarray:
    """The object beside each feature whose true depth is the one measured.

    A stereo camera smears near things over what is beside them, so a pixel that shows the
    background may have the depth of the obstacle beside it. The object is that of the nearest
    pixel within ``tolerance`` (a square) whose true depth is the feature's, unless the feature's
    own pixel has it; obstacles go before walls and walls before floor.

    Args:
        obstacle_id: ``(H, W)`` integer.
        depth_m: ``(H, W)`` float, true z in the colour camera [m].
        is_wall: ``(J,)`` bool.
        u: ``(n,)`` columns.
        v: ``(n,)`` rows.
        z_m: ``(n,)`` measured z [m].
        slack_m: ``(n,)`` how far a true depth may be from it [m].
        tolerance: How far away the pixel may lie [pixel].

    Returns:
        ``(n,)`` int64 object numbers, 0 = floor, -1 where the own pixel's true depth or none is
        the measured one.

    Example:
        >>> ids, depth = np.array([[1, 0, 0, 0]]), np.array([[1.0, 5.0, 5.0, 5.0]])
        >>> walls, u, v = np.array([False]), np.array([1, 2, 3]), np.array([0, 0, 0])
        >>> z, slack = np.array([1.1, 5.1, 1.0]), np.full(3, 0.2)
        >>> measured_objects(ids, depth, walls, u, v, z, slack, 2).tolist()
        [1, -1, -1]
    """
    rank, found = _rank(is_wall), np.full(len(u), -1, np.int64)
    rest = np.flatnonzero(np.abs(depth_m[v, u] - z_m) > slack_m)
    around = _around(np.pad(obstacle_id, tolerance), u[rest], v[rest], tolerance).astype(np.int64)
    depth = np.pad(depth_m, tolerance, constant_values=np.inf)
    off = np.abs(_around(depth, u[rest], v[rest], tolerance) - z_m[rest, None])
    ranks = np.where(off <= slack_m[rest, None], rank[around], -1)
    best = np.argmax(ranks, axis=1)[:, None]
    agrees = np.take_along_axis(ranks, best, 1)[:, 0] >= 0
    found[rest[agrees]] = np.take_along_axis(around, best, 1)[agrees, 0]
    return found


def _around(padded: np.ndarray, u: np.ndarray, v: np.ndarray, tolerance: int) -> np.ndarray:
    """What a padded image holds at each place and around it, nearest first, ``(n, k)``."""
    reach = np.arange(2 * tolerance + 1)
    dv, du = (a.ravel() for a in np.meshgrid(reach, reach, indexing="ij"))
    order = np.argsort((du - tolerance) ** 2 + (dv - tolerance) ** 2, kind="stable")
    return padded[v[:, None] + dv[order], u[:, None] + du[order]]


def _rank(is_wall: np.ndarray) -> np.ndarray:
    """By object number: 0 the floor, 1 a wall, 2 an obstacle."""
    return np.concatenate([[0], np.where(is_wall, 1, 2)])


def vote_table(labels: np.ndarray, objects: np.ndarray, detections: int, count: int) -> np.ndarray:
    """How many points of each detection vote for each object.

    Args:
        labels: ``(n,)`` integer, -1 = none.
        objects: ``(n,)`` integer, object number, 0 = floor.
        detections: ``L``.
        count: ``J + 1``.

    Returns:
        ``(L, J + 1)`` int64.

    Example:
        >>> vote_table(np.array([0, 0, 1, -1]), np.array([2, 0, 1, 1]), 2, 3).tolist()
        [[1, 0, 1], [0, 1, 0]]
    """
    used = labels >= 0
    cells = labels[used].astype(np.int64) * count + objects[used]
    return np.bincount(cells, minlength=detections * count).reshape(detections, count)


def match(votes: np.ndarray, is_obstacle: np.ndarray, share: float = 0.5) -> np.ndarray:
    """Matches detections and obstacles one to one.

    A detection and an obstacle can be a pair when at least ``share`` of the detection's votes
    are for the obstacle. Of all ways to pair them, the one with the most votes in its pairs is
    taken; of equal ones, that whose detections have the larger shares of their votes in it.

    Args:
        votes: ``(L, J + 1)`` integer, see :func:`vote_table`.
        is_obstacle: ``(J + 1,)`` bool, False for the floor and for walls.
        share: Between 0 and 1.

    Returns:
        ``(L,)`` int64, number of the obstacle that each detection is paired with, 0 = none.

    Example:
        >>> yes = np.array([False, True, True])
        >>> match(np.array([[0, 5, 3], [0, 4, 0], [9, 0, 2]]), yes).tolist()
        [1, 0, 0]
    """
    able = eligible(votes, is_obstacle, share)
    shares = votes / np.maximum(votes.sum(axis=1, keepdims=True), 1)
    # The shares of all pairs together stay below one vote.
    weight = np.where(able, votes + shares / (len(votes) + 1), 0.0)
    rows, columns = linear_sum_assignment(weight, maximize=True)
    paired = weight[rows, columns] > 0
    found = np.zeros(len(votes), np.int64)
    found[rows[paired]] = columns[paired]
    return found


def eligible(votes: np.ndarray, is_obstacle: np.ndarray, share: float) -> np.ndarray:
    """Which pairs may match: ``(L, J + 1)`` bool."""
    whole = votes.sum(axis=1, keepdims=True)
    return is_obstacle & (votes > 0) & (votes >= share * whole)
