"""Kernels in C++ and CUDA, compiled with the headers in ``include/``."""

import linecache
from collections.abc import Callable
from inspect import get_annotations
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


def includes(*headers: str) -> wp.ModuleBuildOptions:
    """Value of a module's option ``extra_build_options``: these headers come before its kernels.

    Warp calls the option experimental.

    Args:
        headers: Names in ````.
    """
    preamble = "".join(f'#include "jaxdet/{name}"\n' for name in headers)
    return wp.ModuleBuildOptions(
        extra_cpu_include_dirs=[INCLUDE],
        extra_cuda_include_dirs=[INCLUDE],
        extra_cpu_preamble=preamble,
        extra_cuda_preamble=preamble,
        extra_build_dependencies=HEADERS,
    )


def bit_words(rows: int, columns: int) -> int:
    """32-bit words of the rows of bits of ``bits.h``: of each row a power of two."""
    return rows << (-(-columns // 32) - 1).bit_length()


def native_kernel(
    *, body: str, launch_bounds: tuple[int, int] = (256, 4)
) -> Callable[[Callable[..., None]], Any]:
    """Makes a kernel whose threads run C++, of a function that only declares its arguments.

    Args:
        body: C++; ``tid`` is the number of the thread.
        launch_bounds: Threads of a block on CUDA, and how many blocks fit on a multiprocessor.

    Returns:
        A decorator; the function's docstring is the kernel's.
    """

    def decorate(declared: Callable[..., None]) -> Any:
        types = get_annotations(declared, eval_str=True)
        return _kernel(declared, types, f"using namespace jaxdet;\n{body}", launch_bounds)

    return decorate


def team_kernel(
    *, body: str, launch_bounds: tuple[int, int] = (256, 4)
) -> Callable[[Callable[..., None]], Any]:
    """Makes a kernel whose teams of threads (``team.h``) take the frames of a batch in turn.

    It has three more arguments than the function declares. With ``share`` and ``shares`` first,
    team ``t`` of a launch takes the frames ``share + t, share + t + shares, ...``; the last is
    ``scratch_out`` ``(teams, words)`` int32.

    Args:
        body: What ``team`` does to frame ``b``; ``scratch`` is the team's memory. The function's
            first argument is an array ``(B, ...)``.
        launch_bounds: As for :func:`native_kernel`.

    Returns:
        A decorator; the function's docstring is the kernel's.
    """

    def decorate(declared: Callable[..., None]) -> Any:
        types = get_annotations(declared, eval_str=True)
        loop = f"""
    const Team team(tid, share);
    int* const scratch = scratch_out.data + (size_t)team.index * scratch_out.shape[1];
    for (int b = team.index; b < {next(iter(types))}.shape[0]; b += shares) {{{body}    }}
"""
        types = {"share": int, "shares": int, **types, "scratch_out": wp.array2d[wp.int32]}
        return _kernel(declared, types, f"using namespace jaxdet;\n{loop}", launch_bounds)

    return decorate


def _kernel(
    declared: Callable[..., None], types: dict[str, Any], snippet: str, bounds: tuple[int, int]
) -> Any:
    """The native function, and the kernel that calls it with the number of the thread."""
    name, module = declared.__name__, declared.__module__
    thread, scope = {"tid": int, **types}, {"wp": wp, "__name__": module}
    function = wp.func_native(snippet)(_function(f"native_{name}", thread, "...", scope))
    scope[f"native_{name}"] = function
    kernel = _function(name, types, f"native_{name}(wp.tid(), {', '.join(types)})", scope)
    kernel.__doc__ = declared.__doc__
    return wp.kernel(launch_bounds=bounds)(kernel)


def _function(name: str, types: dict[str, Any], body: str, scope: dict[str, Any]) -> Any:
    """A Python function with source, which Warp reads."""
    source = f"def {name}({', '.join(types)}):\n    {body}\n"
    file = f"<{scope['__name__']}.{name}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    exec(compile(source, file, "exec"), scope)
    made = scope[name]
    made.__annotations__ = types
    return made
