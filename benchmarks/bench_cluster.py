"""Benchmark of point clustering, against a NumPy loop, scikit-learn, SciPy and our RSC."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np

from benchmarks.baselines.sortgap import sort_and_gap
from benchmarks.points import camera, points, settings
from benchmarks.run import Case, Missing, with_peer
from benchmarks.sweep import Point, kind
from jaxdet import reference, stages
from jaxdet.config import Config
from jaxdet.presets import preset
from jaxdet.types import Features

PAPER = preset("paper")
COUNT = 1000
BATCHES = {"cpu": 64, "gpu": 1024}
PEER_FRAMES = 4
"""Number of frames for the slow peers."""
UNIT = camera().depth_unit
PEERS = {
    "ward": "hierarchical_ward",
    "single": "hierarchical_single",
    "dbscan": "dbscan",
    "hdbscan": "hdbscan",
    "scipy": "scipy_single",
    "rsc": "rsc",
}
"""Names of cases, ``vs_<name>``, and the baselines they run with default parameters."""


def cases() -> list[Case | Missing]:
    """Cluster 1000 kept points per frame on the device; the peers process one frame at a time.

    The NumPy loop has the paper's rule too, so its labels must be equal to jaxdet's.
    """
    host = points(BATCHES[kind()], COUNT)
    few = Features(*(a[:PEER_FRAMES] for a in host))
    clouds = [_metres(few, b) for b in range(PEER_FRAMES)]
    ours = _case(host, settings(PAPER, COUNT))._replace(equal=True)
    found: list[Case | Missing] = [
        ours._replace(
            name="vs_numpy",
            peer=partial(sort_and_gap, host, UNIT, PAPER),
            compared=lambda result: result.labels,
        ),
        ours._replace(
            name="vs_reference",
            peer=partial(_reference, few, settings(PAPER, COUNT)),
            peer_frames=PEER_FRAMES,
            compared=lambda result: result.labels[:PEER_FRAMES],
        ),
    ]
    slow = ours._replace(peer_frames=PEER_FRAMES, equal=False)
    for name, baseline in PEERS.items():
        make = partial(_with_baseline, slow, f"vs_{name}", baseline, clouds)
        remedy = "install the extra bench"
        found.append(with_peer(f"vs_{name}", "benchmarks.baselines", remedy, make))
    return found


def at(point: Point) -> Case:
    """Cluster ``slots`` kept points per frame on the device."""
    host = points(point.batch, point.slots)
    read = host.x.nbytes + host.z.nbytes + host.kept.nbytes
    return _case(host, settings(PAPER, point.slots))._replace(name=point.name, bytes_read=read)


def _case(host: Features, config: Config) -> Case:
    features = jax.device_put(host)
    return Case("", partial(stages.paper.cluster, features, UNIT, config), len(host.x))


def _reference(features: Features, config: Config) -> np.ndarray:
    return reference.paper.cluster(features, UNIT, config).labels


def _metres(features: Features, b: int) -> np.ndarray:
    """Return the points of frame ``b``, ``(N, 3)`` float64 x y z [m]."""
    return np.stack([features.x[b], features.y[b], features.z[b]], axis=1) * UNIT


def _each(
    method: Callable[..., np.ndarray], clouds: list[np.ndarray], **settings: Any
) -> list[np.ndarray]:
    return [method(cloud, **settings) for cloud in clouds]


def _with_baseline(
    case: Case, name: str, baseline: str, clouds: list[np.ndarray], module: Any
) -> Case:
    method = module.BASELINES[baseline]
    chosen = dict(method.defaults)
    if method.sized:
        chosen["min_points"] = PAPER.cluster.min_points
    flat = [cloud[:, [0, 2]] for cloud in clouds]
    return case._replace(name=name, peer=partial(_each, method.run, flat, **chosen))
