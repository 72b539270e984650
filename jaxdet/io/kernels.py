"""Launches of image decoding kernels on the CPU.

Warp is imported only when an image needs it, not for opening a log.
"""

from functools import cache
from threading import Lock
from typing import Any

import numpy as np

from jaxdet.warp_start import start_warp

_loading = Lock()


def launch(name: str, *arguments: Any) -> None:
    """Launch a kernel of ``jaxdet_kernels.decode``; Python's GIL is released meanwhile.

    Args:
        name: Name of the kernel.
        arguments: Arguments of the kernel; NumPy arrays are passed without a copy.

    Raises:
        ValueError: An array is not contiguous.
    """
    import warp as wp

    with _loading:
        kernels = _kernels()
    for argument in arguments:
        if isinstance(argument, np.ndarray) and not argument.flags.c_contiguous:
            raise ValueError(f"{name} takes contiguous arrays")
    wp.launch(getattr(kernels, name), 1, arguments, device="cpu")


@cache
def _kernels() -> Any:
    start_warp()  # keeps Warp's banner out of standard output
    from jaxdet.runtime.compiled import load_for_cpu
    from jaxdet_kernels import decode

    load_for_cpu(decode)
    return decode
