"""What CUDA's threads do to a frame, on a CPU without CUDA: the same as the CPU's one thread."""

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
import warp as wp

from jaxdet.config import Config
from jaxdet.floor.plane import unknown_plane
from jaxdet.pipeline import detect
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages import _chain
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


def launched(program: Any) -> dict[str, Launch]:
    """Copies of what the kernels of a program had and made, when it has run on one frame."""
    worker, found = program.workers[0], {}
    starts = worker._kernels[:, 3].tolist()
    for step, launch, start in zip(program.steps, worker._recorded, starts, strict=True):
        layout, arrays = type(_chain._layout(launch.params[1:])), {}
        for i, (name, of) in enumerate(step.kernel.types.items()):
            if name not in step.scalars:
                address = int(
                    worker._words[start + getattr(layout, f"argument_{i + 2}").offset // 8]
                )
                shape, dtype = step.shapes[name], np.dtype(wp.dtype_to_numpy(of.dtype))
                data = ctypes.string_at(address, int(np.prod(shape)) * dtype.itemsize)
                arrays[name] = np.frombuffer(data, dtype).reshape(shape)
        kernel = step.kernel.kernel
        found[kernel.key] = Launch(kernel, arrays)
    return found


def all_launches(work: Callable[[], Any]) -> dict[str, Launch]:
    """What each kernel had and made while one frame was worked on."""
    found: dict[str, Launch] = {}
    plain = _chain._Program.run

    def run(program: Any, addresses: Sequence[int]) -> None:
        plain(program, addresses)
        found.update(launched(program))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_chain._Program, "run", run)
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
    found = []
    for shown in sample_frames("ramps", 300, 4, width=320, height=240, depth_error=1.0):
        images = shown.color[None], shown.depth[None]
        for plane in (level(1, 0.4, 0.1), unknown_plane(1)):
            given = frames(calibration_of(shown.config), *images, plane=plane)
            found.append(all_launches(partial(detect, given, Config())))
    for name in KERNELS:
        (tmp_path / "kernel.h").write_text(source(found[0][name]), encoding="utf-8")
        program, main = tmp_path / "program", str(ROOT / "tests/team_main.cpp")
        folders = ["-I", str(tmp_path), "-I", str(FOLDER), "-I", str(ROOT / "tests")]
        flags = ["-std=c++17", "-O1", "-w", "-ffp-contract=off", *folders]
        subprocess.run([str(COMPILER), *flags, main, "-o", str(program)], check=True)
        for launches in found:
            check(program, name, launches[name].arrays)


def check(program: Path, name: str, arrays: dict[str, np.ndarray]) -> None:
    """Runs the block's threads on what the kernel had, and compares what they make of it."""
    case = program.with_name(name)
    results = [key for key in arrays if key.endswith("_out")]
    # Results that are not written are seen to be wrong.
    given = {k: np.full_like(a, 77) if k in results else a for k, a in arrays.items()}
    case.write_bytes(b"".join(np.ascontiguousarray(a).tobytes() for a in given.values()))
    subprocess.run([str(program), str(case)], check=True)
    data, at = case.read_bytes(), 0
    for key in results:
        want = arrays[key]
        own = np.frombuffer(data, want.dtype, want.size, at).reshape(want.shape)
        at += want.nbytes
        if key != "scratch_out":
            np.testing.assert_array_equal(own, want, err_msg=f"{name}: {key}")
