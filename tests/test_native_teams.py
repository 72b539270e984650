"""What CUDA's threads do to a frame, on a CPU without CUDA: the same as the CPU's one thread."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from jaxdet.config import Config
from jaxdet.floor.plane import unknown_plane
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages import _program
from jaxdet_kernels.build import INCLUDE
from tests.scenes import level
from tests.steps import POISON

ROOT = Path(__file__).resolve().parents[1]
COMPILER = shutil.which("g++")


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine")
def test_threads_of_a_block_find_what_one_thread_does(tmp_path: Path) -> None:
    program, main = tmp_path / "program", str(ROOT / "tests/team_main.cpp")
    flags = [
        "-std=c++17",
        "-O1",
        "-w",
        "-ffp-contract=off",
        "-I",
        str(INCLUDE),
        "-I",
        str(ROOT / "tests"),
    ]
    subprocess.run([str(COMPILER), *flags, main, "-o", str(program)], check=True)
    config = Config()
    shown = list(sample_frames("ramps", 300, 4, width=320, height=240, depth_error=1.0))
    for plane in (level(4, 0.4, 0.1), unknown_plane(4)):
        calibration = calibration_of(shown[0].config)
        tables = _program.packed(*_program.host_tables(calibration, config))
        static, unit = _program.Static.of(tables), calibration.depth_unit
        depth = np.stack([one.depth for one in shown])
        floors = _program.floors(plane, config, unit)
        poison = [np.full((len(depth), words), POISON, np.int32) for words in static.words()]
        arrays = [depth, floors, tables, *poison]
        for step in range(len(_program.STEPS)):
            expected = on_the_cpu(arrays, step)
            found = by_teams(program, arrays, step, static.own_words)
            for name, got, want in zip(("record", "contour", "work"), found, expected, strict=True):
                np.testing.assert_array_equal(got, want, err_msg=f"{_program.STEPS[step]}: {name}")
            arrays[3:] = expected


def on_the_cpu(arrays: list[np.ndarray], step: int) -> list[np.ndarray]:
    """Record, contours and work after a step."""
    given = [wp.array(a, dtype=wp.dtype_from_numpy(a.dtype), device="cpu") for a in arrays]
    _program.launch(given, None, step, step + 1)
    return [array.numpy() for array in given[3:]]


def by_teams(program: Path, arrays: list[np.ndarray], step: int, words: int) -> list[np.ndarray]:
    """The same by ``tests/team_main.cpp``."""
    depth, case = arrays[0], program.with_name("case")
    head = [step, len(depth), depth[0].size, words, *(a.nbytes for a in arrays)]
    case.write_bytes(np.array(head, np.int32).tobytes() + b"".join(a.tobytes() for a in arrays))
    subprocess.run([str(program), str(case)], check=True)
    data, at, found = case.read_bytes(), 0, []
    for array in arrays[3:]:
        found.append(np.frombuffer(data, np.int32, array.size, at).reshape(array.shape))
        at += array.nbytes
    return found
