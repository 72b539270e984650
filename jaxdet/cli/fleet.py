"""``jaxdet run`` on buckets, on a cluster, or on a share of the logs."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxdet.cli.terminal import tell
from jaxdet.engine.settings import RunOptions
from jaxdet.memory import parse_size

STATES = ("done", "there", "failed", "replaced")


@dataclass(frozen=True)
class FleetOptions:
    """Distribution of the logs over machines, see jaxdet help fleets."""

    on: str | None = field(default=None, metadata={"takes": "ENGINE"})
    """ray: run on the Ray cluster of RAY_ADDRESS, or on a local one."""
    share: str | None = field(default=None, metadata={"takes": "K/N"})
    """Process the K-th of N shares of the logs, for job arrays. All shares use the same --output.
    """
    spool: Path | None = field(default=None, metadata={"takes": "DIR"})
    """Local folder for logs downloaded from a bucket; by default the folder for temporary files."""
    spool_size: str | None = field(default=None, metadata={"takes": "SIZE"})
    """Maximum size of downloaded logs per process; by default three quarters of the free space."""

    def __post_init__(self) -> None:
        if self.spool_size is not None:
            parse_size(self.spool_size, "--spool-size")


def run_on_machines(
    logs: Sequence[str],
    output: Path,
    options: RunOptions,
    fleet: FleetOptions,
    how: Mapping[str, Any],
    *,
    join: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run the command on several machines, or on a share of the logs; return the exit code.

    Args:
        logs: Addresses, folders or files.
        output: Address or folder of the results.
        options: Options of the run.
        fleet: Options of the distribution over machines.
        how: ``preset``, ``config``, ``log`` and ``tracks``, see :func:`jaxdet.fleet.run_log`.
        join: See :func:`jaxdet.find_logs`.
        quiet: Report errors only.
        as_json: Print the outcomes as JSON.
    """
    from jaxdet.cli.progress import reporting
    from jaxdet.fleet import run_fleet
    from jaxdet.results.summary import failure

    how = {**how, **vars(options)}
    how["spool"] = str(fleet.spool) if fleet.spool else None
    how["spool_size"] = fleet.spool_size and parse_size(fleet.spool_size, "--spool-size")
    with reporting(quiet or as_json) as progress:
        outcomes = run_fleet(
            logs,
            output,
            {key: value for key, value in how.items() if value is not None},
            on=fleet.on,
            share=fleet.share,
            join=join,
            progress=progress,
        )
    wrong = [one for one in outcomes if one["error"] or one["lost"]]
    for one in wrong:
        text = "; ".join([*filter(None, [one["error"]]), *one["lost"]])
        tell(f"jaxdet: error: {failure({**one, 'error': text, 'paths': ()})}")
    if as_json:
        print(json.dumps({"logs": outcomes}, indent=2))
    elif not quiet:
        print(_closing(outcomes))
    if any(one["state"] == "failed" for one in wrong) and not options.update:
        tell("jaxdet: pass --update to process failed and incomplete logs again")
    return 1 if wrong else 0


def _closing(outcomes: list[dict[str, Any]]) -> str:
    """Return the line of text that ends the output of a run."""
    counts = Counter(one["state"] for one in outcomes)
    frames, found = (sum(one[name] for one in outcomes) for name in ("frames", "obstacles"))
    states = ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])
    return f"{len(outcomes)} logs: {states or 'none'}; {frames} frames, {found} obstacles"
