"""Estimators judged by the pictures of cost-to-go that they draw (section IV-A)."""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.datasets.image_pairs import ImageSet, labelled_grid, labelled_map, make_image_pair, masked_pair
from dc2g_jax.estimation.estimators import Estimator, TranslatorCostToGo
from dc2g_jax.estimation.images import cost_to_go_image
from dc2g_jax.estimation.metrics import ImageMetrics, image_metrics
from dc2g_jax.grid.sampling import ClassImage, resize_nearest
from dc2g_jax.grid.terrain import TRAVERSABLE
from dc2g_jax.grid.world import world_from_terrain

#: Cells a side of the gridworld (section IV-B).
GRID_CELLS = 50


def map_for(estimator: Estimator, image: ClassImage) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A whole house as an estimator reads it, and its exact cost-to-go.

    The translator reads pictures of its own size; any other estimator the grid that robots move on.
    """
    if isinstance(estimator, TranslatorCostToGo):
        return labelled_map(image, estimator.architecture.size)
    return labelled_grid(image, GRID_CELLS)


def predicted_image(estimator: Estimator, terrain: UInt8[Array, "s s"]) -> Float[Array, "s s 3"]:
    """The picture of the cost-to-go that an estimator has in mind.

    The translator draws it. Any other estimator gives a cost for every cell, from which the picture is made as the true
    one is; what can be driven on is then known from the map, not estimated.

    Args:
      estimator: what to ask.
      terrain: observed class indices, see `map_for`.
    """
    if isinstance(estimator, TranslatorCostToGo):
        return estimator.translate(terrain[None])[0]
    cost = jnp.mean(estimator.estimate(terrain, estimator.init(world_from_terrain(terrain))), axis=0)
    return cost_to_go_image(jnp.where(jnp.asarray(TRAVERSABLE)[terrain], cost, jnp.inf), terrain)


@jax.jit
def compare(
    estimator: Estimator, terrain: UInt8[Array, "s s"], cost_to_go: Float[Array, "s s"], seen: Array
) -> tuple[ImageMetrics, Array, Array, Array]:
    """Ask an estimator about one map and compare its picture with the true one.

    Args:
      estimator: what to ask.
      terrain: class indices of the whole map.
      cost_to_go: exact cost-to-go of the whole map.
      seen: what is observed, bool `[m m]` at any resolution.

    Returns:
      The metrics, and three pictures: input, prediction and truth.
    """
    observed = resize_nearest(seen, *terrain.shape)
    pair = masked_pair(terrain, cost_to_go, observed)
    predicted = predicted_image(estimator, jnp.where(observed, terrain, jnp.uint8(0)))
    return image_metrics(predicted, pair.target), pair.image, predicted, pair.target


def full_map_metrics(estimator: Estimator, images: Iterable[ClassImage]) -> list[dict[str, float]]:
    """Metrics of an estimator on fully observed maps, one house after another (Fig. 6)."""
    everything = jnp.ones((1, 1), bool)
    rows = []
    for image in images:
        terrain, cost = map_for(estimator, image)
        rows.append(as_floats(compare(estimator, jnp.asarray(terrain), jnp.asarray(cost), everything)[0]))
    return rows


def as_floats(metrics: ImageMetrics) -> dict[str, float]:
    """Metrics as plain numbers, by name."""
    return {name: float(value) for name, value in metrics._asdict().items()}


@jax.jit
def _pair_metrics(network: TranslatorCostToGo, data: ImageSet, index: Int[Array, ""]) -> ImageMetrics:
    pair = make_image_pair(data, index)
    return image_metrics(network.answer(pair.image[None])[0], pair.target)


def mean_metrics(network: TranslatorCostToGo, data: ImageSet) -> dict[str, float]:
    """Mean of each metric over all pairs of a set (Fig. 5), which are asked about one at a time."""
    rows = [_pair_metrics(network, data, index) for index in range(len(data.pair_house))]
    return as_floats(jax.tree.map(lambda *values: np.mean(values), *rows))
