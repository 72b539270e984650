"""Runs of many logs, on this machine or as tasks of a Ray cluster.

``jaxdet run`` calls this module if ``--on``, ``--share`` or an address of a bucket is given.
"""

import logging
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import redirect_stdout
from functools import partial
from math import inf
from os import PathLike
from typing import Any

from jaxdet.engine.settings import Progress, ProgressCallback
from jaxdet.errors import ConfigError, Interrupted, JaxdetError, WorkerError
from jaxdet.fleet.logs import Log, list_logs, share_of, size_of
from jaxdet.fleet.place import address
from jaxdet.fleet.run_log import prepare, run_logs
from jaxdet.memory import size_text
from jaxdet.signals import stops_raised

LOGGER = logging.getLogger("jaxdet")
_PER_SLOT = 4
"""Ray tasks in flight per slot: no slot waits for the driver, and autoscalers see demand."""
_LEAST_WINDOW = 32
"""Minimum number of tasks in flight."""
_MOST_LOGS = 8
"""Maximum number of logs in a Ray task; the next log is fetched while one is computed."""
_PARTS = 16
"""A Ray task with several logs has at most all bytes / number of slots / _PARTS."""


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
        share: ``K/N`` to run only the logs of the K-th of N shares; by default all logs.
        join: See :func:`jaxdet.find_logs`.
        progress: Called after each log.

    Returns:
        The outcomes of :func:`jaxdet.fleet.run_log`, by name.

    Raises:
        ConfigError: An argument is wrong.
        InputError: There are no logs.
        OutputError: A disk or a bucket can't be used.
        Interrupted: A signal, for instance Ctrl-C, ended the run; logs that are done are kept.
    """
    if share and how.get("overwrite"):
        remedy = "name another --output, or run one log with --overwrite before the shares start"
        raise ConfigError("--overwrite with --share would replace other shares", remedy=remedy)
    place = address(output)
    logs = list_logs(inputs, join=join)
    logs = share_of(logs, share) if share else logs
    logs.sort(key=size_of, reverse=True)
    run: Callable[..., Iterator[dict[str, Any]]] = partial(run_on_ray, where=on) if on else run_logs
    found, failed, size, begin = [], 0, 0, time.monotonic()
    try:
        with redirect_stdout(sys.stderr), stops_raised():  # Ray prints messages about workers
            for outcome in run(logs, place, prepare(place, how)):
                found.append(outcome)
                failed += outcome["state"] == "failed"
                size += outcome["bytes"] * (outcome["state"] == "done")
                if progress:
                    rate = f"{size_text(int(size / max(time.monotonic() - begin, 1e-3)))}/s"
                    counts = {"logs_done": len(found), "logs_failed": failed}
                    now = outcome["log"], len(found) - 1, len(logs), 0, 0, 0, None
                    progress(Progress(*now, doing=rate, **counts))
    except KeyboardInterrupt as stop:
        but = " without --overwrite" if how.get("overwrite") else ""
        text = (
            f"interrupted; {len(found)} of {len(logs)} logs are done; the same command{but} goes on"
        )
        raise Interrupted(getattr(stop, "signal", signal.SIGINT), text) from None
    return sorted(found, key=lambda outcome: outcome["name"])


def run_on_ray(
    logs: Sequence[Log], place: str, how: Mapping[str, Any], where: str = "ray"
) -> Iterator[dict[str, Any]]:
    """Run logs on the Ray cluster of ``RAY_ADDRESS``, or a local one; yield outcomes as they come.

    Logs run in tasks, not actors, so that a retry can run on any node; worker processes are reused,
    so that a program is compiled once per process (``max_calls=0``). If a process or node is lost,
    Ray repeats its task without a limit; :func:`jaxdet.fleet.run_log` limits the attempts.

    Args:
        logs: The logs.
        place: Address of the results.
        how: As returned by :func:`jaxdet.fleet.prepare`.
        where: ``ray``, or ``ray:num_cpus=16,num_gpus=1`` with the resources of a task; by default
            the resources of the smallest node that computes, so that each node has one task.

    Raises:
        ConfigError: Ray is not installed, or ``where`` is wrong.
        JaxdetError: A task failed, but not because of its log; other tasks are cancelled.
        WorkerError: The cluster is lost.
    """
    try:
        import ray
    except ImportError:
        remedy = "install it with: pip install 'jaxdet[ray]'"
        raise ConfigError("--on ray needs Ray", remedy=remedy) from None
    wanted = _resources(where)
    started = not ray.is_initialized()
    if started:
        address = os.environ.get("RAY_ADDRESS") or "local"
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        quiet |= {"include_dashboard": False} if address == "local" else {}
        try:
            ray.init(address, **quiet)
        except Exception as error:
            remedy = "check RAY_ADDRESS and the cluster; on a busy machine, try again"
            text = str(error).partition("\n")[0]
            raise WorkerError(f"Ray can't be used ({text})", remedy=remedy) from None
    try:
        yield from _results(ray, logs, place, how, wanted)
    finally:
        if started:
            ray.shutdown()  # which ends the tasks of this driver


def _results(
    ray: Any, logs: Sequence[Log], place: str, how: Mapping[str, Any], wanted: dict[str, float]
) -> Iterator[dict[str, Any]]:
    resources = wanted or _of_a_node(ray.nodes())
    how = {"workers": max(1, int(resources["num_cpus"])), **how, "driven": True}
    remote = ray.remote(max_calls=0, max_retries=-1, **resources)(_task)
    slots = _slots(ray.nodes(), resources)
    if not slots:
        wants = ", ".join(f"{name}={number:g}" for name, number in resources.items())
        LOGGER.warning("no node of the cluster has %s; waiting for one", wants)
    waiting, running = deque(chunks(logs, slots)), set[Future[list[dict[str, Any]]]]()
    while waiting or running:
        while waiting and len(running) < max(_LEAST_WINDOW, _PER_SLOT * slots):
            running.add(remote.remote(waiting.popleft(), place, how).future())
        slots = _slots(ray.nodes(), resources)
        # A signal interrupts this wait, but not one inside of Ray.
        done, running = wait(running, timeout=10.0, return_when=FIRST_COMPLETED)
        for one in done:
            try:
                yield from one.result()
            except ray.exceptions.RayTaskError as error:
                cause = error.cause
                raise cause if isinstance(cause, JaxdetError) else error from None
            except ray.exceptions.RayError as error:
                raise WorkerError(f"a task was lost ({type(error).__name__})") from None


def _task(logs: Sequence[Log], place: str, how: Mapping[str, Any]) -> list[dict[str, Any]]:
    return list(run_logs(logs, place, how))


def chunks(logs: Sequence[Log], slots: int) -> list[list[Log]]:
    """Divide logs into tasks, largest logs first; the number and bytes per task are limited."""
    most = sum(map(size_of, logs)) / (max(1, slots) * _PARTS)
    found: list[list[Log]] = []
    room = 0.0
    for log in sorted(logs, key=lambda log: (-size_of(log), log["name"])):
        room -= size_of(log)
        if not found or room < 0 or len(found[-1]) == _MOST_LOGS:
            found.append([])
            room = most - size_of(log)
        found[-1].append(log)
    return found


def _resources(where: str) -> dict[str, float]:
    """Return the resources in ``ray:num_cpus=16,num_gpus=1``."""
    engine, _, text = where.partition(":")
    try:
        pairs = (part.split("=") for part in text.split(",") if part)
        found = {name: float(number) for name, number in pairs}
    except ValueError:
        found = {"": 0.0}
    least = {"num_cpus": 1e-4, "num_gpus": 0.0}
    fit = all(least.get(name, inf) <= number < inf for name, number in found.items())
    if engine != "ray" or not fit:
        remedy = "pass --on ray, or --on ray:num_cpus=16,num_gpus=1 for instance"
        raise ConfigError(f"--on {where} is not supported", remedy=remedy)
    return {"num_cpus": 1.0, **found} if found else {}


def _of_a_node(nodes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the resources of the smallest node that computes, with GPUs if any node has GPUs."""
    alive = [node["Resources"] for node in nodes if node["Alive"] and node["Resources"].get("CPU")]
    with_gpu = [node for node in alive if node.get("GPU")]
    chosen = with_gpu or alive or [{"CPU": 1.0}]
    gpus = min(node.get("GPU", 0.0) for node in chosen)
    return {"num_cpus": min(node["CPU"] for node in chosen), "num_gpus": gpus}


def _slots(nodes: Sequence[Mapping[str, Any]], resources: Mapping[str, float]) -> int:
    """Return the number of tasks that nodes can run at a time."""
    names = {"CPU": resources["num_cpus"], "GPU": resources.get("num_gpus", 0.0)}
    wanted = {name: each for name, each in names.items() if each}
    alive = [node["Resources"] for node in nodes if node["Alive"]]
    return sum(
        int(min(has.get(name, 0.0) // each for name, each in wanted.items())) for has in alive
    )
