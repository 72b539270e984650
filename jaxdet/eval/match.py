"""Matching of detections and ground truth obstacles: points vote, and pairs are one to one."""

import numpy as np
from scipy.optimize import linear_sum_assignment


def feature_objects(
    obstacle_id: np.ndarray, is_wall: np.ndarray, u: np.ndarray, v: np.ndarray, tolerance: int
) -> np.ndarray:
    """Return the object that each feature votes for.

    A feature votes for the object in its pixel, or for the nearest one within ``tolerance`` (a
    square), since corners of a contour may be next to the object. Obstacles take priority over
    walls, and walls over floor.

    Args:
        obstacle_id: Object numbers ``(H, W)`` integer.
        is_wall: Whether each object is a wall, ``(J,)`` bool.
        u: Columns ``(n,)``.
        v: Rows ``(n,)``.
        tolerance: Maximum distance [pixel].

    Returns:
        Object numbers ``(n,)`` int64, 0 = floor.
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
    """Return, for each feature, a neighbouring object at the depth measured in the feature's pixel.

    Stereo matching dilates foreground objects, so a background pixel may have the depth of the
    obstacle next to it. The object is that of the nearest pixel within ``tolerance`` (a square)
    with the feature's depth, unless the feature's own pixel has this depth. Obstacles take priority
    over walls, walls over floor.

    Args:
        obstacle_id: Object numbers ``(H, W)`` integer.
        depth_m: True z in the colour camera, ``(H, W)`` float [m].
        is_wall: Whether each object is a wall, ``(J,)`` bool.
        u: Columns ``(n,)``.
        v: Rows ``(n,)``.
        z_m: Measured z ``(n,)`` [m].
        slack_m: Tolerance of the depth, ``(n,)`` [m].
        tolerance: Maximum distance of the pixel [pixel].

    Returns:
        Object numbers ``(n,)`` int64, 0 = floor, -1 if the feature's own pixel or no pixel has the
        measured depth.

    Example:
        >>> ids, depth = np.array([[1, 0, 0, 0]]), np.array([[1.0, 5.0, 5.0, 5.0]])
        >>> walls, u, v = np.array([False]), np.array([1, 2, 3]), np.array([0, 0, 0])
        >>> z, slack = np.array([1.1, 5.1, 1.0]), np.full(3, 0.2)
        >>> measured_objects(ids, depth, walls, u, v, z, slack, 2).tolist()
        [1, -1, -1]
    """
    rank, objects = _rank(is_wall), np.full(len(u), -1, np.int64)
    rest = np.flatnonzero(np.abs(depth_m[v, u] - z_m) > slack_m)
    around = _around(np.pad(obstacle_id, tolerance), u[rest], v[rest], tolerance).astype(np.int64)
    depth = np.pad(depth_m, tolerance, constant_values=np.inf)
    off = np.abs(_around(depth, u[rest], v[rest], tolerance) - z_m[rest, None])
    ranks = np.where(off <= slack_m[rest, None], rank[around], -1)
    best = np.argmax(ranks, axis=1)[:, None]
    agrees = np.take_along_axis(ranks, best, 1)[:, 0] >= 0
    objects[rest[agrees]] = np.take_along_axis(around, best, 1)[agrees, 0]
    return objects


def _around(padded: np.ndarray, u: np.ndarray, v: np.ndarray, tolerance: int) -> np.ndarray:
    """Return the values of a padded image around each pixel, nearest first, ``(n, k)``."""
    reach = np.arange(2 * tolerance + 1)
    dv, du = (a.ravel() for a in np.meshgrid(reach, reach, indexing="ij"))
    order = np.argsort((du - tolerance) ** 2 + (dv - tolerance) ** 2, kind="stable")
    return padded[v[:, None] + dv[order], u[:, None] + du[order]]


def _rank(is_wall: np.ndarray) -> np.ndarray:
    """Return the priority by object number: 0 floor, 1 wall, 2 obstacle."""
    return np.concatenate([[0], np.where(is_wall, 1, 2)])


def vote_table(labels: np.ndarray, objects: np.ndarray, detections: int, count: int) -> np.ndarray:
    """Count the points of each detection that vote for each object.

    Args:
        labels: Detection of each point, ``(n,)`` integer, -1 = none.
        objects: Object number of each point, ``(n,)`` integer, 0 = floor.
        detections: Number of detections ``L``.
        count: Number of objects and the floor, ``J + 1``.

    Returns:
        Votes ``(L, J + 1)`` int64.

    Example:
        >>> vote_table(np.array([0, 0, 1, -1]), np.array([2, 0, 1, 1]), 2, 3).tolist()
        [[1, 0, 1], [0, 1, 0]]
    """
    used = labels >= 0
    cells = labels[used].astype(np.int64) * count + objects[used]
    return np.bincount(cells, minlength=detections * count).reshape(detections, count)


def match(votes: np.ndarray, is_obstacle: np.ndarray, share: float = 0.5) -> np.ndarray:
    """Match detections and obstacles one to one (linear assignment).

    A detection and an obstacle may match if at least ``share`` of the detection's votes are for the
    obstacle. The assignment maximises the votes of all pairs; in a tie, the fractions of votes.

    Args:
        votes: Votes ``(L, J + 1)`` integer, see :func:`vote_table`.
        is_obstacle: Whether each object is an obstacle, ``(J + 1,)`` bool, False for the floor and
            walls.
        share: Minimum fraction of votes, 0 to 1.

    Returns:
        Number of the obstacle matched to each detection, ``(L,)`` int64, 0 = none.

    Example:
        >>> yes = np.array([False, True, True])
        >>> match(np.array([[0, 5, 3], [0, 4, 0], [9, 0, 2]]), yes).tolist()
        [1, 0, 0]
    """
    able = eligible(votes, is_obstacle, share)
    shares = votes / np.maximum(votes.sum(axis=1, keepdims=True), 1)
    # The fractions of all pairs add up to less than one vote.
    weight = np.where(able, votes + shares / (len(votes) + 1), 0.0)
    rows, columns = linear_sum_assignment(weight, maximize=True)
    paired = weight[rows, columns] > 0
    matched = np.zeros(len(votes), np.int64)
    matched[rows[paired]] = columns[paired]
    return matched


def eligible(votes: np.ndarray, is_obstacle: np.ndarray, share: float) -> np.ndarray:
    """Return which pairs of a detection and an object may match, ``(L, J + 1)`` bool.

    The arguments are those of :func:`match`.
    """
    whole = votes.sum(axis=1, keepdims=True)
    return is_obstacle & (votes > 0) & (votes >= share * whole)
