"""Start of Warp without output to the standard streams."""

import os
import sys
from contextlib import suppress
from functools import cache
from threading import Lock


def start_warp() -> None:
    """Start Warp without its banner, and without its warning about a missing CUDA driver."""
    with _lock:
        _start_warp()


_lock = Lock()


@cache
def _start_warp() -> None:
    import warp

    warp.config.log_level = warp.LOG_ERROR
    with suppress(OSError):  # the pipe is closed
        sys.stderr.flush()
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)  # the warning comes from native code
        warp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)
