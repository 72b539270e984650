"""JAX and Warp implementation of the functions of :mod:`jaxdet.reference`, on batches.

Each name is imported on first use, so that the functions of ``_on_cpu`` do not load JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
