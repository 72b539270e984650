"""Warp kernels, one file a stage; they import Warp and nothing of jaxdet."""
