"""Labels that say where the goal is, and the distance that a planner makes of a predicted place."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.training.pairs import Pair
from experiments.studies.goal_location import ExpectedDistance, place_loss, straight_to, to_distance, to_place

SHAPE = (7, 9)


def one_pair():
    rng = np.random.default_rng(0)
    cost = rng.integers(1, 20, SHAPE).astype(np.float32)
    cost[2, 3] = cost[2, 4] = 0
    costs, seen = np.stack([cost, cost + 1]), rng.random((2, *SHAPE)) < 0.5
    return Pair(terrain=jnp.asarray(seen, jnp.uint8), target=jnp.asarray(costs), weight=jnp.asarray(seen, jnp.float32))


def test_distances_are_those_of_scipy_and_there_is_none_without_a_goal():
    pair = one_pair()
    goals = np.asarray(pair.target[0]) == 0
    expected = distance_transform_edt(~goals)
    np.testing.assert_allclose(straight_to(jnp.asarray(goals)), expected, rtol=1e-6)
    labeled = to_distance(pair)
    np.testing.assert_allclose(labeled.target[0], expected, rtol=1e-6)
    np.testing.assert_array_equal(labeled.weight[0], pair.weight[0])
    placed = to_place(pair)
    np.testing.assert_array_equal(placed.target[0], goals)
    assert np.all(placed.weight[0] == 1)
    assert not np.any(labeled.weight[1])
    assert not np.any(placed.weight[1])


def test_the_loss_of_a_place_is_the_logarithm_of_its_chance():
    logits = np.random.default_rng(1).normal(0, 1, (*SHAPE, 1)).astype(np.float32)
    goals = np.zeros((*SHAPE, 1), np.float32)
    goals[2, 3] = goals[4, 4] = 1
    chances = np.exp(logits) / np.exp(logits).sum()
    found = place_loss(jnp.asarray(logits), jnp.asarray(goals), jnp.asarray([0.5]))
    np.testing.assert_allclose(found, np.full(found.shape, -np.log(chances[goals > 0].sum())), rtol=1e-5)
    slopes = jax.grad(lambda at: place_loss(at, jnp.asarray(goals), jnp.asarray([0.5])).mean())(jnp.asarray(logits))
    assert np.all((np.asarray(slopes) < 0) == (goals > 0))


def test_the_expected_distance_is_the_mean_over_the_places(monkeypatch):
    network = NetworkCostToGo({}, Architecture(quantiles=(0.5,)))
    chance = np.random.default_rng(2).dirichlet(np.ones(SHAPE[0] * SHAPE[1])).reshape(SHAPE)
    logits = jnp.asarray(32 * np.log(chance), jnp.float32)[..., None]
    monkeypatch.setattr(NetworkCostToGo, "estimate", lambda self, terrain, state: logits[None])
    found = ExpectedDistance(network).estimate(jnp.zeros((*SHAPE, 1), jnp.uint8), ())
    places = np.argwhere(np.ones(SHAPE))
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    np.testing.assert_allclose(found[0, ..., 0], (apart @ chance.ravel()).reshape(SHAPE), rtol=1e-4)
