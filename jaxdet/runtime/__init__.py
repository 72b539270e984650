"""How a kernel is declared to JAX, compiled and launched, by public interfaces of Warp and JAX.

Compiled for the CPU ahead of time (:mod:`~jaxdet.runtime.compiled`); launched on all cores or by
teams of CUDA's threads (:mod:`~jaxdet.runtime.launch`); called under ``jax.jit``
(:mod:`~jaxdet.runtime.calls`); with named arrays in one buffer (:mod:`~jaxdet.runtime.layout`).
"""
