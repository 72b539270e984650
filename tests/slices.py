"""Points and settings that the tests of slices and surfaces share."""

from dataclasses import replace

import numpy as np
import pytest

from jaxdet import reference, stages
from jaxdet.config import ClusterConfig, Config
from jaxdet.types import Features
from tests.scenes import points

BACKENDS = pytest.mark.parametrize("backend", [reference, stages], ids=["reference", "stages"])


def config(corners: int = 1024, **cluster) -> Config:
    """Slices of 100 mm, gaps of 100 mm in depth and 50 mm sideways."""
    given_ = {"lateral_gap_m": 0.05, "slice_m": 0.1, "min_points": 0, "occluder_slope": 0.0}
    given_ |= {"surface_gap_per_m": 0.0, **cluster}
    base = Config()
    features = replace(base.features, max_corners=corners)
    return replace(base, features=features, cluster=ClusterConfig(**given_))


def labels(backend, features: Features, settings_: Config) -> list[int]:
    found = backend.cluster(features, 0.001, settings_).labels
    return np.asarray(found)[0].tolist()


def row_labels(backend, features: Features, settings_: Config) -> list[int]:
    """Of the points after the corner."""
    return labels(backend, features, settings_)[1:]


def rows_of(rng: np.random.Generator, batch: int, n: int, corners: int, spread: int) -> Features:
    """Random points, the grid's in rows of 23, as a wall with things before it and holes."""
    x, z = rng.integers(-spread, spread, (batch, n)), rng.integers(1, spread, (batch, n))
    near = rng.random((batch, n)) < 0.3
    z = np.where(near, z // 2 + 1, z)
    z[rng.random((batch, n)) < 0.1] = 0
    features = points(x, z, (z > 0) & (rng.random((batch, n)) < 0.8))
    v = np.maximum(np.arange(n) - corners, 0) // 23
    u = rng.integers(0, 640, (batch, n)).astype(np.int32)
    y = rng.integers(-20, 20, (batch, n)) + 40 * v
    return features._replace(
        u=u, v=np.broadcast_to(v.astype(np.int32), z.shape), y=y.astype(np.int32)
    )
