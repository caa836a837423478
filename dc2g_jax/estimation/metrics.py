"""How good a predicted cost-to-go picture is (section IV-A3)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.estimation.images import brightness, looks_traversable

#: A pixel that is gray and brighter than this is close to a goal (section IV-A3).
LOW_COST_BRIGHTNESS = 0.9


class ImageMetrics(NamedTuple):
    """Predicted pictures against the true ones. A share of nothing is no number.

    Attributes:
      l1: mean absolute difference over pixels and colors.
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


class Counts(NamedTuple):
    """Pixels that are predicted to be in a set, that are in it, and both; of one picture, or of several added up."""

    predicted: Int[Array, ""]
    true: Int[Array, ""]
    both: Int[Array, ""]

    @property
    def precision(self) -> Float[Array, ""]:
        """Of the predicted pixels, the share that is in the set."""
        return self.both / self.predicted

    @property
    def recall(self) -> Float[Array, ""]:
        """Of the pixels in the set, the share that is predicted."""
        return self.both / self.true


class Comparison(NamedTuple):
    """What the metrics of a picture, or of several, are made of.

    Attributes:
      l1: mean absolute difference over pixels and colors; added up, where pictures are.
      low: pixels of low cost-to-go.
      traversable: pixels that can be driven on.
    """

    l1: Float[Array, ""]
    low: Counts
    traversable: Counts

    def metrics(self, pictures: int = 1) -> ImageMetrics:
        """The metrics of so many pictures that were added up."""
        low, drivable = self.low, self.traversable
        return ImageMetrics(self.l1 / pictures, low.precision, low.recall, drivable.precision, drivable.recall)


def low_cost(image: Float[Array, "h w 3"]) -> Bool[Array, "h w"]:
    """Pixels of low cost-to-go (V > 0.9 and S < 0.3)."""
    return looks_traversable(image) & (brightness(image) > LOW_COST_BRIGHTNESS)


def _counts(predicted: Bool[Array, "h w"], true: Bool[Array, "h w"]) -> Counts:
    return Counts(jnp.sum(predicted), jnp.sum(true), jnp.sum(predicted & true))


def compare_images(predicted: Float[Array, "h w 3"], true: Float[Array, "h w 3"]) -> Comparison:
    """Compare a predicted picture with the true one; `jax.vmap` makes it take many."""
    return Comparison(
        l1=jnp.mean(jnp.abs(predicted - true)),
        low=_counts(low_cost(predicted), low_cost(true)),
        traversable=_counts(looks_traversable(predicted), looks_traversable(true)),
    )
