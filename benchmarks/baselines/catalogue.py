"""The baselines, with their parameters and citations."""

from dataclasses import asdict

from benchmarks.baselines import clustering, cure, dcc, ddc, dense, perch, rock, rsc
from benchmarks.baselines.registry import Baseline
from jaxdet.presets import preset

SCALES = (1.0, 4.0)
"""Factors for z: 1, or the ratio of the paper's gaps, 0.40 m sideways and 0.10 m in depth."""
DISTANCES_M = (0.1, 0.2, 0.3, 0.4, 0.6, 0.9)
SKLEARN = "scikit-learn: Pedregosa et al., JMLR 12 (2011), 2825-2830"
RSC = "Xie et al., Information Sciences 527 (2020), 279-292; our reading"


def _hierarchical(linkage: str, default_m: float, distances_m: tuple[float, ...]) -> Baseline:
    return Baseline(
        name=f"hierarchical_{linkage}",
        title=f"Hierarchical ({linkage})",
        run=clustering.hierarchical,
        space="xz",
        citation=f"AgglomerativeClustering of {SKLEARN}",
        defaults={"linkage": linkage, "distance_m": default_m},
        grid={"distance_m": distances_m, "depth_scale": SCALES},
    )


def _rsc(name: str, title: str, root: str) -> Baseline:
    return Baseline(
        name=name,
        title=title,
        run=rsc.rsc_threshold,
        space="xz",
        citation=RSC,
        defaults={"tau": 0.2, "root": root},
        grid={"tau": (0.05, *DISTANCES_M), "depth_scale": SCALES},
    )


_ALL = (
    Baseline(
        name="paper",
        title="The paper's rule (reference)",
        run=clustering.paper,
        space="frame",
        citation="Liu et al., Electronics 12 (2023), 2316, Section 3.4",
        defaults=asdict(preset("paper").cluster),
        grid={
            "depth_gap_m": (0.05, 0.1, 0.2, 0.4),
            "lateral_gap_m": (0.2, 0.4, 0.6),
        },
    ),
    Baseline(
        name="hierarchical_default",
        title="Hierarchical (scikit-learn's defaults)",
        run=clustering.hierarchical_count,
        space="xz",
        citation=f"AgglomerativeClustering of {SKLEARN}; the paper's traditional method is from "
        "that library, without a word on its parameters",
        defaults={"clusters": 2},
    ),
    Baseline(
        name="printed",
        title="Algorithm 1 as printed",
        run=clustering.printed,
        space="xz",
        citation="Liu et al., Electronics 12 (2023), 2316, Algorithm 1",
        defaults={"depth_gap_m": 0.4, "lateral_gap_m": 0.8},
        grid={
            "depth_gap_m": (0.1, 0.2, 0.4, 0.8),
            "lateral_gap_m": (0.2, 0.4, 0.8, 1.6),
        },
    ),
    _hierarchical("ward", 1.0, (0.3, 0.6, 1.0, 2.0, 4.0, 8.0)),
    _hierarchical("complete", 0.6, (0.3, 0.4, 0.6, 0.9, 1.3, 2.0)),
    _hierarchical("average", 0.4, DISTANCES_M),
    _hierarchical("single", 0.2, DISTANCES_M),
    _rsc("rsc", "RSC (our reading)", "midpoint"),
    _rsc("rsc_member", "RSC (our reading), root B", "member"),
    _rsc("rsc_mean", "RSC (our reading), root C", "mean"),
    Baseline(
        name="rsc_count",
        title="RSC (our reading), K given",
        run=rsc.rsc_count,
        space="xz",
        citation=RSC,
        defaults={"clusters": 4, "root": "midpoint"},
        grid={"clusters": (1, 2, 3, 4, 5, 6, 8, 12), "depth_scale": SCALES},
    ),
    Baseline(
        name="cure",
        title="CURE",
        run=cure.cure,
        space="xz",
        citation="Guha, Rastogi, Shim, SIGMOD 1998, 73-84; written anew",
        defaults={"distance_m": 0.3, "representatives": 5, "shrink": 0.3},
        grid={"distance_m": (0.2, 0.3, 0.4, 0.6, 0.9, 1.3), "depth_scale": SCALES},
    ),
    Baseline(
        name="rock",
        title="ROCK",
        run=rock.rock,
        space="xz",
        citation="Guha, Rastogi, Shim, Information Systems 25 (2000), 345-366; written anew",
        defaults={"radius_m": 0.2, "clusters": 1},
        grid={"radius_m": (0.2, 0.4, 0.8, 1.2), "clusters": (1, 6), "depth_scale": SCALES},
    ),
    Baseline(
        name="chameleon",
        title="CHAMELEON",
        run=clustering.chameleon,
        space="xz",
        citation="Karypis, Han, Kumar, Computer 32(8) (1999), 68-75; chameleon-cluster",
        defaults={"clusters": 3, "neighbours": 10},
        grid={"clusters": (1, 3), "neighbours": (6, 12), "depth_scale": SCALES},
        needs=("pychameleon",),
    ),
    Baseline(
        name="perch",
        title="PERCH",
        run=perch.perch,
        space="xz",
        citation="Kobren, Monath, Krishnamurthy, McCallum, KDD 2017, 255-264; written anew",
        defaults={"diagonal_m": 0.6},
        grid={"diagonal_m": (0.3, 0.6, 1.0, 1.6, 2.5), "depth_scale": SCALES},
    ),
    Baseline(
        name="ddc",
        title="DDC on descriptors",
        run=ddc.ddc,
        space="frame",
        citation="Ren, Wang, Li, Xu, Knowledge-Based Systems 197 (2020), 105841; written anew",
        defaults={"ratio": 0.15, "depth_scale": 1.0},
        grid={"ratio": (0.1, 0.15, 0.25), "depth_scale": SCALES},
    ),
    Baseline(
        name="dcc",
        title="DCC on descriptors",
        run=dcc.dcc,
        space="frame",
        citation="Shah, Koltun, arXiv 1803.01449 (2018); written anew",
        defaults={"pull": 100.0, "threshold": 10.0, "depth_scale": 1.0},
        grid={"pull": (10.0, 100.0), "threshold": (5.0, 10.0, 20.0), "depth_scale": SCALES},
    ),
    Baseline(
        name="dbscan",
        title="DBSCAN",
        run=clustering.dbscan,
        space="xz",
        citation=f"Ester, Kriegel, Sander, Xu, KDD 1996, 226-231; {SKLEARN}",
        defaults={"eps_m": 0.15, "min_samples": 5},
        grid={
            "eps_m": (0.05, 0.1, 0.15, 0.2, 0.3),
            "min_samples": (2, 5, 10),
            "depth_scale": SCALES,
        },
    ),
    Baseline(
        name="hdbscan",
        title="HDBSCAN",
        run=clustering.hdbscan,
        space="xz",
        citation=f"Campello, Moulavi, Sander, PAKDD 2013, 160-172; {SKLEARN}",
        defaults={"min_samples": 5, "single": True},
        grid={"min_samples": (2, 5, 10, 20), "single": (True, False), "depth_scale": SCALES},
        sized=True,
    ),
    Baseline(
        name="birch",
        title="BIRCH",
        run=clustering.birch,
        space="xz",
        citation=f"Zhang, Ramakrishnan, Livny, SIGMOD 1996, 103-114; {SKLEARN}",
        defaults={"threshold_m": 0.2},
        grid={"threshold_m": (0.05, 0.1, 0.15, 0.2, 0.3, 0.4), "depth_scale": SCALES},
    ),
    Baseline(
        name="scipy_single",
        title="SciPy single linkage",
        run=clustering.single_linkage,
        space="xz",
        citation="Virtanen et al., Nature Methods 17 (2020), 261-272",
        defaults={"distance_m": 0.2},
        grid={"distance_m": (0.05, *DISTANCES_M), "depth_scale": SCALES},
    ),
    Baseline(
        name="range_image",
        title="Range image (depth_clustering)",
        run=dense.range_image,
        space="image",
        citation="Bogoslavskyi, Stachniss, IROS 2016, 163-169; written anew",
        defaults={"angle_deg": 5.0, "stride": 2},
        grid={"angle_deg": (1.0, 2.0, 4.0, 7.0, 10.0, 15.0), "stride": (1, 2, 4)},
    ),
)

BASELINES: dict[str, Baseline] = {baseline.name: baseline for baseline in _ALL}
"""All baselines by name."""
