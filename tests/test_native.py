"""C++ of the kernels: headers compile separately, and corner detection runs under sanitizers."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from jaxdet.config import FeaturesConfig
from jaxdet.reference.paper import features
from jaxdet.stages.paper._features import corner_settings
from jaxdet.types import Calibration
from jaxdet_kernels.build import HEADERS as FILES
from jaxdet_kernels.build import INCLUDE
from tests.scenes import D435_COLOR, resized

ROOT = Path(__file__).resolve().parents[1]
FOLDER = INCLUDE / "jaxdet"
HEADERS = [path.name for path in FILES]
COMPILER = shutil.which("g++")
FLAGS = ["-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror"]
FLAGS += ["-Wno-missing-field-initializers", "-x", "c++", "-"]


def faults(source: str) -> str:
    """Return the messages of the compiler for C++ code that includes headers of the kernels."""
    command = [str(COMPILER), "-I", str(INCLUDE), *FLAGS]
    return subprocess.run(command, input=source, capture_output=True, text=True).stderr


@pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine")
@pytest.mark.parametrize("header", HEADERS)
def test_each_header_compiles_separately(header):
    # Included, because `#pragma once` causes a warning in the main file.
    assert faults(f'#include "jaxdet/{header}"\n') == ""


SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
CORNERS = {"cpu": ["-O1", "-g", "-Wno-psabi", *SANITIZED], "cuda": ["-O2", "-DSIMT"]}


@pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine")
@pytest.mark.parametrize("target", CORNERS)
def test_corners_of_the_cpu_and_cuda_sources_equal_the_reference(tmp_path, target):
    """CPU code runs under sanitizers, CUDA code with threads that take turns (``tests/simt.h``)."""
    program = tmp_path / "corners"
    flags = ["-std=c++17", "-ffp-contract=off", "-Wno-unknown-pragmas", *CORNERS[target]]
    source = str(ROOT / "tests/corners_main.cpp")
    command = [str(COMPILER), *flags, "-I", str(INCLUDE), source, "-o", str(program)]
    built = subprocess.run(command, capture_output=True, text=True)
    if "cannot find" in built.stderr and "san" in built.stderr:
        pytest.skip("no sanitizers on this machine")
    assert built.returncode == 0, built.stderr
    rng, distances = np.random.default_rng(0), (0.0, 1.0, 3.0, 1000.0)
    sizes = [(3, 3), (5, 4), (31, 33), (14, 64), (29, 65), (57, 127), (70, 211), (6, 2100)]
    sizes += [(200, 640)] if target == "cuda" else []
    for trial, (height, width) in enumerate(sizes * (2 if target == "cpu" else 1)):
        levels = (2, 5, 256)[trial % 3]
        grey = rng.integers(0, levels, (height, width)) * (255 // (levels - 1))
        grey = grey.repeat(3, 0).repeat(2, 1)[:height, :width] if trial % 2 else grey
        color = np.repeat(grey[..., None], 3, axis=-1).astype(np.uint8)
        slots, quality = (40, 1024, 5)[trial % 3], (0.01, 1e-9)[trial % 2]
        config = FeaturesConfig(
            max_corners=slots, quality_level=quality, min_distance=distances[trial % 4]
        )
        case = tmp_path / "case"
        numbers = np.array([height, width, slots, *corner_settings(config)], np.int32)
        case.write_bytes(numbers.tobytes() + color.tobytes())
        run = subprocess.run([str(program), str(case)], capture_output=True, text=True)
        assert (run.returncode, run.stderr) == (0, "")
        z = np.ones((1, height, width), np.uint16)
        camera = Calibration(resized(D435_COLOR, width, height))
        want = features(color[None], z, camera, config)
        found = np.array(run.stdout.split(), int)
        assert min(found[0], slots) == want.valid.sum()
        assert (found[0] > slots) == want.overflow[0]
        np.testing.assert_array_equal(found[1:].reshape(-1, 2), np.c_[want.u[0], want.v[0]])
