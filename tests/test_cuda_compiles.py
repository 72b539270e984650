"""Kernels compile for CUDA. No GPU is required, because Warp includes NVRTC."""

import os
import re
import shutil
import sys
from hashlib import blake2b
from importlib import import_module
from pathlib import Path

import pytest
import warp as wp

from jaxdet.stages._batches import LEAST_CAPABILITY
from jaxdet_kernels.build import HEADERS

FOR_CPU = {"decode"}
"""Modules with kernels only for the CPU."""
FOLDER = Path(import_module("jaxdet_kernels").__file__ or "").parent
MODULES = sorted(
    path.stem
    for path in FOLDER.glob("*.py")
    if "wp.set_module_options" in path.read_text("utf-8") and path.stem not in FOR_CPU
)


def ptx_of(name: str, scratch: Path) -> str:
    """Return the PTX of a module, compiled once per state of the sources and version of Warp."""
    sources = [*HEADERS, *FOLDER.glob("*.py")]
    arch = round(10 * LEAST_CAPABILITY)
    state = blake2b(f"{name} {arch} {wp.__version__}".encode())
    for path in sorted(sources):
        state.update(path.read_bytes())
    kept = Path(os.environ["WARP_CACHE_PATH"]) / "ptx" / f"{name}-{state.hexdigest()[:16]}.ptx"
    if not kept.is_file():
        module = import_module(f"jaxdet_kernels.{name}")
        wp.compile_aot_module(module, arch=arch, module_dir=str(scratch), use_ptx=True)
        (compiled,) = scratch.glob("*.ptx")
        kept.parent.mkdir(parents=True, exist_ok=True)
        partial = kept.with_name(f"{kept.name}.{os.getpid()}")
        shutil.copy(compiled, partial)
        partial.replace(kept)
    return kept.read_text("utf-8")


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA there")
@pytest.mark.parametrize("name", MODULES)
def test_kernels_compile_for_the_earliest_gpu(name: str, tmp_path: Path) -> None:
    module = import_module(f"jaxdet_kernels.{name}")
    entries = re.findall(r"\.entry (\w+)", ptx_of(name, tmp_path))
    values = [*vars(module).values(), *getattr(module, "STEPS", {}).values()]
    kernels = [value.key for value in values if isinstance(value, wp.Kernel)]
    assert kernels
    for kernel in kernels:
        assert any(entry.startswith(kernel) for entry in entries), kernel
