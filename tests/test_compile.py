"""Kernels are compiled for the CPU once, even if several processes start together."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import pytest
import warp as wp

from jaxdet.runtime.calls import jax_callable
from jaxdet_kernels import paper as kernels

LOAD = """
import sys
from jaxdet.runtime.compiled import load_for_cpu
from jaxdet_kernels import decode
load_for_cpu(decode)
"""
LAUNCH = """
import numpy as np, warp as wp
found = wp.zeros((1, 1), dtype=wp.uint16, device="cpu")
metres = wp.array(np.float32([[1.5]]), device="cpu")
wp.launch(decode.depth_units, 1, [metres, 0.001, found], device="cpu")
print(found.numpy()[0, 0])
"""
STOPPED = """
import warp as wp
from jaxdet.runtime import compiled
plain = wp.compile_aot_module


def stopped(*arguments, **options):
    plain(*arguments, **options)
    raise KeyboardInterrupt


wp.compile_aot_module = stopped
"""


def start(cache: Path, code: str = LOAD + LAUNCH, cwd: Path | None = None) -> subprocess.Popen[str]:
    """Start a process that loads kernels from the folder ``cache``."""
    named = {"WARP_CACHE_PATH": str(cache), "PYTHONPATH": os.pathsep.join(sys.path)}
    command, env = [sys.executable, "-P", "-c", code], {**os.environ, **named}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=env, cwd=cwd)


def ended(process: subprocess.Popen[str]) -> str:
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    return output


def code_in(cache: Path) -> dict[Path, int]:
    """Return the compiled files and the times when they were written."""
    return {path: path.stat().st_mtime_ns for path in cache.rglob("*.o")}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a cache that two processes filled simultaneously."""
    folder = tmp_path_factory.mktemp("compiled")
    both = [start(folder) for _ in range(2)]
    assert [ended(process) for process in both] == ["1500\n"] * 2
    return folder


def test_only_one_of_two_simultaneous_processes_compiles(cache: Path) -> None:
    assert len(code_in(cache)) == 1


def test_a_second_process_compiles_nothing(cache: Path) -> None:
    first = code_in(cache)
    assert ended(start(cache)) == "1500\n"
    assert code_in(cache) == first


def test_a_compilation_that_is_stopped_leaves_no_code(tmp_path: Path) -> None:
    process = start(tmp_path, STOPPED + LOAD)
    _, errors = process.communicate()
    assert process.returncode and "KeyboardInterrupt" in errors
    assert not code_in(tmp_path)


def test_damaged_code_is_compiled_again(cache: Path, tmp_path: Path) -> None:
    shutil.copytree(cache, tmp_path, dirs_exist_ok=True)
    (file,) = code_in(tmp_path)
    original = file.read_bytes()
    middle = len(original) // 2
    file.write_bytes(original[:middle] + bytes([original[middle] ^ 1]) + original[middle + 1 :])
    assert ended(start(tmp_path)) == "1500\n"
    (made,) = code_in(tmp_path)
    assert made.read_bytes() == original


def test_a_program_does_not_depend_on_those_traced_before():
    """Otherwise JAX would not find it in its cache, and compile it again."""

    @jax_callable(kernels, [wp.array(dtype=wp.int32)] * 2, outputs=1)
    def copied(source, found):
        wp.copy(found, source)

    program = jax.jit(lambda source: copied(source, output_dims={"found": source.shape}))
    for size in (3, 4):
        text = program.lower(jax.ShapeDtypeStruct((size,), "int32")).as_text()
        assert "call_id = 0 " in text, text
