"""Any estimator can be judged by pictures, and exact values make perfect ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.datasets.drawn_masks import drawn_masks
from dc2g_jax.datasets.houses import House
from dc2g_jax.datasets.image_pairs import all_pairs, make_image_pair
from dc2g_jax.estimation import translator
from dc2g_jax.estimation.estimators import ExactCostToGo, TranslatorCostToGo
from dc2g_jax.estimation.images import in_eight_bits
from dc2g_jax.estimation.metrics import image_metrics
from dc2g_jax.estimation.translator import TranslatorArchitecture
from dc2g_jax.grid.search import EIGHT_CONNECTED
from dc2g_jax.image_evaluation import as_floats, compare, full_map_metrics, map_for, mean_metrics
from tests import maps

IMAGES = [maps.random_terrain(seed, (60, 80), 0.8) for seed in range(3)]


@pytest.fixture(scope="module")
def network() -> TranslatorCostToGo:
    architecture = TranslatorArchitecture(size=32, base_filters=4)
    weights = translator.init_weights(translator.Generator, architecture, jax.random.key(0))
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
    drawn = translator.translate(network.architecture, network.weights, image[None])[0]
    np.testing.assert_allclose(predicted, in_eight_bits(drawn), atol=1.01 / 255)  # a rounding error counts one
    assert as_floats(metrics) == pytest.approx(as_floats(image_metrics(predicted, true)), abs=1e-5)


def test_the_mean_over_pairs(network):
    houses = [House(f"h{number}", "val", image) for number, image in enumerate(IMAGES)]
    data = all_pairs(houses, drawn_masks(2, 32, seed=0))
    rows = []
    for index in range(6):
        pair = make_image_pair(data, jnp.int32(index))
        drawn = translator.translate(network.architecture, network.weights, pair.image[None])[0]
        rows.append(as_floats(image_metrics(in_eight_bits(drawn), pair.target)))
    mean = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
    assert mean_metrics(network, data) == pytest.approx(mean, abs=1e-3)
