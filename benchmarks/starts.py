"""``python -m benchmarks.starts LOG``: how long ``jaxdet run`` takes the first and second time."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import tyro


def main(log: tyro.conf.Positional[Path], rounds: int = 3, workers: int = 1) -> None:
    """Runs a log with empty caches and again, and prints the seconds and the ratios.

    Args:
        log: A log; the shorter, the more the start counts.
        rounds: How often both are done.
        workers: Processes.
    """
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            first, second = (seconds(log, Path(folder), workers) for _ in range(2))
        print(f"first {first:.1f} s, second {second:.1f} s: {first / second:.1f} times", flush=True)


def seconds(log: Path, folder: Path, workers: int) -> float:
    """Wall time of one run with its caches in ``folder``."""
    names = ("JAX_COMPILATION_CACHE_DIR", "WARP_CACHE_PATH")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    environment["JAXDET_CACHE"] = str(folder / "cache")
    command = [sys.executable, "-m", "jaxdet", "run", str(log), "--output", str(folder / "results")]
    command += ["--overwrite", "--quiet", "--pictures", "0", "--workers", str(workers)]
    start = time.perf_counter()
    subprocess.run(command, env=environment, check=True)
    return time.perf_counter() - start


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.starts")
