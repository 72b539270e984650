"""Sorting with one 32-bit key, which is what XLA sorts quickly on every device."""

import jax
import jax.numpy as jnp

RANK_BITS = 13
RANK_MASK = (1 << RANK_BITS) - 1
"""A frame has at most 2^13 points; what is sorted has 19 bits."""


def rank(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sorts ``(N,)`` int32 values in [0, 2^19).

    Returns:
        The slots in rising order, and each slot's rank, both ``(N,)``, int32 and uint32.
    """
    n = values.shape[0]
    slot = jnp.arange(n, dtype=jnp.uint32)
    order = (jnp.sort((values.astype(jnp.uint32) << RANK_BITS) | slot) & RANK_MASK).astype(
        jnp.int32
    )
    return order, jnp.zeros(n, jnp.uint32).at[order].set(slot, unique_indices=True)
