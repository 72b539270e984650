"""What CUDA's threads do to a frame, on a CPU without CUDA: the same as the CPU's one thread."""

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
import warp as wp

from jaxdet.config import Config
from jaxdet.pipeline import detect
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages import _threads
from jaxdet_kernels.native_source import FOLDER
from tests.scenes import frames, level

ROOT = Path(__file__).resolve().parents[1]
COMPILER = shutil.which("g++")
KERNELS = "floor", "surfaces", "obstacles", "outlines", "free_floor"
TYPES = {wp.int32: "int", wp.bool: "bool", wp.int16: "short"}
PTX = re.compile(r"const unsigned at = [^;]*;\s*asm volatile\(.*?\);", re.DOTALL)
"""Adds to a place in shared memory."""


class Launch(NamedTuple):
    """What a kernel was given on the CPU, and what it made of it."""

    kernel: Any
    arrays: dict[str, np.ndarray]


def launched(launch: Any) -> Launch:
    """Copies of the arrays of a launch that has run."""
    kernel, arrays = launch._recorded.kernel, {}
    for i, argument in enumerate(kernel.adj.args):
        if hasattr(argument.type, "ndim"):
            given = getattr(launch._arguments, f"argument_{i}")
            shape = tuple(given.shape[: given.ndim])
            dtype = np.dtype(wp.dtype_to_numpy(argument.type.dtype))
            size = int(np.prod(shape)) * dtype.itemsize
            data = ctypes.string_at(given.data, size)
            arrays[argument.label] = np.frombuffer(data, dtype).reshape(shape)
    return Launch(kernel, arrays)


def all_launches(work: Callable[[], Any]) -> dict[str, Launch]:
    """The last launch of each kernel."""
    found: dict[str, Launch] = {}
    on_all_cores = _threads._on_all_cores

    def run(work: Sequence[Any]) -> None:
        on_all_cores(work)
        one = launched(work[0].__self__)
        found[one.kernel.key] = one

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_threads, "_on_all_cores", run)
        jax.block_until_ready(work())
    return found


def source(one: Launch) -> str:
    """The kernel's C++ as ``tests/team_main.cpp`` includes it."""
    [function] = [
        f for n, f in one.kernel.module.functions.items() if n == f"native_{one.kernel.key}"
    ]
    types = {
        arg.label: TYPES[arg.type.dtype] for arg in one.kernel.adj.args if arg.label in one.arrays
    }
    shapes = {name: ", ".join(map(str, array.shape)) for name, array in one.arrays.items()}
    results = [name for name in one.arrays if name.endswith("_out")]
    return "\n".join(
        [
            "namespace teams {",
            *(f"Array<{of}> {name};" for name, of in types.items()),
            "void kernel(int tid, int share, int shares) {",
            PTX.sub("*place += value;", function.native_snippet).replace("__align__(16)", ""),
            "}",
            "void load(FILE* file) {",
            *(f"{name}.load(file, {{{shape}}});" for name, shape in shapes.items()),
            "}",
            "void store(FILE* file) {",
            *(f"{name}.store(file);" for name in results),
            "}",
            "}",
        ]
    )


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine")
def test_threads_of_a_block_find_what_one_thread_does(tmp_path: Path) -> None:
    shown = list(sample_frames("ramps", 300, 4, width=320, height=240, depth_error=1.0))
    color, depth = (np.stack([getattr(f, name) for f in shown]) for name in ("color", "depth"))
    given = frames(calibration_of(shown[0].config), color, depth, plane=level(4, 0.4, 0.1))
    found = all_launches(lambda: detect(given, Config()))
    for name in KERNELS:
        one, case = found[name], tmp_path / name
        (tmp_path / "kernel.h").write_text(source(one), encoding="utf-8")
        program, main = str(tmp_path / "program"), str(ROOT / "tests/team_main.cpp")
        folders = ["-I", str(tmp_path), "-I", str(FOLDER), "-I", str(ROOT / "tests")]
        flags = ["-std=c++17", "-O1", "-w", "-ffp-contract=off", *folders]
        subprocess.run([str(COMPILER), *flags, main, "-o", program], check=True)
        results = [key for key in one.arrays if key.endswith("_out")]
        # Results that are not written are seen to be wrong.
        arrays = {k: np.full_like(a, 77) if k in results else a for k, a in one.arrays.items()}
        case.write_bytes(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays.values()))
        subprocess.run([program, str(case)], check=True)
        data, at = case.read_bytes(), 0
        for key in results:
            want = one.arrays[key]
            own = np.frombuffer(data, want.dtype, want.size, at).reshape(want.shape)
            at += want.nbytes
            if key != "scratch_out":
                np.testing.assert_array_equal(own, want, err_msg=f"{name}: {key}")
