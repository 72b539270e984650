"""Warp kernels; they import Warp and nothing of jaxdet. ``native`` has C++ that several share."""
