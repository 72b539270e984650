"""Runs a fleet with the stub of the engine: ``drive.py LOGS RESULTS SPOOL [ON] [SHARE]``."""

import json
import sys

from tests.fleet.stub import install


def main(logs: str, results: str, spool: str, on: str = "", share: str = "") -> None:
    install()
    from jaxdet.fleet import run_fleet

    outcomes = run_fleet([logs], results, {"spool": spool}, on=on or None, share=share or None)
    print(json.dumps({outcome["name"]: outcome["state"] for outcome in outcomes}))


if __name__ == "__main__":
    main(*sys.argv[1:])
