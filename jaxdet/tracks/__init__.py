"""Tracking of the obstacles of a log. :func:`track_results` implements ``jaxdet track``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
