"""``python -m benchmarks.paper``: all experiments, one report."""

import os
import sys


def start() -> int:
    """Reads the command line and runs; workers inherit the environment."""
    # Before NumPy is loaded: as many workers as cores need one thread each.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    import tyro

    from benchmarks.paper.main import Options, main

    return main(tyro.cli(Options, prog="python -m benchmarks.paper"))


if __name__ == "__main__":
    sys.exit(start())
