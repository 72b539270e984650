"""Warp kernels; the package imports only Warp, and their C++ code is in ``include/jaxdet``."""
