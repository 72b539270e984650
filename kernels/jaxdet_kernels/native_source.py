"""C++ and CUDA sources of kernels, from the headers in ``native/``."""

import linecache
from collections.abc import Callable
from inspect import get_annotations
from pathlib import Path
from typing import Any

import warp as wp

FOLDER = Path(__file__).parent / "native"
CPU_FLAGS = "-march=native"
"""Clang's flags of modules: the same, so that they share a compiled header of Warp's.

Warp's own also raise LLVM's limits of inlining, for all that a process compiles from then on. With
them the floor takes four times as long to compile, and of all kernels the corners alone gain.
"""


def native(*headers: str, body: str) -> str:
    """The body of a native function: the structs of these headers, then a few lines that use them.

    Args:
        headers: Names in ``native/``, each after those it includes; ``team.h`` comes first always.
        body: C++, with the function's arguments in scope.
    """
    texts = [(FOLDER / name).read_text("utf-8") for name in ("team.h", *headers)]
    lines = [line for text in texts for line in text.splitlines()]
    kept = [line for line in lines if not line.startswith(("#include", "#pragma once"))]
    return "\n".join([*kept, body])


def native_kernel(
    *headers: str, body: str, launch_bounds: tuple[int, int] = (256, 4)
) -> Callable[[Callable[..., None]], Any]:
    """Makes a kernel whose threads run C++, of a function that only declares its arguments.

    Warp wants two functions of the same arguments, the native one and a kernel that calls it, and
    reads both off Python source; here the second is written for it.

    Args:
        headers: As for :func:`native`.
        body: Likewise.
        launch_bounds: Threads of a block on CUDA, and how many blocks fit on a multiprocessor.

    Returns:
        A decorator. The function's first argument is ``tid``, the number of the thread, which the
        kernel itself does not take; its docstring is the kernel's.
    """

    def decorate(declared: Callable[..., None]) -> Any:
        name, types = declared.__name__, get_annotations(declared, eval_str=True)
        arguments = ", ".join(list(types)[1:])
        source = f"def {name}({arguments}):\n    native_{name}(wp.tid(), {arguments})\n"
        declared.__name__ = declared.__qualname__ = f"native_{name}"
        native_function = wp.func_native(native(*headers, body=body))(declared)
        scope = {"wp": wp, "__name__": declared.__module__, declared.__name__: native_function}
        file = f"<{declared.__module__}.{name}>"
        linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
        exec(compile(source, file, "exec"), scope)
        made: Any = scope[name]
        made.__annotations__ = {key: types[key] for key in list(types)[1:]}
        made.__doc__ = declared.__doc__
        return wp.kernel(launch_bounds=launch_bounds)(made)

    return decorate
