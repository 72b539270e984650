"""Obstacle detection with RGB-D cameras: ``Detector`` for frames, ``run`` for logs.

Names are imported on first use, so that ``import jaxdet`` imports no heavy package.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
