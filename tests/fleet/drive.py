"""Run a fleet with the stub of the engine: ``drive.py LOGS RESULTS SPOOL [ON] [SHARE]``."""

import json
import sys

from tests.fleet.stub import install


def main(logs: str, results: str, spool: str, on: str = "", share: str = "") -> None:
    install()
    from jaxdet.fleet import run_fleet

    if on == "ray.data":
        outcomes = run_by_ray_data(logs, results, {"spool": spool, "workers": 1})
    else:
        outcomes = run_fleet([logs], results, {"spool": spool}, on=on or None, share=share or None)
    print(json.dumps({outcome["name"]: outcome["state"] for outcome in outcomes}))


def run_by_ray_data(logs: str, results: str, how: dict) -> list:
    """Run logs as in the recipe for Ray Data on the help page on fleets."""
    import ray

    from jaxdet.fleet import list_logs, prepare, run_log

    how = prepare(results, how)
    rows = ray.data.from_items([{"one": log} for log in list_logs(logs)])
    return rows.map(lambda row: run_log(row["one"], results, how), num_cpus=1).take_all()


if __name__ == "__main__":
    main(*sys.argv[1:])
