"""JAX and Warp implementation of the functions of :mod:`jaxdet.reference`, on batches.

Names are imported when they are used, so that :func:`find_floors` runs without JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
