"""C++ of the steps without Warp: CUDA threads that take turns, and the CPU under sanitizers.

Both return the results of the compiled kernels.
"""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import warp as wp

from jaxdet.config import Config
from jaxdet.floor.plane import unknown_plane
from jaxdet.runtime.calls import device_of_jax
from jaxdet.sim import sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.stages import _program
from jaxdet.types import Calibration, GroundPlane
from jaxdet_kernels import program as kernels
from jaxdet_kernels.build import INCLUDE
from tests.scenes import D435_DEPTH, level, noise_depth, resized, small, smooth_depth, with_lens
from tests.steps import POISON

ROOT = Path(__file__).resolve().parents[1]
COMPILER = shutil.which("g++")
FLAGS = ["-std=c++17", "-w", "-ffp-contract=off", "-I", str(INCLUDE), "-I", str(ROOT / "tests")]
SANITIZED = ["-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine"),
]


class Case(NamedTuple):
    """Frames of one camera."""

    calibration: Calibration
    depth: np.ndarray
    plane: GroundPlane


def simulated() -> Iterator[Case]:
    """Yield frames with ramps, with and without a prior."""
    shown = list(sample_frames("ramps", 300, 4, width=320, height=240, depth_error=1.0))
    depth, calibration = np.stack([one.depth for one in shown]), calibration_of(shown[0].config)
    for plane in (level(4, 0.4, 0.1), unknown_plane(4)):
        yield Case(calibration, depth, plane)


def odd() -> Iterator[Case]:
    """Yield noise and smooth depth of unusual sizes, with separate colour cameras and lenses."""
    cameras = [small(263, 195), small(33, 20), small(9, 8)]
    for lens in ("plumb_bob", "rational", "inverse"):
        cameras.append(Calibration(with_lens(resized(D435_DEPTH, 161, 119), lens)))
    for seed, calibration in enumerate(cameras):
        camera = calibration.depth
        depth = np.concatenate([noise_depth(2, camera, seed), smooth_depth(2, camera)])
        for plane in (level(4, 0.4, 0.1), unknown_plane(4)):
            yield Case(calibration, depth, plane)


def built(folder: Path, *flags: str) -> Path:
    """Compile ``tests/team_main.cpp``."""
    program, main = folder / "program", str(ROOT / "tests/team_main.cpp")
    command = [str(COMPILER), *FLAGS, *flags, main, "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True)
    if "cannot find" in done.stderr and "san" in done.stderr:
        pytest.skip("no sanitizers on this machine")
    assert done.returncode == 0, done.stderr
    return program


def test_results_of_the_threads_of_a_block_equal_those_of_a_single_thread(tmp_path: Path) -> None:
    check(built(tmp_path, "-O1", "-DSIMT"), simulated())


def test_steps_stay_within_their_memory(tmp_path: Path) -> None:
    check(built(tmp_path, "-O1", *SANITIZED), [*simulated(), *odd()])


def check(program: Path, cases: Iterator[Case] | list[Case]) -> None:
    """Compare each step with the compiled kernels; both start from results of the kernels."""
    device = device_of_jax(kernels)
    for case in cases:
        config, unit = Config(), case.calibration.depth_unit
        tables = _program.packed_tables(case.calibration, config, str(device))
        static = _program.Static.of(tables)
        floors = _program.floors(case.plane, config, unit)
        words = static.words()
        poison = [np.full((len(case.depth), count), POISON, np.int32) for count in words]
        arrays = [case.depth, floors, tables, *poison]
        for step, name in enumerate(_program.STEPS):
            expected = compiled(arrays, step, static)
            found = by_itself(program, arrays, step, static)
            for kind, got, want in zip(("record", "contour", "work"), found, expected, strict=True):
                np.testing.assert_array_equal(got, want, err_msg=f"{name}: {kind}")
            arrays[3:] = expected


def compiled(arrays: list[np.ndarray], step: int, static: _program.Static) -> list[np.ndarray]:
    """Return record, contours and intermediate arrays after a step."""
    given = [wp.array(a, dtype=wp.dtype_from_numpy(a.dtype), device="cpu") for a in arrays]
    _program.launch(given, None, step, step + 1, static)
    return [array.numpy() for array in given[3:]]


def by_itself(
    program: Path, arrays: list[np.ndarray], step: int, static: _program.Static
) -> list[np.ndarray]:
    """Run a step in the separate program; return the arrays that :func:`compiled` returns."""
    depth, case = arrays[0], program.with_name("case")
    head = [step, len(depth), depth[0].size, *static, *(a.nbytes for a in arrays)]
    case.write_bytes(np.array(head, np.int32).tobytes() + b"".join(a.tobytes() for a in arrays))
    done = subprocess.run([str(program), str(case)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    data, at, found = case.read_bytes(), 0, []
    for array in arrays[3:]:
        found.append(np.frombuffer(data, np.int32, array.size, at).reshape(array.shape))
        at += array.nbytes
    return found
