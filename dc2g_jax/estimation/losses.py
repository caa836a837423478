"""Losses between an estimated and an exact cost-to-go grid."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def weighted_l1(
    estimate: Float[Array, "h w"], target: Float[Array, "h w"], weight: Float[Array, "h w"]
) -> Float[Array, ""]:
    """Mean absolute error in cells over the cells of one map, weighted; 0 where all weights are 0.

    Targets of weight 0 may be infinite.
    """
    error = jnp.where(weight > 0, jnp.abs(estimate - target), 0.0)
    return jnp.sum(error * weight) / jnp.maximum(jnp.sum(weight), 1e-6)
