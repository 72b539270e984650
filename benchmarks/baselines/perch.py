"""PERCH: binary tree into which points are inserted one by one, with rotations.

Kobren, Monath, Krishnamurthy and McCallum, A hierarchical algorithm for extreme clustering, KDD
2017, 255-264. A point becomes the sibling of the nearest leaf. Then branches are rotated, upwards
from there, if a node is nearer to its aunt than to its sibling (masking), and if the tree is better
balanced afterwards and no such nodes result. Distances between nodes are bounded by those of their
boxes (Section 4 of the paper). Nodes are not collapsed. The nearest leaf is searched among all
leaves instead of by the tree, with the same result.
"""

from math import hypot

import numpy as np

Box = tuple[float, float, float, float]
"""Smallest x and y, largest x and y."""


def perch(points: np.ndarray, diagonal_m: float) -> np.ndarray:
    """Cluster points: clusters are the largest branches whose box is small enough.

    The paper cuts the tree into a given number of clusters by the same cost, without threshold.

    Args:
        points: Points ``(n, 2)`` [m], in the order of their insertion.
        diagonal_m: Maximum diagonal of a cluster's box [m].

    Returns:
        Labels ``(n,)`` int64.
    """
    tree = Tree(points)
    labels = np.zeros(len(points), np.int64)
    for number, leaves in enumerate(tree.branches(diagonal_m)):
        labels[leaves] = number
    return labels


class Tree:
    """Tree of points, built by inserting one after the other.

    Nodes are numbers: points below ``n``, branches from ``n`` on.

    Args:
        points: Points ``(n, 2)``, n >= 1.
    """

    def __init__(self, points: np.ndarray) -> None:
        points = np.asarray(points, np.float64)
        count = len(points)
        self.count, self.root = count, 0
        self.box: list[Box] = [(x, y, x, y) for x, y in points.tolist()]
        self.size = [1] * count
        self.parent = [-1] * (2 * count - 1)
        self.children: list[tuple[int, int]] = [(-1, -1)] * count
        for leaf in range(1, count):
            square = np.sum((points[:leaf] - points[leaf]) ** 2, axis=1)
            self._insert(leaf, int(np.argmin(square)))

    def branches(self, diagonal: float) -> list[list[int]]:
        """Return the leaves of each of the largest nodes whose box has at most this diagonal."""
        found: list[list[int]] = []
        nodes = [self.root]
        while nodes:
            node = nodes.pop()
            left, low, right, high = self.box[node]
            if node < self.count or hypot(right - left, high - low) <= diagonal:
                found.append(self.leaves(node))
            else:
                nodes += self.children[node]
        return found

    def leaves(self, node: int) -> list[int]:
        """Return the points below a node."""
        found, nodes = [], [node]
        while nodes:
            node = nodes.pop()
            if node < self.count:
                found.append(node)
            else:
                nodes += self.children[node]
        return found

    def sibling(self, node: int) -> int:
        """Return the other child of the node's parent."""
        first, second = self.children[self.parent[node]]
        return second if node == first else first

    def masked(self, node: int) -> bool:
        """Return whether a node that has an aunt is nearer to its aunt than to its sibling."""
        own, aunt = self.box[node], self.box[self.sibling(self.parent[node])]
        return _most(own, aunt) < _least(own, self.box[self.sibling(node)])

    def _insert(self, leaf: int, nearest: int) -> None:
        above, branch = self.parent[nearest], len(self.children)
        self.children.append((nearest, leaf))
        self.box.append(_union(self.box[nearest], self.box[leaf]))
        self.size.append(2)
        self.parent[branch] = above
        self.parent[nearest] = self.parent[leaf] = branch
        if above < 0:
            self.root = branch
        else:
            self._replace(above, nearest, branch)
        while above >= 0:
            self.size[above] += 1
            self.box[above] = _union(self.box[above], self.box[leaf])
            above = self.parent[above]
        self._unmask(nearest)
        self._balance(self.sibling(leaf))

    def _unmask(self, node: int) -> None:
        """Rotate masked nodes, upwards until an inner node is not masked."""
        while self._has_aunt(node):
            if self.masked(node):
                self._rotate(node)
            elif node >= self.count:
                break
            node = self.parent[node]

    def _balance(self, node: int) -> None:
        """Rotate nodes upwards if that balances the tree, the smaller of two siblings first."""
        while self._has_aunt(node):
            pair = sorted((self.sibling(node), node), key=self.size.__getitem__)
            for one in pair:
                if self._balances(one):
                    self._rotate(one)
                    node = one
                    break
            node = self.parent[node]

    def _balances(self, node: int) -> bool:
        """Return whether a rotation results in more equal branches and does not mask the node."""
        sibling, aunt = self.sibling(node), self.sibling(self.parent[node])
        own, other, far = self.size[node], self.size[sibling], self.size[aunt]
        if abs(other - own - far) >= abs(own + other - far):
            return False
        box = self.box[node]
        return _most(box, self.box[sibling]) > _least(box, self.box[aunt])

    def _rotate(self, node: int) -> None:
        """Exchange the node's sibling and its aunt."""
        parent = self.parent[node]
        sibling, aunt, top = self.sibling(node), self.sibling(parent), self.parent[parent]
        self.children[top], self.children[parent] = (parent, sibling), (aunt, node)
        self.parent[sibling], self.parent[aunt] = top, parent
        self.box[parent] = _union(self.box[aunt], self.box[node])
        self.size[parent] = self.size[aunt] + self.size[node]

    def _has_aunt(self, node: int) -> bool:
        return self.parent[node] >= 0 and self.parent[self.parent[node]] >= 0

    def _replace(self, node: int, old: int, new: int) -> None:
        first, second = self.children[node]
        self.children[node] = (new, second) if first == old else (first, new)


def _union(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _least(a: Box, b: Box) -> float:
    """Return the smallest distance between points of two boxes."""
    return hypot(max(a[0] - b[2], b[0] - a[2], 0.0), max(a[1] - b[3], b[1] - a[3], 0.0))


def _most(a: Box, b: Box) -> float:
    """Return the largest distance between points of two boxes."""
    return hypot(max(a[2] - b[0], b[2] - a[0]), max(a[3] - b[1], b[3] - a[1]))
