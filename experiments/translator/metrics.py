"""Metrics of predicted cost-to-go images (section IV-A3)."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from experiments.translator.images import brightness, looks_traversable

#: Gray pixels that are brighter than this are close to a goal (section IV-A3).
_LOW_COST_BRIGHTNESS = 0.9


class Counts(NamedTuple):
    """Number of pixels that are predicted to be in a set, that are in it, and both; of one image or several."""

    predicted: Int[Array, ""]
    true: Int[Array, ""]
    both: Int[Array, ""]

    def metrics(self, name: str) -> dict[str, Float[Array, ""]]:
        """Precision and recall, by names that begin with that of the set; NaN if there are no such pixels."""
        return {f"{name}_precision": self.both / self.predicted, f"{name}_recall": self.both / self.true}


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

    def metrics(self, pictures: int = 1) -> dict[str, Float[Array, ""]]:
        """The metrics of a sum over this number of images: `l1`, `low_precision`, `traversable_recall` and so on."""
        shares = self.low.metrics("low") | self.traversable.metrics("traversable")
        return {"l1": self.l1 / pictures, **shares}


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


class HouseMetrics(NamedTuple):
    """Metrics of a network by house.

    Attributes:
      distance: distance of each house from the training houses.
      metrics: metric -> value of each house.
      fits: metric -> slope and intercept of the regression line, without metrics that have none.
    """

    distance: Sequence[float]
    metrics: Mapping[str, Sequence[float]]
    fits: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, distance: Sequence[float], rows: Sequence[Mapping[str, float]]) -> "HouseMetrics":
        """Metrics of each house, with a least-squares line for each metric.

        There is no line if all houses have the same distance. Houses without a value are ignored.
        """
        metrics = {name: [row[name] for row in rows] for name in rows[0]}
        fits = {}
        for name, values in metrics.items():
            known = np.isfinite(values)
            apart = np.asarray(distance)[known]
            if apart.size and np.ptp(apart) > 0:
                slope, intercept = np.polyfit(apart, np.asarray(values)[known], 1)
                fits[name] = (float(slope), float(intercept))
        return cls(distance, metrics, fits)

    def summary(self, name: str) -> dict[str, float]:
        """Mean, lowest and highest value of a metric over the houses with a value; slope and intercept of its line.

        NaN where there is none.
        """
        known = [value for value in self.metrics[name] if np.isfinite(value)] or [math.nan]
        slope, intercept = self.fits.get(name, (math.nan, math.nan))
        return {
            "mean": float(np.mean(known)),
            "lowest": min(known),
            "highest": max(known),
            "slope": slope,
            "intercept": intercept,
        }
