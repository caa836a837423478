"""Metrics of predicted cost-to-go images (section IV-A3)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax._src.estimation.images import brightness, looks_traversable

#: Gray pixels that are brighter than this are close to a goal (section IV-A3).
_LOW_COST_BRIGHTNESS = 0.9


class ImageMetrics(NamedTuple):
    """Metrics of predicted images. Precision and recall are NaN if there are no such pixels.

    Attributes:
      l1: mean absolute error over pixels and colors.
      low_precision: precision of pixels with low cost-to-go.
      low_recall: recall of pixels with low cost-to-go.
      traversable_precision: precision of traversable pixels.
      traversable_recall: recall of traversable pixels.
    """

    l1: Float[Array, ""]
    low_precision: Float[Array, ""]
    low_recall: Float[Array, ""]
    traversable_precision: Float[Array, ""]
    traversable_recall: Float[Array, ""]


class Counts(NamedTuple):
    """Number of pixels that are predicted to be in a set, that are in it, and both; of one image or several."""

    predicted: Int[Array, ""]
    true: Int[Array, ""]
    both: Int[Array, ""]

    @property
    def precision(self) -> Float[Array, ""]:
        """Share of the predicted pixels that are in the set."""
        return self.both / self.predicted

    @property
    def recall(self) -> Float[Array, ""]:
        """Share of the pixels in the set that are predicted."""
        return self.both / self.true


class Comparison(NamedTuple):
    """Comparison of predicted and true images, from which metrics are computed. Comparisons can be summed.

    Attributes:
      l1: mean absolute error over pixels and colors; summed over images.
      low: pixels with low cost-to-go.
      traversable: traversable pixels.
    """

    l1: Float[Array, ""]
    low: Counts
    traversable: Counts

    def metrics(self, pictures: int = 1) -> ImageMetrics:
        """The metrics of a sum over this number of images."""
        low, drivable = self.low, self.traversable
        return ImageMetrics(self.l1 / pictures, low.precision, low.recall, drivable.precision, drivable.recall)


def _low_cost(image: Float[Array, "h w 3"]) -> Bool[Array, "h w"]:
    """Pixels with low cost-to-go (V > 0.9 and S < 0.3)."""
    return looks_traversable(image) & (brightness(image) > _LOW_COST_BRIGHTNESS)


def _counts(predicted: Bool[Array, "h w"], true: Bool[Array, "h w"]) -> Counts:
    return Counts(jnp.sum(predicted), jnp.sum(true), jnp.sum(predicted & true))


def compare_images(predicted: Float[Array, "h w 3"], true: Float[Array, "h w 3"]) -> Comparison:
    """Compare a predicted image with the true one; use `jax.vmap` for several."""
    return Comparison(
        l1=jnp.mean(jnp.abs(predicted - true)),
        low=_counts(_low_cost(predicted), _low_cost(true)),
        traversable=_counts(looks_traversable(predicted), looks_traversable(true)),
    )
