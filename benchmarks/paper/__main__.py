"""``python -m benchmarks.paper``: the experiments of the paper, in one report."""

import os
import sys


def start() -> int:
    """Parse the command line and run; workers inherit the environment."""
    # This must precede the import of NumPy: with one worker per core, each needs one thread.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    import tyro

    from benchmarks.paper.main import Options, main

    return main(tyro.cli(Options, prog="python -m benchmarks.paper"))


if __name__ == "__main__":
    sys.exit(start())
