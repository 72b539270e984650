"""Declaration, compilation and launch of kernels, by public interfaces of Warp and JAX only.

Ahead-of-time compilation for the CPU (:mod:`~jaxdet.runtime.compiled`); launches on all cores or by
teams of CUDA threads (:mod:`~jaxdet.runtime.launch`); calls under ``jax.jit``
(:mod:`~jaxdet.runtime.calls`); named arrays in one buffer (:mod:`~jaxdet.runtime.layout`).
"""
