"""Estimators judged by the pictures of cost-to-go that they draw (section IV-A)."""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.estimation.estimators import Estimator, TranslatorCostToGo
from dc2g_jax.estimation.images import cost_to_go_image, largest_cost
from dc2g_jax.estimation.metrics import Comparison, ImageMetrics, compare_images
from dc2g_jax.grid.sampling import ClassImage, resize_nearest
from dc2g_jax.grid.terrain import TRAVERSABLE
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.programs import jit
from dc2g_jax.training.image_pairs import ImageSet, MaskedMap, labeled_grid, labeled_map, masked_map

#: Cells a side of the gridworld (section IV-B).
GRID_CELLS = 50


def map_for(estimator: Estimator, image: ClassImage) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A whole house as an estimator reads it, and its exact cost-to-go.

    The translator reads pictures of its own size; any other estimator the grid that robots move on.
    """
    if isinstance(estimator, TranslatorCostToGo):
        return labeled_map(image, estimator.architecture.size)
    return labeled_grid(image, GRID_CELLS)


def _costs_to_drive(estimator: Estimator, terrain: UInt8[Array, "s s"]) -> Float[Array, "s s"]:
    """The expected cost-to-go of every cell that can be driven on; infinity elsewhere."""
    cost = jnp.mean(estimator.estimate(terrain, estimator.init(world_from_terrain(terrain))), axis=0)
    return jnp.where(jnp.asarray(TRAVERSABLE)[terrain], cost, jnp.inf)


def predicted_image(
    estimator: Estimator, observed: UInt8[Array, "s s"], whole: UInt8[Array, "s s"]
) -> Float[Array, "s s 3"]:
    """The picture of the cost-to-go that an estimator has in mind.

    The translator draws it. Any other estimator gives a cost for every cell, from which the picture is made as the true
    one is; what can be driven on is then known from the map, not estimated, and black is the largest cost that it gives
    on the whole map, as it is the largest of the whole map in the true picture.

    Args:
      estimator: what to ask.
      observed: observed class indices, see `map_for`.
      whole: class indices of the whole map.
    """
    if isinstance(estimator, TranslatorCostToGo):
        return estimator.translate(observed[None])[0]
    largest = largest_cost(_costs_to_drive(estimator, whole))
    return cost_to_go_image(_costs_to_drive(estimator, observed), observed, largest)


@jit
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
    pair = MaskedMap(terrain, cost_to_go, observed, largest_cost(cost_to_go)).pictures()
    predicted = predicted_image(estimator, jnp.where(observed, terrain, jnp.uint8(0)), terrain)
    return compare_images(predicted, pair.target).metrics(), pair.image, predicted, pair.target


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


@jit
def _compare_pair(network: TranslatorCostToGo, data: ImageSet, index: Int[Array, ""]) -> Comparison:
    pair = masked_map(data, index).pictures()
    return compare_images(network.answer(pair.image[None])[0], pair.target)


def metrics_over_pairs(network: TranslatorCostToGo, data: ImageSet) -> dict[str, float]:
    """Metrics over all pairs of a set (Fig. 5), which are asked about one at a time.

    Precision and recall are of the pixels of all pictures together: of a picture in which nothing is predicted to be
    near a goal there is no precision, and a network that says little is not to be rewarded.
    """
    rows = [_compare_pair(network, data, index) for index in range(len(data.pair_house))]
    return as_floats(jax.tree.map(lambda *values: jnp.sum(jnp.stack(values)), *rows).metrics(len(rows)))
