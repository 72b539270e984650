"""Warp without what it writes to the standard streams, and without torn kernels in its cache."""

import json
import os
import re
import shutil
import struct
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock

_ELF = struct.Struct("<40xQ10xHH")
"""Of the head: where the table of sections is, the size of an entry, and their number."""
_BEING_MADE = re.compile(r".*_p\d+_t\d+")
"""Folders that a process writes a module into, before Warp gives them their name."""
_MAKING_S = 3600.0
"""Longer ones were left by processes that were killed."""


def quiet_warp() -> None:
    """Starts Warp without its banner, and without its note that there is no CUDA driver.

    Compiled kernels of ours that a crash or a full disk left torn are removed, and made again when
    they are needed; Warp itself would fail at them at every start. Once it has started nothing is
    done any more.
    """
    with _lock:
        _start_warp()


_lock = Lock()


@cache
def _start_warp() -> None:
    import warp

    warp.config.log_level = warp.LOG_ERROR
    with suppress(OSError):  # nobody reads it
        sys.stderr.flush()
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)  # the note comes from native code
        warp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)
    remove_torn(Path(warp.config.kernel_cache_dir or "."))


def remove_torn(cache: Path) -> list[Path]:
    """Removes the modules of ours in a cache of Warp's that are not whole; returns them."""
    torn = [folder for folder in cache.glob("wp_jaxdet_kernels.*") if _is_torn(folder)]
    for folder in torn:
        shutil.rmtree(folder, ignore_errors=True)
    return torn


def _is_torn(folder: Path) -> bool:
    if _BEING_MADE.fullmatch(folder.name):
        with suppress(FileNotFoundError):  # it has its name now
            return time.time() - folder.stat().st_mtime > _MAKING_S
        return False
    return not all(_is_whole(file) for file in folder.glob("*"))


def _is_whole(file: Path) -> bool:
    """Whether an object file goes to the end of its sections, and a JSON file can be read."""
    try:
        if file.suffix == ".meta":
            return isinstance(json.loads(file.read_bytes()), dict)
        if file.suffix in (".o", ".cubin"):
            with file.open("rb") as opened:
                place, size, count = _ELF.unpack(opened.read(_ELF.size))
            return place + size * count <= file.stat().st_size
    except FileNotFoundError:  # another process replaces it
        return True
    except (OSError, ValueError, struct.error):
        return False
    return True
