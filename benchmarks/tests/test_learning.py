"""Training of the affinity tables."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sklearn")

from benchmarks import affinity as learning
from jaxdet.affinity import PAIR_FEATURES, Affinity, evidence

NUM_FEATURES = len(PAIR_FEATURES)
GAP, AGREE = PAIR_FEATURES.index("gap"), PAIR_FEATURES.index("agree")


def test_the_trained_table_reproduces_a_simple_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The trained table joins pairs with a small gap and common rows."""
    rng = np.random.default_rng(1)
    seen = rng.integers(0, 1000, (3000, NUM_FEATURES))
    same = (seen[:, GAP] < 300) & (seen[:, AGREE] > 400)
    found = learning.Examples(seen, same, rng.random(len(seen)) + 0.5)
    how = learning.Learning(trees=12, depth=3, rate=0.3, leaf=20, ridge=1.0, bias=0.0)
    monkeypatch.setattr(learning, "TABLES", tmp_path)
    learning.write("made", learning.learn(found, how))

    text = json.loads((tmp_path / "made.json").read_text("utf-8"))
    assert tuple(text["seen"]) == PAIR_FEATURES
    arrays = (np.array(text[key]) for key in ("feature", "threshold", "value"))
    table = Affinity(*arrays, text["offset"])
    fresh = rng.integers(0, 1000, (3000, NUM_FEATURES))
    expected = (fresh[:, GAP] < 300) & (fresh[:, AGREE] > 400)
    assert ((evidence(fresh, table) > 0) == expected).mean() > 0.98
