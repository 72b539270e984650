"""Learned pairwise merge model: the evidence that two surfaces belong to the same object."""

import json
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

PAIR_FEATURES = (
    "gap",
    "ahead",
    "overlap",
    "step",
    "through",
    "hidden_share",
    "agree",
    "agree_share",
    "through_in_columns",
    "between_in_columns",
    "nearest",
    "cells_less",
    "cells_more",
    "width_less",
    "width_more",
    "depth_less",
    "depth_more",
    "bottom_less",
    "bottom_more",
    "top_less",
    "top_more",
    "behind",
    "rows",
    "columns",
    "through_share",
    "through_share_in_columns",
)
"""Names of the features of a pair of surfaces.

``*_less`` is a property of the surface with fewer cells, ``*_more`` of the other one.

- On the floor: ``gap``, distance between the contours; ``ahead``, forward gap; ``overlap``, lateral
  overlap in percent of the narrower surface; ``nearest``, distance of the nearer surface;
  ``behind``, distance of the surface with fewer cells minus distance of the other one.
- ``rows`` and ``columns``: number of places in rows and in columns where the surfaces face each
  other. ``through`` and ``through_in_columns``: number of those with free sight, that is with floor
  or something farther in between; ``through_share`` and ``through_share_in_columns``: the same in
  percent. ``between_in_columns``: number of those with a nearer object or a hole in between.
- ``agree``: number of places in rows where the depth continues behind a nearer object or across a
  hole. ``agree_share``: the same in percent of the rows of the surface with fewer rows, as is
  ``hidden_share``: places in rows with a nearer object in between.
- ``step``: mean depth difference at the places in rows without free sight.
"""
LENGTHS = frozenset({"gap", "ahead", "step", "nearest", "behind"}) | {
    name for name in PAIR_FEATURES if name.split("_")[0] in ("width", "depth", "bottom", "top")
}
"""Features that are lengths [depth units]; their thresholds in a table file are in millimetres."""
GROWS = {
    "gap": -1,
    "ahead": -1,
    "step": -1,
    "through": -1,
    "through_in_columns": -1,
    "through_share": -1,
    "through_share_in_columns": -1,
    "agree": 1,
    "agree_share": 1,
}
"""Monotonic constraints: evidence never decreases (1) or never increases (-1) with a feature."""
NO_STEP = 10_000
"""Value of the feature ``step`` if two surfaces do not face each other in any row [mm]."""
BEYOND = 1 << 30
"""Threshold that no feature exceeds."""
FRACTION_BITS = 8
"""Fraction bits of evidence (log-odds)."""


class Affinity(NamedTuple):
    """An ensemble of ``T`` gradient-boosted regression trees.

    Each tree is a complete binary tree of depth ``D``. Node ``k`` has the children ``2 k + 1``, for
    features up to its threshold, and ``2 k + 2``, for larger ones (Friedman, *Greedy function
    approximation: a gradient boosting machine*, Annals of Statistics 29(5), 2001).
    """

    feature: np.ndarray
    """Feature that a node compares, index in :data:`PAIR_FEATURES`, ``(T, 2**D - 1)`` int64."""
    threshold: np.ndarray
    """Threshold of each node, ``(T, 2**D - 1)`` int64."""
    value: np.ndarray
    """Evidence of each leaf, ``(T, 2**D)`` int64."""
    offset: int
    """Constant term of the evidence; the evidence of the trees is added to it."""

    @property
    def depth(self) -> int:
        """Depth ``D`` of the trees."""
        return self.value.shape[1].bit_length() - 1


@cache
def affinity(name: str, depth_unit: float) -> Affinity:
    """Load a model of the package, with lengths in depth units.

    Models are trained by ``python -m benchmarks.affinity``, for cells with ``surface.cell_rad``
    0.0078.

    Args:
        name: ``surfaces`` or ``tabletop``.
        depth_unit: Metres per depth unit.
    """
    text = resources.files("jaxdet").joinpath("tables", f"{name}.json").read_text("utf-8")
    table = json.loads(text)
    used = np.array([PAIR_FEATURES.index(one) for one in table["seen"]])
    feature = used[np.array(table["feature"], np.int64)]
    threshold = np.array(table["threshold"], np.int64)
    lengths = np.isin(feature, [PAIR_FEATURES.index(one) for one in LENGTHS])
    scaled = np.rint(threshold / (1000 * depth_unit)).astype(np.int64)
    scaled = np.minimum(scaled, BEYOND)
    value = np.array(table["value"], np.int64)
    return Affinity(feature, np.where(lengths, scaled, threshold), value, table["offset"])


def evidence(seen: np.ndarray, table: Affinity) -> np.ndarray:
    """Compute the evidence that pairs of surfaces belong to the same object.

    Args:
        seen: Features ``(P, 26)`` integer, in the order of :data:`PAIR_FEATURES`.
        table: Model, in the same depth units.

    Returns:
        Log-odds ``(P,)`` int64 with ``FRACTION_BITS`` fraction bits; positive: the same object.
    """
    pair, tree = np.ogrid[: len(seen), : len(table.feature)]
    node = np.zeros((len(seen), len(table.feature)), np.int64)
    for _ in range(table.depth):
        larger = seen[pair, table.feature[tree, node]] > table.threshold[tree, node]
        node = 2 * node + 1 + larger
    leaf = node - (table.value.shape[1] - 1)
    return table.offset + table.value[tree, leaf].sum(axis=1)
