"""What each process does before it computes: caches between runs, and a quiet Warp."""

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
"""Environment variable: the folder, or ``off``."""
NOT_KEPT = "can't be written to; set JAXDET_CACHE to a folder that can be, or to off"
"""What is wrong with a folder, and the remedy."""
UNSAFE = "can be written to by other users, so its compiled programs are not used"
"""Likewise."""


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Of ``mallopt``."""


class Caches(NamedTuple):
    """Two folders; None: not kept."""

    jax: Path | None
    """Programs that XLA compiled."""
    warp: Path | None
    """Kernels that Warp compiled; without a folder Warp uses its own."""


def cache_folders() -> Caches:
    """Return the folders that the environment selects, without making them.

    ``JAXDET_CACHE`` names another folder than ``jaxdet`` in the user's cache folder, or is
    ``off``. ``JAX_COMPILATION_CACHE_DIR`` and ``WARP_CACHE_PATH`` go before it. As both caches
    hold machine code, each kind of processor has a folder of its own, so that a home folder may
    be shared; and a folder that other users can write to is replaced by the one in the user's
    cache folder, see :func:`unsafe_caches`.
    """
    chosen, own = _chosen_folders(), _folders_in(_user_cache())
    return Caches(
        *(
            folder if not _is_unsafe(folder) else own[i] if not _is_unsafe(own[i]) else None
            for i, folder in enumerate(chosen)
        )
    )


def unsafe_caches() -> list[Path]:
    """Return the folders of the environment that are not used: other users can write to them."""
    return [folder for folder in _chosen_folders() if folder and _is_unsafe(folder)]


def _chosen_folders() -> Caches:
    base = None
    chosen = os.environ.get(ENVIRONMENT, "")
    if chosen.lower() != "off":
        base = Path(chosen).expanduser().absolute() if chosen else _user_cache()
    own_jax = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    own_warp = os.environ.get("WARP_CACHE_PATH")
    found = _folders_in(base)
    return Caches(
        Path(own_jax) if own_jax else found.jax, Path(own_warp) if own_warp else found.warp
    )


def _folders_in(base: Path | None) -> Caches:
    return Caches(*(base and base / _processor() / name for name in Caches._fields))


def _is_unsafe(folder: Path | None) -> bool:
    """Return whether another user could have put code into a folder.

    It belongs to another user, or others than the user's own group can write to it.
    """
    try:
        status = folder.stat() if folder and hasattr(os, "geteuid") else None
    except OSError:  # not there yet, or not to be had
        return False
    if status is None:
        return False
    by_group = bool(status.st_mode & stat.S_IWGRP) and status.st_gid != os.getegid()
    return status.st_uid != os.geteuid() or by_group or bool(status.st_mode & stat.S_IWOTH)


def use_caches() -> Caches:
    """Makes JAX and Warp keep what they compile; to be called before Warp starts.

    Returns:
        The folders in use; None where it is switched off or the folder can't be written to.
    """
    import jax

    folders = Caches(*(folder if is_writable(folder) else None for folder in cache_folders()))
    if folders.jax:
        if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
            _remove_damaged(folders.jax)
        jax.config.update("jax_compilation_cache_dir", str(folders.jax))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        # A torn entry, of a process that was killed, costs a compilation and no warning.
        warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    if folders.warp:
        os.environ["WARP_CACHE_PATH"] = str(folders.warp)  # read when Warp starts
    return folders


def _remove_damaged(folder: Path) -> None:
    """Remove programs that have changed since they were first found; JAX would run them.

    JAX keeps no checksums, so a file next to the folder holds one of each program.
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
    """Prepare this process for computing, in the order that it needs; once.

    Raises:
        ConfigError: JAX has no device of the platform that the environment asks for.
    """
    keep_memory()
    _check_platforms()
    use_caches()
    start_warp()


@contextmanager
def computing() -> Iterator[None]:
    """Around each call of the method.

    XLA calls kernels back in this thread, where an exception would leave a batch half computed, so
    signals wait. The first call compiles.

    Raises:
        OutputError: What is compiled can't be written to its cache.
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
    """The stages need the CPU beside any other platform, and all that are asked for."""
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
    """Whether JAX has a plugin for GPUs and is not kept from them; loads nothing."""
    kept = os.environ.get("JAX_PLATFORMS") == "cpu"
    return not kept and importlib.util.find_spec("jax_plugins") is not None


@cache
def start_cuda() -> bool:
    """Begins to load the driver's part of CUDA in a thread, while this one imports what uses it.

    It takes a quarter of a second, without Python's lock. What goes wrong is said by who uses it.

    Returns:
        Whether there is a device that JAX may use.
    """
    there = may_use_gpus() and next(Path("/dev").glob("nvidia[0-9]*"), None) is not None
    if there:
        threading.Thread(target=_make_contexts, name="jaxdet-cuda", daemon=True).start()
    return there


def _make_contexts() -> None:
    """Makes the primary context of each device, which libraries share."""
    with suppress(OSError, AttributeError):  # no driver
        cuda = ctypes.CDLL("libcuda.so.1")
        cuda.cuInit(0)
        count, device = ctypes.c_int(), ctypes.c_int()
        cuda.cuDeviceGetCount(ctypes.byref(count))
        for ordinal in range(count.value):
            cuda.cuDeviceGet(ctypes.byref(device), ordinal)
            cuda.cuDevicePrimaryCtxRetain(ctypes.byref(ctypes.c_void_p()), device)


def start_reading() -> None:
    """What a process does that reads for another that computes.

    Where images are decoded by kernels Warp is loaded, for the CPU alone: a CUDA context in each
    process would take memory of the GPU.
    """
    keep_memory()
    os.environ["CUDA_VISIBLE_DEVICES"] = ""
    use_warp_cache()


def use_warp_cache() -> None:
    """Make Warp keep what it compiles where runs do; to be called before Warp starts."""
    folder = cache_folders().warp
    if is_writable(folder):
        os.environ["WARP_CACHE_PATH"] = str(folder)


def keep_memory() -> None:
    """Makes glibc keep the memory of freed arrays of up to 32 MiB for the next ones.

    Else each gets fresh pages of the system, which cost more than what is done with them.
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
    """A name for what machine code made here runs on."""
    features = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()}-{zlib.crc32(features.encode()):08x}"


def is_writable(folder: Path | None) -> bool:
    """Whether a folder is there, made if need be, and can be written to."""
    if folder is None:
        return False
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
