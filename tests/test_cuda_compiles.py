"""Kernels compile for CUDA. No GPU is required, because Warp includes NVRTC."""

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
import warp as wp

from jaxdet.stages._batches import LEAST_CAPABILITY

FOR_CPU = {"decode"}
"""Modules with kernels only for the CPU."""
FOLDER = Path(import_module("jaxdet_kernels").__file__ or "").parent
MODULES = sorted(
    path.stem
    for path in FOLDER.glob("*.py")
    if "wp.set_module_options" in path.read_text("utf-8") and path.stem not in FOR_CPU
)


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA there")
@pytest.mark.parametrize("name", MODULES)
def test_kernels_compile_for_the_earliest_gpu(name: str, tmp_path: Path) -> None:
    module = import_module(f"jaxdet_kernels.{name}")
    arch = round(10 * LEAST_CAPABILITY)
    wp.compile_aot_module(module, arch=arch, module_dir=str(tmp_path), use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    entries = re.findall(r"\.entry (\w+)", ptx.read_text("utf-8"))
    values = [*vars(module).values(), *getattr(module, "STEPS", {}).values()]
    kernels = [value.key for value in values if isinstance(value, wp.Kernel)]
    assert kernels
    for kernel in kernels:
        assert any(entry.startswith(kernel) for entry in entries), kernel
