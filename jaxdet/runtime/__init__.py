"""Declaration, compilation and launch of kernels, by public interfaces of Warp and JAX only.

:mod:`~jaxdet.runtime.compiled` compiles kernels for the CPU ahead of time,
:mod:`~jaxdet.runtime.launch` launches them on all cores, :mod:`~jaxdet.runtime.calls` calls them
under ``jax.jit``, and :mod:`~jaxdet.runtime.layout` packs named arrays into one buffer.
"""
