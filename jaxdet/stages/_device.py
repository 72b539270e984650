"""Which kind of device the stages run on."""

import jax


def on_cuda() -> bool:
    """Whether JAX's default device is a CUDA device."""
    chosen = getattr(jax.config, "jax_default_device", None)
    platform = getattr(chosen, "platform", chosen) or jax.default_backend()
    return platform in ("gpu", "cuda")
