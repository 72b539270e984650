"""Kernels compiled for the CPU: once, complete, and for all processes that start together."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

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
    """A process with a cache of its own."""
    named = {"WARP_CACHE_PATH": str(cache), "PYTHONPATH": os.pathsep.join(sys.path)}
    command, env = [sys.executable, "-P", "-c", code], {**os.environ, **named}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=env, cwd=cwd)


def ended(process: subprocess.Popen[str]) -> str:
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    return output


def code_in(cache: Path) -> dict[Path, int]:
    """Compiled files, with the times when they were written."""
    return {path: path.stat().st_mtime_ns for path in cache.rglob("*.o")}


def test_a_second_process_compiles_nothing(tmp_path: Path) -> None:
    assert ended(start(tmp_path)) == "1500\n"
    first = code_in(tmp_path)
    assert len(first) == 1
    assert ended(start(tmp_path)) == "1500\n"
    assert code_in(tmp_path) == first


def test_of_processes_that_start_together_one_compiles(tmp_path: Path) -> None:
    both = [start(tmp_path) for _ in range(2)]
    assert [ended(process) for process in both] == ["1500\n"] * 2
    assert len(code_in(tmp_path)) == 1


def test_a_compilation_that_is_stopped_leaves_nothing(tmp_path: Path) -> None:
    process = start(tmp_path, STOPPED + LOAD)
    _, errors = process.communicate()
    assert process.returncode and "KeyboardInterrupt" in errors
    assert not code_in(tmp_path)


@pytest.mark.parametrize("damage", ["torn", "gone", "flipped"])
def test_damaged_code_is_made_again(tmp_path: Path, damage: str) -> None:
    ended(start(tmp_path))
    (file,) = code_in(tmp_path)
    whole = file.read_bytes()
    if damage == "gone":
        file.unlink()
    elif damage == "flipped":
        middle = len(whole) // 2
        file.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    else:
        file.write_bytes(whole[: len(whole) // 2])
    assert ended(start(tmp_path)) == "1500\n"
    (made,) = code_in(tmp_path)
    assert made.read_bytes() == whole
