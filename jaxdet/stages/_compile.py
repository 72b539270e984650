"""The method's kernels compiled for the CPU, several modules at a time.

Clang inside of a process compiles one module after another, so others are given to processes of
their own, which leave them in Warp's cache.
"""

import os
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from types import ModuleType

import warp as wp

from jaxdet.stages._threads import threads
from jaxdet_kernels import (
    cells,
    chain,
    cover,
    features,
    floor,
    free_floor,
    obstacles,
    outlines,
    surfaces,
)

_MODULES = obstacles, surfaces, cells, floor, outlines, cover, free_floor, chain, features
"""Those that take longest first; the last has flags that stay set in the process."""


def compile_method() -> None:
    """Puts into Warp's cache what the method calls on the CPU and the cache does not have yet."""
    missing = [module for module in _MODULES if not _is_kept(module)]
    count = min(threads(), len(missing)) - 1
    if count < 1:
        return  # Warp compiles a module when it is first called
    left = iter(missing)
    helpers: list[Popen[str]] = []
    with ThreadPoolExecutor(count) as crew:
        for _ in range(count):
            crew.submit(_have_compiled, left, helpers)
        try:
            for module in left:
                wp.load_module(module, device="cpu")
        except BaseException:  # a Ctrl-C, which nobody else should make wait
            list(left)
            for helper in helpers:
                helper.kill()
            raise


def _is_kept(module: ModuleType) -> bool:
    name = wp.get_module(module.__name__).get_module_identifier(1)
    return any(Path(str(wp.config.kernel_cache_dir), name).glob("*.o"))


def _have_compiled(left: Iterator[ModuleType], helpers: list[Popen[str]]) -> None:
    """Has modules compiled by another process; if it fails they are compiled when they are called.

    Args:
        left: Modules; several threads take from it.
        helpers: Gets the process.
    """
    command = [sys.executable, "-P", "-m", "jaxdet_kernels", str(wp.config.kernel_cache_dir)]
    own = {"PYTHONPATH": os.pathsep.join(sys.path), "CUDA_VISIBLE_DEVICES": ""}
    with (
        suppress(OSError),
        Popen(
            command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL, env={**os.environ, **own}, text=True
        ) as process,
    ):
        helpers.append(process)
        assert process.stdout
        for module in left:
            print(module.__name__, file=process.stdin, flush=True)
            if not process.stdout.readline():
                return
