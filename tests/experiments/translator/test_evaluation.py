"""Any estimator can be judged by pictures, and exact values make perfect ones."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.estimation.estimators import ExactCostToGo
from dc2g_jax._src.estimation.weights import with_weights
from dc2g_jax._src.grid.search import EIGHT_CONNECTED
from dc2g_jax._src.grid.terrain import FRONT_DOOR, GRASS, ROAD, TRAVERSABLE
from dc2g_jax._src.readers.houses import House
from experiments.translator.drawn_masks import drawn_masks
from experiments.translator.evaluation import as_floats, compare, full_map_metrics, map_for, metrics_over_pairs
from experiments.translator.images import in_eight_bits
from experiments.translator.metrics import HouseMetrics, compare_images
from experiments.translator.network import Generator, TranslatorArchitecture, TranslatorCostToGo, init_weights
from experiments.translator.pairs import all_pairs, masked_map
from tests.support import maps


def house_with_door(seed: int) -> np.ndarray:
    """A random map of which a door is part, on ground that can be driven on."""
    terrain = maps.random_terrain(seed, (60, 80), 0.8)
    terrain[20:40, 30:50], terrain[28:32, 38:42] = ROAD, FRONT_DOOR
    return terrain


IMAGES = [house_with_door(seed) for seed in range(3)]


@pytest.fixture(scope="module")
def network() -> TranslatorCostToGo:
    architecture = TranslatorArchitecture(size=32, base_filters=4)
    weights = init_weights(Generator, architecture, jax.random.key(0))
    return TranslatorCostToGo(weights=weights, architecture=architecture)


def test_exact_values_make_a_perfect_picture():
    for row in full_map_metrics(ExactCostToGo(moves=EIGHT_CONNECTED), IMAGES):
        assert row["l1"] == pytest.approx(0, abs=1e-6)
        assert all(value == 1 for name, value in row.items() if name != "l1")


def test_the_translator_is_judged_by_what_it_draws(network):
    terrain, cost = map_for(network, IMAGES[0])
    assert terrain.shape == (32, 32)
    seen = drawn_masks(1, 64, seed=0)[0]
    metrics, image, predicted, true = compare(network, jnp.asarray(terrain), jnp.asarray(cost), jnp.asarray(seen))
    drawn = with_weights(Generator, network.architecture, network.weights)(image[None])[0]
    np.testing.assert_allclose(predicted, in_eight_bits(drawn), atol=1.01 / 255)  # a rounding error counts one
    assert as_floats(metrics) == pytest.approx(
        as_floats(compare_images(predicted, true).metrics()), abs=1e-5, nan_ok=True
    )


@struct.dataclass
class Known:
    """An estimator that knows the costs of the whole map, whatever is observed of it."""

    cost: Any

    def init(self, world):
        return ()

    def estimate(self, terrain, state):
        return jnp.where(jnp.isfinite(self.cost), self.cost, 1e9)[None]


NAMES = ("l1", "low_precision", "low_recall", "traversable_precision", "traversable_recall")


@pytest.mark.parametrize("seed", range(5))
def test_exact_values_make_a_perfect_picture_of_a_partial_map(seed):
    terrain, cost = map_for(Known(None), IMAGES[0])
    reachable = np.where(TRAVERSABLE[terrain] & ~np.isfinite(cost), GRASS, terrain)
    seen = drawn_masks(8 * seed + 1, 64, seed=0)[-1]
    metrics, *_ = compare(Known(jnp.asarray(cost)), jnp.asarray(reachable), jnp.asarray(cost), jnp.asarray(seen))
    assert as_floats(metrics) == pytest.approx(dict.fromkeys(NAMES, 1.0) | {"l1": 0.0}, abs=1e-6)


def test_metrics_over_pairs_count_the_pixels_of_all(network):
    houses = [House(f"h{number}", "val", image) for number, image in enumerate(IMAGES)]
    data = all_pairs(houses, drawn_masks(2, 32, seed=0))
    drawn, true, generator = [], [], with_weights(Generator, network.architecture, network.weights)
    for index in range(6):
        pair = masked_map(data, jnp.int32(index)).pictures()
        drawn.append(in_eight_bits(generator(pair.image[None])[0]))
        true.append(pair.target)
    # One long picture has the pixels of all.
    together = compare_images(jnp.concatenate(drawn), jnp.concatenate(true)).metrics()
    found = metrics_over_pairs(network, data)
    assert found == pytest.approx(as_floats(together), abs=1e-3, nan_ok=True)


def test_a_house_without_a_value_has_no_part_in_means_and_lines():
    rows = [dict.fromkeys(NAMES, value) for value in (0.2, np.nan, 0.6)]
    points = HouseMetrics.of([0.0, 0.1, 0.4], rows)
    assert points.fits["l1"] == pytest.approx((1.0, 0.2))
    expected = {"mean": 0.4, "lowest": 0.2, "highest": 0.6, "slope": 1.0, "intercept": 0.2}
    assert points.summary("l1") == pytest.approx(expected)
    nothing = HouseMetrics.of([0.0, 0.1, 0.4], [dict.fromkeys(NAMES, np.nan)] * 3)
    assert nothing.fits == {}
    assert np.isnan(list(nothing.summary("l1").values())).all()
