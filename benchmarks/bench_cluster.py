"""Stage 4, cluster, against the reference and scikit-learn's hierarchical clustering."""

import jax
import numpy as np
from sklearn.cluster import AgglomerativeClustering

from benchmarks.run import Case
from benchmarks.scene import BATCH, CONFIG, Inputs, inputs
from jaxdet import reference, stages


def cases() -> list[Case]:
    """One batch of features on the device, two peers."""
    given = inputs("640x480")
    unit = given.calibration.depth_unit
    features = jax.device_put(given.features)
    case = Case(
        name=f"reference.b{BATCH}",
        run=lambda: stages.cluster(features, given.plane, unit, CONFIG),
        frames=BATCH,
        peer=lambda: reference.cluster(given.features, given.plane, unit, CONFIG),
        equal=True,
    )
    sklearn = case._replace(name=f"sklearn.b{BATCH}", peer=lambda: hierarchical(given), equal=False)
    return [case, sklearn]


def hierarchical(given: Inputs) -> list[np.ndarray]:
    """Single linkage of the kept points in x and z; another rule than ours, the same job."""
    gap = CONFIG.cluster.depth_gap_m / given.calibration.depth_unit
    single = AgglomerativeClustering(
        n_clusters=None,  # pyright: ignore[reportArgumentType] (scikit-learn documents None)
        linkage="single",
        distance_threshold=gap,
    )
    x, z, kept = given.features.x, given.features.z, given.features.kept
    points = [np.stack([x[i, kept[i]], z[i, kept[i]]], axis=1) for i in range(BATCH)]
    return [single.fit_predict(p) for p in points if len(p) > 1]
