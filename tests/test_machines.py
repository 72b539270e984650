"""Tables are equal bytes on every CPU, as far as one CPU can imitate others."""

from pathlib import Path

import pytest

from jaxdet.sim import SimConfig, write_log
from tests.machines import BLAS, PLAINEST, V4, can_run, environments, results, run

FUNCTIONS = str(Path(__file__).with_name("machine_functions.py"))
GOLDEN = Path(__file__).parent / "goldens" / "machine_functions.txt"
"""Output of ``python tests/machine_functions.py``. It is the same on an EPYC (AVX2), NumPy 2.4 and
Python 3.11, on a Xeon (AVX-512), NumPy 2.5 and Python 3.12, and on aarch64 in an emulator, and is
updated when a method changes."""
CONTROL = """
import zlib
import numpy as np
numbers = np.random.default_rng(0).random((200, 4, 4))
print(zlib.crc32((numbers @ numbers[::-1]).tobytes()))
complex = numbers[0::2] + 1j * numbers[1::2]
print(zlib.crc32((complex * complex[::-1]).tobytes()))
"""


def printed(arguments, environment):
    done = run(arguments, environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_imitated_machines_change_results_of_numpy():
    if " fma " not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this CPU is the plainest machine itself")
    here, there = (printed(["-c", CONTROL], e) for e in ({}, PLAINEST))
    assert all(a != b for a, b in zip(here, there, strict=True))


def test_functions_return_stored_values_on_imitated_machines():
    here = printed([FUNCTIONS], {})
    assert here == GOLDEN.read_text().splitlines()
    for environment in (PLAINEST, {"NPY_DISABLE_CPU_FEATURES": " ".join(V4)}):
        assert printed([FUNCTIONS], environment) == here


@pytest.mark.slow
def test_functions_return_equal_values_on_all_imitated_machines():
    here = printed([FUNCTIONS], {})
    for environment in filter(can_run, environments()):
        assert printed([FUNCTIONS], environment) == here, environment


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["reference", "jax"])
def test_tables_are_equal_on_all_imitated_machines(backend, tmp_path):
    log = tmp_path / "drive.mcap"
    write_log(log, SimConfig(scene="demo", frames=48, rate_hz=10.0, width=320, height=240))
    tested = [e for e in environments() if can_run(e)]
    assert len(tested) > 3 * len(BLAS)
    if backend == "jax":  # slower; the arithmetic between the kernels and the tables is the same
        tested = [{}, PLAINEST, *({"OPENBLAS_CORETYPE": kind} for kind in BLAS[:3])]
    here = results([str(log)], {}, backend)
    for environment in tested:
        assert results([str(log)], environment, backend) == here, environment
