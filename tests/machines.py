"""Imitation of other machines, by environment variables that restrict the CPU features in use.

Run as a script it prints one line per environment: digests of tables, or the columns that differ
from those of the first one.

    python tests/machines.py LOG... [--backend jax]
"""

import argparse
import hashlib
import itertools
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.parquet as pq

Environment = dict[str, str]

BLAS = ("Prescott", "Nehalem", "Haswell", "SkylakeX")
"""Kernels of OpenBLAS, from SSE3 to AVX-512."""
V4 = ("X86_V4", "AVX512_ICL", "AVX512_SPR")
V3 = ("X86_V3", *V4)
"""CPU features beyond NumPy's baseline, for which NumPy has separate loops."""
LIBC = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F"}
OPENCV = {"OPENCV_CPU_DISABLE": "AVX2,AVX512F,AVX512-SKX,FP16,SSE4_2"}
PLAINEST: Environment = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": " ".join(V3),
    **LIBC,
    **OPENCV,
}
"""The machine with the fewest CPU features on which all libraries run."""


def environments() -> list[Environment]:
    """Return the environments of all combinations of variables; the first one is empty."""
    variables = (
        [{}, *({"OPENBLAS_CORETYPE": kind} for kind in BLAS)],
        [{}, *({"NPY_DISABLE_CPU_FEATURES": " ".join(names)} for names in (V4, V3))],
        [{}, LIBC],
        [{}, OPENCV],
    )
    return [
        {k: v for part in parts for k, v in part.items()} for parts in itertools.product(*variables)
    ]


def can_run(environment: Environment) -> bool:
    """Return whether this CPU has the instructions that an environment chooses."""
    if environment.get("OPENBLAS_CORETYPE") != "SkylakeX":
        return True
    return "avx512f" in Path("/proc/cpuinfo").read_text()


def run(arguments: list[str], environment: Environment) -> subprocess.CompletedProcess[str]:
    """Run this Python in an environment, without NumPy's warnings of features that it lacks."""
    variables = {**os.environ, **environment}
    command = [sys.executable, "-P", "-W", "ignore::ImportWarning", *arguments]
    return subprocess.run(command, env=variables, capture_output=True, text=True, check=False)


def tables(folder: Path) -> dict[str, str]:
    """Return digests of tables and maps of all logs, and of each of their columns and arrays."""
    found = {}
    for path in sorted(folder.glob("*/*.parquet")):
        file = f"{path.parent.name}/{path.name}"
        found[file] = _digest(path.read_bytes())
        table = pq.read_table(path)
        for name in table.column_names:
            column = table[name].combine_chunks()
            found[f"{file} {name}"] = _digest(repr(column.to_pylist()).encode())
    for path in sorted(folder.glob("*/*.npz")):
        file = f"{path.parent.name}/{path.name}"
        found[file] = _digest(path.read_bytes())
        with np.load(path) as parts:
            found |= {f"{file} {name}": _digest(parts[name].tobytes()) for name in parts}
    assert any("tracks.parquet" in name for name in found)
    return found


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def results(
    logs: list[str], environment: Environment, backend: str = "reference"
) -> dict[str, str]:
    """Return :func:`tables` of a run and its tracks on another machine."""
    with TemporaryDirectory() as folder:
        how = ["--backend", backend, "--workers", "1", "--pictures", "0", "--every", "4"]
        out = Path(folder) / "results"
        command = ["-m", "jaxdet", "run", *logs, "-o", str(out), *how, "--tracks", "--quiet"]
        done = run(command, environment)
        assert done.returncode == 0, done.stderr
        return tables(out)


def main() -> int:
    """Compare all environments; return exit status 1 if one differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="+")
    parser.add_argument("--backend", default="reference")
    options = parser.parse_args()
    first, status = None, 0
    for environment in environments():
        if not can_run(environment):
            print("not run:", environment)
            continue
        found = results(options.logs, environment, options.backend)
        first = first or found
        differ = [name for name, digest in found.items() if digest != first[name]]
        status |= bool(differ or found.keys() != first.keys())
        print("differs" if differ else "same", environment, *differ, sep="\n  ", flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
