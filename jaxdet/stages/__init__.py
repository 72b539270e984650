"""JAX and Warp implementation of the functions of :mod:`jaxdet.reference`, on batches.

Names are imported when they are used, so that those of ``_on_cpu`` need no JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
