"""Start of a process that computes: caches of compiled programs, environment, memory."""

import ctypes
import importlib.util
import os
import platform
import stat
import threading
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

from jaxdet.errors import ConfigError, OutputError
from jaxdet.signals import stops_held_back
from jaxdet.warp_start import start_warp

ENVIRONMENT = "JAXDET_CACHE"
"""Environment variable with the folder of caches, or ``off``."""
NOT_KEPT = "can't be written to; set JAXDET_CACHE to a folder that can be, or to off"
"""Problem and remedy for a cache folder that can't be written to."""
UNSAFE = "can be written to by other users, so its compiled programs are not used"
"""Problem of a cache folder that is not safe to use."""


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``."""


class Caches(NamedTuple):
    """Folders of compiled programs; None if programs are not kept."""

    jax: Path | None
    """Folder of programs that XLA compiled."""
    warp: Path | None
    """Folder of kernels that Warp compiled; if it is None, Warp uses its default folder."""


def cache_folders() -> Caches:
    """Return the folders that the environment selects, without making them.

    The default is ``jaxdet`` in the user's cache folder. ``JAXDET_CACHE`` names another folder, or
    is ``off``; ``JAX_COMPILATION_CACHE_DIR`` and ``WARP_CACHE_PATH`` have priority over it. As both
    caches hold machine code, each kind of processor has a folder of its own, so that machines can
    share a home folder. A folder that other users can write to is replaced by the default, see
    :func:`unsafe_caches`.
    """
    choices = zip(_chosen_folders(), _folders_in(_user_cache()), strict=True)
    return Caches(*(next((f for f in pair if not _is_unsafe(f)), None) for pair in choices))


def unsafe_caches() -> list[Path]:
    """Return folders set in the environment that are not used, as other users can write there."""
    return [folder for folder in _chosen_folders() if folder and _is_unsafe(folder)]


def _chosen_folders() -> Caches:
    chosen = os.environ.get(ENVIRONMENT, "")
    base = None
    if chosen.lower() != "off":
        base = Path(chosen).expanduser().absolute() if chosen else _user_cache()
    folders = _folders_in(base)
    own = map(os.environ.get, ("JAX_COMPILATION_CACHE_DIR", "WARP_CACHE_PATH"))
    return Caches(*(Path(o) if o else folder for o, folder in zip(own, folders, strict=True)))


def _folders_in(base: Path | None) -> Caches:
    return Caches(*(base and base / _processor() / name for name in Caches._fields))


def _is_unsafe(folder: Path | None) -> bool:
    """Return whether another user could have put code into a folder.

    This is so if it belongs to another user, or if users outside of the user's own group can write
    to it.
    """
    try:
        status = folder.stat() if folder and hasattr(os, "geteuid") else None
    except OSError:  # it does not exist yet, or can't be read
        return False
    if status is None:
        return False
    by_group = bool(status.st_mode & stat.S_IWGRP) and status.st_gid != os.getegid()
    return status.st_uid != os.geteuid() or by_group or bool(status.st_mode & stat.S_IWOTH)


def use_caches() -> Caches:
    """Make JAX and Warp keep compiled programs; call it before Warp starts.

    Returns:
        The folders in use; None if a cache is off or its folder can't be written to.
    """
    import jax

    folders = Caches(*(folder if is_writable(folder) else None for folder in cache_folders()))
    if folders.jax:
        if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
            _remove_damaged(folders.jax)
        jax.config.update("jax_compilation_cache_dir", str(folders.jax))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        # A killed process may leave damaged entries, whose programs JAX compiles again.
        warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    if folders.warp:
        os.environ["WARP_CACHE_PATH"] = str(folders.warp)  # read when Warp starts
    return folders


def _remove_damaged(folder: Path) -> None:
    """Remove programs whose files have changed since a checksum was made, as JAX would run them.

    JAX keeps no checksums, so a folder next to this one holds a checksum file for each program.
    """
    sums = folder.with_name(f"{folder.name}-checksums")
    with suppress(OSError):
        sums.mkdir(mode=0o700, exist_ok=True)
        for program in folder.glob("*-cache"):
            found = blake2b(program.read_bytes(), digest_size=16).hexdigest()
            known = sums / program.name
            if not known.exists():
                known.write_text(found, encoding="ascii")
            elif known.read_text(encoding="ascii", errors="replace") != found:
                program.unlink()
                known.unlink()


@cache
def start_up() -> None:
    """Prepare this process for computing; does nothing from the second call on.

    Raises:
        ConfigError: JAX has no device of the platform in ``JAX_PLATFORMS``.
    """
    keep_memory()
    _check_platforms()
    use_caches()
    start_warp()


@contextmanager
def computing() -> Iterator[None]:
    """Hold back signals while the detection program is called; the first call compiles it.

    XLA calls kernels in this thread, where an exception would leave a batch half computed.

    Raises:
        OutputError: Compiled programs can't be written to their cache.
    """
    try:
        with stops_held_back():
            yield
    except OSError as error:
        path = error.filename or os.environ.get("WARP_CACHE_PATH", "")
        problem = f"kernels can't be compiled there ({error.strerror or error})"
        remedy = f"make room or set {ENVIRONMENT} to another folder"
        raise OutputError(problem, path=str(path), remedy=remedy) from error


def _check_platforms() -> None:
    """Add the CPU, which the stages need, to JAX's platforms; check that a requested one exists."""
    asked = os.environ.get("JAX_PLATFORMS", "")
    if asked in ("", "cpu"):
        return
    import jax

    alone = "cpu" not in asked.split(",")
    try:
        jax.config.update("jax_platforms", f"{asked},cpu" if alone else asked)
        found = jax.default_backend()
    except RuntimeError:
        found = ""
    if not found or (alone and found == "cpu"):
        problem = f"JAX has no device for JAX_PLATFORMS={asked}"
        raise ConfigError(problem, remedy="unset JAX_PLATFORMS, or set it to cpu")


def may_use_gpus() -> bool:
    """Return whether JAX has a plugin for GPUs and may use it, without loading anything."""
    kept = os.environ.get("JAX_PLATFORMS") == "cpu"
    return not kept and importlib.util.find_spec("jax_plugins") is not None


@cache
def start_cuda() -> bool:
    """Begin to load the CUDA driver in a thread, while this thread imports modules that use it.

    Loading takes a quarter of a second, without Python's global lock. If it fails, the modules that
    use the driver report the error later.

    Returns:
        Whether there is a GPU that JAX may use.
    """
    there = may_use_gpus() and next(Path("/dev").glob("nvidia[0-9]*"), None) is not None
    if there:
        threading.Thread(target=_make_contexts, name="jaxdet-cuda", daemon=True).start()
    return there


def _make_contexts() -> None:
    """Make the primary CUDA context of each GPU, which JAX and Warp share."""
    with suppress(OSError, AttributeError):  # no driver
        cuda = ctypes.CDLL("libcuda.so.1")
        cuda.cuInit(0)
        count, device = ctypes.c_int(), ctypes.c_int()
        cuda.cuDeviceGetCount(ctypes.byref(count))
        for ordinal in range(count.value):
            cuda.cuDeviceGet(ctypes.byref(device), ordinal)
            cuda.cuDevicePrimaryCtxRetain(ctypes.byref(ctypes.c_void_p()), device)


def start_reading() -> None:
    """Prepare a process that only reads images, for the main process, which computes.

    Warp, which decodes some images, may only use the CPU here: a CUDA context in each process would
    take memory of the GPU.
    """
    keep_memory()
    os.environ["CUDA_VISIBLE_DEVICES"] = ""
    use_warp_cache()


def use_warp_cache() -> None:
    """Make Warp use the kernel cache that runs use; call it before Warp starts."""
    folder = cache_folders().warp
    if is_writable(folder):
        os.environ["WARP_CACHE_PATH"] = str(folder)


def keep_memory() -> None:
    """Make glibc keep the memory of freed arrays of up to 32 MiB for later arrays.

    Otherwise the system provides new pages for each array, which takes longer than its computation.
    """
    with suppress(AttributeError, OSError, TypeError):  # another C library, another system
        libc = ctypes.CDLL(None)
        for parameter, value in ((_MMAP_THRESHOLD, 32 << 20), (_TRIM_THRESHOLD, 256 << 20)):
            libc.mallopt(parameter, value)


def _user_cache() -> Path | None:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxdet"
    except RuntimeError:  # no home folder
        return None


@cache
def _processor() -> str:
    """Return a name for this kind of processor, as compiled machine code depends on it."""
    features = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()}-{zlib.crc32(features.encode()):08x}"


def is_writable(folder: Path | None) -> bool:
    """Make a folder if it is missing; return whether it can be written to."""
    if folder is None:
        return False
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
