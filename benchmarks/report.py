"""Report: a Markdown table of all cases, and the peers that could not be imported."""

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
"""Headings, and the last parts of the metric keys."""
HEADER = "\n".join(
    [
        "| case | " + " | ".join(name for name, _ in COLUMNS) + " |",
        "|---" * (len(COLUMNS) + 1) + "|",
    ]
)


def rows(metrics: list[Metric]) -> list[str]:
    """Return a row for each case; ratios above 1 mean that jaxdet is faster.

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
    """Return lines for metrics that are not part of a case, such as throughputs."""
    cases = set(_cases(metrics))
    return [str(m) for m in metrics if not {m.key, m.key.rpartition(".")[0]} & cases]


def absent(missing: dict[str, Missing]) -> list[str]:
    """Return a line for each peer that could not be imported."""
    return [f"not measured: {key}: {m.reason}; {m.remedy}" for key, m in missing.items()]


def _cases(metrics: list[Metric]) -> list[str]:
    return [m.key.removesuffix(".time") for m in metrics if m.key.endswith(".time")]
