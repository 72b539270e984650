"""Cache of kernels compiled ahead of time for the CPU: a folder per module, version and machine."""

import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import blake2b
from pathlib import Path
from threading import Lock
from types import ModuleType

import warp as wp

import jaxdet_kernels
from jaxdet.errors import JaxdetError
from jaxdet.warp_start import start_warp

_CHECKSUMS = "checksums"
_lock = Lock()
_loaded: set[str] = set()


def load_for_cpu(module: ModuleType) -> None:
    """Load the kernels of a module for the CPU; compile them if no process has done so yet.

    Compiled files are written to a new folder in Warp's cache, which gets its final name only after
    the code was loaded, so later processes never use the files of a crash or a full disk. If a
    checksum is wrong, the module is compiled again. If several processes start together, one
    compiles and the others wait until it has finished.
    """
    with _lock:
        if module.__name__ in _loaded:
            return
        start_warp()  # determines the location of the cache
        folder = _folder(module)
        if not _load(module, folder):
            with _alone(folder.parent):
                if not _load(module, folder):
                    _compile(module, folder)
        _loaded.add(module.__name__)


def _folder(module: ModuleType) -> Path:
    """Return a module's folder in Warp's cache, whose location Warp sets when it is started."""
    return Path(str(wp.config.kernel_cache_dir)) / f"{module.__name__}-{_version()}"


def _load(module: ModuleType, folder: Path) -> bool:
    """Return whether the folder exists, is undamaged, and could be loaded."""
    try:
        if (folder / _CHECKSUMS).read_text(encoding="utf-8") != _checksums(folder):
            return False
        wp.load_aot_module(module, device="cpu", module_dir=folder)
    except Exception:  # a missing file, or any error of Warp about code for another machine
        return False
    return True


def _compile(module: ModuleType, folder: Path) -> None:
    """Compile and load a module; it is cached if the cache is writable.

    Raises:
        JaxdetError: The compiler fails, or its code cannot be loaded.
    """
    made = _new_folder(folder.parent)
    try:
        try:
            wp.compile_aot_module(module, device="cpu", module_dir=made)
            wp.load_aot_module(module, device="cpu", module_dir=made)
            (made / _CHECKSUMS).write_text(_checksums(made), encoding="utf-8")
        except Exception as error:
            problem = f"the kernels {module.__name__} can't be compiled: {error}"
            raise JaxdetError(problem, remedy=f"check the free space in {made.parent}") from error
        shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):
            made.rename(folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _checksums(folder: Path) -> str:
    """Return a line of name and checksum for each compiled file of a folder."""
    files = sorted(path for path in folder.iterdir() if path.name != _CHECKSUMS)
    sums = (blake2b(path.read_bytes(), digest_size=16).hexdigest() for path in files)
    return "".join(f"{sum_} {path.name}\n" for sum_, path in zip(sums, files, strict=True))


def _new_folder(parent: Path) -> Path:
    try:
        parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=".compiling-", dir=parent))
    except OSError:  # the cache can't be written; code needs no files once it is loaded
        return Path(tempfile.mkdtemp())


@cache
def _version() -> str:
    """Return a hash of the kernels' sources, Warp's version and the processor's instruction set.

    The hash includes the path of the sources, which is part of Warp's name of a compiled module:
    otherwise two installations would overwrite each other's kernels.
    """
    sources = Path(jaxdet_kernels.__file__ or "").parent
    about = f"{wp.__version__} {platform.machine()} {sources}"
    found = blake2b(about.encode(), digest_size=8)
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        found.update("\n".join(s for s in lines[:40] if s.startswith(("flags", "model"))).encode())
    for file in sorted(path for path in sources.rglob("*") if path.suffix in (".h", ".py")):
        found.update(file.read_bytes())
    return found.hexdigest()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold the lock by which one process at a time compiles, if the system supports locks."""
    try:
        import fcntl

        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / ".compiling", os.O_RDWR | os.O_CREAT)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):  # file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)
