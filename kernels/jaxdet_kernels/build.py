"""Options of modules whose kernels call the C++ in ``include/jaxdet``.

A kernel is a Warp function that passes its arguments to a native function, whose body is C++ that
calls the headers. In this C++, a Warp array ``a`` has the pointer ``a.data`` and the lengths
``a.shape``.
"""

from pathlib import Path
from typing import Any

import warp as wp

INCLUDE = Path(__file__).parent / "include"
HEADERS = sorted(INCLUDE.glob("jaxdet/*.h"))
CPU_FLAGS = "-march=native"
"""Clang flags of all modules; equal flags let modules share a precompiled header of Warp.

Warp's default flags also raise LLVM's inlining limits for everything that the process compiles
afterwards. With these limits the floor takes four times as long to compile, and only the corners
run faster."""

WIDTH, BLOCKS = 256, 4
"""Threads per team on CUDA, and teams that are resident on a multiprocessor at once: a thread has
up to 64 registers."""


def options(*headers: str) -> dict[str, Any]:
    """Return options for :func:`warp.set_module_options` that include headers before the kernels.

    Every floating-point operation is rounded separately. ``block_dim`` is used by Warp's
    ahead-of-time functions for the CPU; launches on CUDA pass their own block size.
    ``extra_build_options`` are experimental in Warp.

    Args:
        headers: Names in ``include/jaxdet``.
    """
    preamble = "".join(f'#include "jaxdet/{name}"\n' for name in headers)
    return {
        "enable_backward": False,
        "fuse_fp": False,
        "block_dim": 1,
        "cpu_compiler_flags": CPU_FLAGS,
        "extra_build_options": wp.ModuleBuildOptions(
            extra_cpu_include_dirs=[INCLUDE],
            extra_cuda_include_dirs=[INCLUDE],
            extra_cpu_preamble=preamble,
            extra_cuda_preamble=preamble,
            extra_build_dependencies=HEADERS,
        ),
    }
