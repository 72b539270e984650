"""Runs of ``jaxdet run`` with addresses of buckets, ``--on`` or ``--share``."""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from functools import partial
from os import PathLike
from typing import Any

from jaxdet.engine.settings import Progress, ProgressCallback
from jaxdet.errors import ConfigError
from jaxdet.fleet.logs import list_logs, share_of, size_of
from jaxdet.fleet.place import address
from jaxdet.fleet.run_log import prepare, run_logs
from jaxdet.memory import size_text


def run_fleet(
    inputs: Sequence[str | PathLike[str]],
    output: str | PathLike[str],
    how: Mapping[str, Any],
    *,
    on: str | None = None,
    share: str | None = None,
    join: bool = True,
    progress: ProgressCallback | None = None,
) -> list[dict[str, Any]]:
    """Run logs at addresses and publish their results at an address; finished logs are skipped.

    Args:
        inputs: Addresses, folders or files.
        output: Address of the results.
        how: See :func:`jaxdet.fleet.run_log`.
        on: ``ray`` for a Ray cluster; by default this machine.
        share: ``K/N`` for only the logs of the K-th of N shares.
        join: See :func:`jaxdet.find_logs`.
        progress: Called after each log.

    Returns:
        The outcomes of :func:`jaxdet.fleet.run_log`, by name.

    Raises:
        ConfigError: An argument is wrong.
        InputError: There are no logs.
        OutputError: A disk or a bucket can't be used.
    """
    if share and how.get("overwrite"):
        remedy = "name another --output, or run one log with --overwrite before the shares start"
        raise ConfigError("--overwrite with --share would replace other shares", remedy=remedy)
    place = address(output)
    logs = list_logs(inputs, join=join)
    logs = share_of(logs, share) if share else logs
    logs.sort(key=size_of, reverse=True)
    run: Callable[..., Iterator[dict[str, Any]]] = run_logs
    if on:
        from jaxdet.fleet.ray import run_on_ray

        run = partial(run_on_ray, where=on)
    found, failed, size, begin = [], 0, 0, time.monotonic()
    with redirect_stdout(sys.stderr):  # Ray's messages about workers
        for outcome in run(logs, place, prepare(place, how)):
            found.append(outcome)
            failed += outcome["state"] == "failed"
            size += outcome["bytes"] * (outcome["state"] == "done")
            if progress:
                rate = f"{size_text(int(size / max(time.monotonic() - begin, 1e-3)))}/s"
                counts = {"logs_done": len(found), "logs_failed": failed}
                now = outcome["log"], len(found) - 1, len(logs), 0, 0, 0, None
                progress(Progress(*now, doing=rate, **counts))
    return sorted(found, key=lambda outcome: outcome["name"])
