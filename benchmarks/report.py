"""The report: a table of all cases in Markdown, and what this machine lacks."""

from benchmarks.run import Metric, Missing

COLUMNS = (
    ("ratio", ""),
    ("ours, ms/frame", "time"),
    ("±", "spread"),
    ("CPU ms", "cpu"),
    ("peer, ms/frame", "peer"),
    ("±", "peer_spread"),
    ("CPU ms", "peer_cpu"),
    ("CPU ratio", "cpu_ratio"),
    ("byte/frame", "bytes"),
    ("copy share", "copy_share"),
)
"""Heading and last part of the metric's key."""
HEADER = "\n".join(
    [
        "| case | " + " | ".join(name for name, _ in COLUMNS) + " |",
        "|---" * (len(COLUMNS) + 1) + "|",
    ]
)


def rows(metrics: list[Metric]) -> list[str]:
    """A row for each case; ratios above 1 mean that ours is faster.

    >>> rows([Metric("cluster.b8.time", 0.25, "ms/frame", "info", 0.0)])
    ['| cluster.b8 |  | 0.25 |  |  |  |  |  |  |  |  |']
    """
    values = {metric.key: metric.value for metric in metrics}
    found = []
    for case in _cases(metrics):
        keys = [f"{case}.{part}" if part else case for _, part in COLUMNS]
        cells = [f"{values[key]:.3g}" if key in values else "" for key in keys]
        found.append("| " + " | ".join([case, *cells]) + " |")
    return found


def others(metrics: list[Metric]) -> list[str]:
    """The metrics that are no part of a case: throughputs."""
    cases = set(_cases(metrics))
    return [str(m) for m in metrics if not {m.key, m.key.rpartition(".")[0]} & cases]


def absent(missing: dict[str, Missing]) -> list[str]:
    """A line for each peer that this machine lacks."""
    return [f"not measured: {key}: {m.reason}; {m.remedy}" for key, m in missing.items()]


def _cases(metrics: list[Metric]) -> list[str]:
    return [m.key.removesuffix(".time") for m in metrics if m.key.endswith(".time")]
