"""The method's kernels compiled for the CPU, several modules at a time.

Clang inside of a process compiles one module after another, so others are given to processes of
their own, which leave them in Warp's cache.
"""

import os
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from types import ModuleType

import warp as wp

from jaxdet.cores import cores
from jaxdet_kernels import (
    cells,
    chain,
    features,
    floor,
    free_floor,
    obstacles,
    outlines,
    surfaces,
)

_MODULES = obstacles, surfaces, cells, floor, outlines, free_floor, chain, features
"""Those that take longest first; the last has flags that stay set in the process."""


def compile_method() -> None:
    """Puts into Warp's cache what the method calls on the CPU and the cache does not have yet.

    All cores compile, however many this process computes on. Of processes that start together one
    has it done, and the others wait for it.
    """
    wp.init()  # decides where its cache is
    if not _missing():
        return
    with _alone(Path(str(wp.config.kernel_cache_dir))):
        missing = _missing()
        left = iter(missing)
        count = max(min(cores(), len(missing)) - 1, 0)
        helpers: list[Popen[str]] = []
        with ThreadPoolExecutor(count or 1) as pool:
            for _ in range(count):
                pool.submit(_have_compiled, left, helpers)
            try:
                for module in left:
                    wp.load_module(module, device="cpu")
            except BaseException:  # a Ctrl-C, which nobody else should make wait
                list(left)
                for helper in helpers:
                    helper.kill()
                raise


def _missing() -> list[ModuleType]:
    return [module for module in _MODULES if not _is_kept(module)]


def _is_kept(module: ModuleType) -> bool:
    name = wp.get_module(module.__name__).get_module_identifier(1)
    return any(Path(str(wp.config.kernel_cache_dir), name).glob("*.o"))


@contextmanager
def _alone(cache: Path) -> Iterator[None]:
    """Waits until no other process compiles for a cache, where the system can tell."""
    try:
        import fcntl

        cache.mkdir(parents=True, exist_ok=True)
        lock = os.open(cache / ".compiling", os.O_RDWR | os.O_CREAT)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


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
