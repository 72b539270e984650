"""Options of modules whose kernels call the C++ in ``include/jaxdet``.

A kernel is a function of Warp's that passes its arguments to a native one, which has C++ as its
text: a line or two that call what the headers declare. There a 2D array ``a`` of Warp's is
``a.data`` and ``a.shape``.
"""

from pathlib import Path
from typing import Any

import warp as wp

INCLUDE = Path(__file__).parent / "include"
HEADERS = sorted(INCLUDE.glob("jaxdet/*.h"))
CPU_FLAGS = "-march=native"
"""Clang's flags of modules: the same, so that they share a compiled header of Warp's.

Warp's own also raise LLVM's limits of inlining, for all that a process compiles from then on. With
them the floor takes four times as long to compile, and of all kernels the corners alone gain.
"""


def options(*headers: str, cpu_flags: str | None = CPU_FLAGS) -> dict[str, Any]:
    """Options for :func:`warp.set_module_options`: these headers come before the kernels.

    Every operation on floats is rounded on its own. ``block_dim`` is that of the CPU, for which
    Warp's ahead-of-time functions take it from here; launches on CUDA say their own.
    ``extra_build_options`` are experimental in Warp.

    Args:
        headers: Names in ``include/jaxdet``.
        cpu_flags: Clang's flags; None: Warp's own.
    """
    preamble = "".join(f'#include "jaxdet/{name}"\n' for name in headers)
    return {
        "enable_backward": False,
        "fuse_fp": False,
        "block_dim": 1,
        "cpu_compiler_flags": cpu_flags,
        "extra_build_options": wp.ModuleBuildOptions(
            extra_cpu_include_dirs=[INCLUDE],
            extra_cuda_include_dirs=[INCLUDE],
            extra_cpu_preamble=preamble,
            extra_cuda_preamble=preamble,
            extra_build_dependencies=HEADERS,
        ),
    }
