"""How good a predicted cost-to-go picture is (section IV-A3)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from dc2g_jax.estimation.images import brightness, looks_traversable

#: A pixel that is grey and brighter than this is close to a goal (section IV-A3).
LOW_COST_BRIGHTNESS = 0.9


class ImageMetrics(NamedTuple):
    """A predicted picture against the true one.

    Attributes:
      l1: mean absolute difference over pixels and colours.
      low_precision: of the pixels predicted to have a low cost-to-go, the share that has.
      low_recall: of the pixels that have a low cost-to-go, the share predicted.
      traversable_precision: the same of the pixels that can be driven on.
      traversable_recall: the same of the pixels that can be driven on.
    """

    l1: Float[Array, ""]
    low_precision: Float[Array, ""]
    low_recall: Float[Array, ""]
    traversable_precision: Float[Array, ""]
    traversable_recall: Float[Array, ""]


def share(part: Bool[Array, "h w"], whole: Bool[Array, "h w"]) -> Float[Array, ""]:
    """Share of a set's pixels that are in another; 1 where the set is empty: nothing in it was wrong or missed."""
    count = jnp.sum(whole)
    return jnp.where(count > 0, jnp.sum(part & whole) / jnp.maximum(count, 1), 1.0)


def low_cost(image: Float[Array, "h w 3"]) -> Bool[Array, "h w"]:
    """Pixels of low cost-to-go (V > 0.9 and S < 0.3)."""
    return looks_traversable(image) & (brightness(image) > LOW_COST_BRIGHTNESS)


def image_metrics(predicted: Float[Array, "h w 3"], true: Float[Array, "h w 3"]) -> ImageMetrics:
    """Compare a predicted picture with the true one; `jax.vmap` makes it take many.

    A precision is 1 where nothing is predicted, a recall is 1 where there is nothing to find.
    """
    low, true_low = low_cost(predicted), low_cost(true)
    drivable, true_drivable = looks_traversable(predicted), looks_traversable(true)
    return ImageMetrics(
        l1=jnp.mean(jnp.abs(predicted - true)),
        low_precision=share(true_low, low),
        low_recall=share(low, true_low),
        traversable_precision=share(true_drivable, drivable),
        traversable_recall=share(drivable, true_drivable),
    )
