"""Evaluate estimators by their cost-to-go images (section IV-A)."""

from collections.abc import Iterable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax._src.estimation.estimators import Ensemble, Estimator
from dc2g_jax._src.grid.sampling import ClassImage, resize_nearest
from dc2g_jax._src.grid.terrain import TRAVERSABLE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit
from experiments.translator.images import cost_to_go_image, largest_cost
from experiments.translator.metrics import Comparison, compare_images
from experiments.translator.network import TranslatorCostToGo
from experiments.translator.pairs import (
    GRID_CELLS,
    ImageSet,
    MaskedMap,
    houses_with_door,
    labeled_grid,
    labeled_map,
    masked_map,
)
from experiments.translator.similarity import distance_to_training, similarity_scale

#: Side length, in pixels, of the maps for the comparison with training maps.
_COMPARED_SIZE = 256


def map_for(estimator: Estimator, image: ClassImage) -> tuple[UInt8[np.ndarray, "s s"], Float[np.ndarray, "s s"]]:
    """A whole house as the input of an estimator, and its exact cost-to-go.

    The translator reads images of its own size, all other estimators the robots' grid.
    """
    if isinstance(estimator, Ensemble) and isinstance(estimator.members[0], TranslatorCostToGo):
        raise InputError("pictures are those of one translator, not of a mean; give one network")
    if isinstance(estimator, TranslatorCostToGo):
        return labeled_map(image, estimator.architecture.size)
    return labeled_grid(image, GRID_CELLS)


def _costs_to_drive(estimator: Estimator, terrain: UInt8[Array, "s s"]) -> Float[Array, "s s"]:
    """The expected cost-to-go of traversable cells; infinity elsewhere."""
    cost = jnp.mean(estimator.estimate(terrain, estimator.init(World.from_terrain(terrain))), axis=0)
    return jnp.where(jnp.asarray(TRAVERSABLE)[terrain], cost, jnp.inf)


def _predicted_image(
    estimator: Estimator, observed: UInt8[Array, "s s"], whole: UInt8[Array, "s s"]
) -> Float[Array, "s s 3"]:
    """The cost-to-go image that an estimator predicts.

    The translator draws it. Any other estimator gives a cost for every cell, from which the image is made in the same
    way as the true one. Traversability is then known from the map, not estimated, and black is the largest cost that
    the estimator gives on the whole map, as it is the largest cost of the whole map in the true image.

    Args:
      estimator: the estimator.
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
) -> tuple[dict[str, Array], Array, Array, Array]:
    """Compare an estimator's image of one map with the true one.

    Args:
      estimator: the estimator.
      terrain: class indices of the whole map.
      cost_to_go: exact cost-to-go of the whole map.
      seen: observed pixels, bool `[m m]` at any resolution.

    Returns:
      The metrics, and three images: input, prediction and truth.
    """
    observed = resize_nearest(seen, *terrain.shape)
    pair = MaskedMap(terrain, cost_to_go, observed, largest_cost(cost_to_go)).pictures()
    predicted = _predicted_image(estimator, jnp.where(observed, terrain, jnp.uint8(0)), terrain)
    return compare_images(predicted, pair.target).metrics(), pair.image, predicted, pair.target


def full_map_metrics(estimator: Estimator, images: Iterable[ClassImage]) -> list[dict[str, float]]:
    """Metrics of an estimator on fully observed maps, one entry per house (Fig. 6)."""
    everything = jnp.ones((1, 1), bool)
    maps = (map(jnp.asarray, map_for(estimator, image)) for image in images)
    return [as_floats(compare(estimator, terrain, cost, everything)[0]) for terrain, cost in maps]


def distances_from_training(dataset: HouseDataset, houses: Sequence[House]) -> list[float]:
    """Distance of each house from the dataset's training houses (section IV-A3), 0 to 1."""

    def squeezed(house: House) -> UInt8[np.ndarray, "s s"]:
        return resize_nearest(house.terrain, _COMPARED_SIZE, _COMPARED_SIZE)

    scale = similarity_scale(np.stack([squeezed(house) for house in houses_with_door(dataset, "train")]))
    return [distance_to_training(squeezed(house), scale) for house in houses]


def as_floats(metrics: Mapping[str, Array]) -> dict[str, float]:
    """Metrics as Python numbers, by name."""
    return {name: float(value) for name, value in metrics.items()}


@jit
def _compare_pair(network: TranslatorCostToGo, data: ImageSet, index: Int[Array, ""]) -> Comparison:
    pair = masked_map(data, index).pictures()
    return compare_images(network.answer(pair.image[None])[0], pair.target)


def metrics_over_pairs(network: TranslatorCostToGo, data: ImageSet) -> dict[str, float]:
    """Metrics over all pairs of a set (Fig. 5), evaluated one at a time.

    Precision and recall are over the pixels of all images together. Per-image precision would be undefined for images
    without predicted pixels near a goal, and would so reward a network that predicts few.
    """
    rows = [_compare_pair(network, data, index) for index in range(len(data.pair_house))]
    return as_floats(jax.tree.map(lambda *values: jnp.sum(jnp.stack(values)), *rows).metrics(len(rows)))
