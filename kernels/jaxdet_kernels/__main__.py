"""Compiles for the CPU what is named on standard input, for a process that compiles the rest.

``python -m jaxdet_kernels CACHE`` reads a module's name a line, and answers each with a line when
the module is in the folder ``CACHE`` of Warp's; see ``jaxdet/stages/_compile.py``.
"""

import sys
from importlib import import_module

import warp as wp

if __name__ == "__main__":
    wp.config.log_level = wp.LOG_ERROR
    wp.init()  # which would add Warp's version to the folder
    wp.config.kernel_cache_dir = sys.argv[1]
    for line in sys.stdin:
        wp.load_module(import_module(line.strip()), device="cpu")
        print(flush=True)
