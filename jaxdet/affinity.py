"""Affinity of surfaces: from what is seen of two of them, the evidence that they are one thing."""

import json
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

SEEN = (
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
"""What is seen of two surfaces, ``less`` the one of fewer cells and ``more`` the other. ``gap``:
smallest distance of their contours on the floor; ``ahead``: the gap in depth on the floor;
``overlap``: sideways, in percent of the narrower. In the rows where they face each other, ``step``:
their mean step in depth; ``through``: rows in which one sees through between them; ``hidden_share``
and ``agree_share``: those in which nearer things lie between, and in which depth goes on behind
them or across a hole, in percent of the rows of the one with fewer. ``nearest``: distance of the
nearer one; ``behind``: how much farther away ``less`` begins than ``more``. In columns, ``through``
likewise, and ``between`` those in which they face each other across something. ``rows`` and
``columns``: places in which they face each other; ``through_share``: of these those in which one
sees through, in percent."""
LENGTHS = frozenset({"gap", "ahead", "step", "nearest", "behind"}) | {
    name for name in SEEN if name.split("_")[0] in ("width", "depth", "bottom", "top")
}
"""Of these, what is in depth units; in a table [mm]."""
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
"""Evidence never falls with a larger value (1), or never rises with it (-1)."""
NO_STEP = 10_000
"""Step in depth [mm] of two surfaces that do not face each other in any row."""
BEYOND = 1 << 30
"""Threshold that nothing exceeds."""
FRACTION_BITS = 8
"""Fraction bits of evidence, which is log-odds."""


class Affinity(NamedTuple):
    """Boosted regression trees, ``T`` of them, each complete and ``D`` deep.

    Friedman, *Greedy function approximation: a gradient boosting machine*, Annals of Statistics
    29(5), 2001. Node ``k`` has the children ``2 k + 1`` (at most the threshold) and ``2 k + 2``.
    """

    feature: np.ndarray
    """``(T, 2**D - 1)`` int64, which of :data:`SEEN` a node looks at."""
    threshold: np.ndarray
    """``(T, 2**D - 1)`` int64, what is larger goes to the second child."""
    value: np.ndarray
    """``(T, 2**D)`` int64, evidence of the leaves."""
    offset: int
    """Evidence to begin with."""

    @property
    def depth(self) -> int:
        """``D``."""
        return self.value.shape[1].bit_length() - 1


@cache
def affinity(name: str, depth_unit: float) -> Affinity:
    """A table of the package, lengths in depth units.

    Tables are made by ``python -m benchmarks.affinity``.

    Tables hold for cells of the size they were learnt with, ``surface.cell_rad`` 0.0078.

    Args:
        name: ``surfaces`` or ``tabletop``.
        depth_unit: Metres in one depth unit.
    """
    text = resources.files("jaxdet").joinpath("tables", f"{name}.json").read_text("utf-8")
    table = json.loads(text)
    weighed = np.array([SEEN.index(one) for one in table["seen"]])
    feature = weighed[np.array(table["feature"], np.int64)]
    threshold = np.array(table["threshold"], np.int64)
    lengths = np.isin(feature, [SEEN.index(one) for one in LENGTHS])
    scaled = np.rint(threshold / (1000 * depth_unit)).astype(np.int64)
    scaled = np.minimum(scaled, BEYOND)
    value = np.array(table["value"], np.int64)
    return Affinity(feature, np.where(lengths, scaled, threshold), value, table["offset"])


def evidence(seen: np.ndarray, table: Affinity) -> np.ndarray:
    """The evidence that pairs of surfaces are one thing.

    Args:
        seen: ``(P, 26)`` integer, in the order of :data:`SEEN`.
        table: In the same depth units.

    Returns:
        ``(P,)`` int64, log-odds with ``FRACTION_BITS`` fraction bits: above 0 for, below against.
    """
    pair, tree = np.ogrid[: len(seen), : len(table.feature)]
    node = np.zeros((len(seen), len(table.feature)), np.int64)
    for _ in range(table.depth):
        larger = seen[pair, table.feature[tree, node]] > table.threshold[tree, node]
        node = 2 * node + 1 + larger
    leaf = node - (table.value.shape[1] - 1)
    return table.offset + table.value[tree, leaf].sum(axis=1)
