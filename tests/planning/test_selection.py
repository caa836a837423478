"""Selection rules: their definitions computed another way."""

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.planning.selection import ExpectedCost, QuantileCost


def score(rule, costs, distance):
    """Scores of all cells straight from the outcomes."""
    return rule(rule.summary(jnp.asarray(costs)), jnp.asarray(distance))


def some_costs(seed: int, outcomes: int, cells: int) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).gamma(2.0, 10.0, (outcomes, 1, cells)), axis=0).astype(np.float32)


@pytest.mark.parametrize("weight", [0.0, 0.7])
def test_the_expected_cost_is_the_mean_plus_weighted_distance(weight):
    costs, distance = some_costs(1, 5, 30), np.arange(30)[None]
    scores = score(ExpectedCost(weight), costs, distance)
    np.testing.assert_allclose(scores, np.mean(costs, axis=0) + weight * distance, rtol=1e-6)


@pytest.mark.parametrize(("level", "index"), [(0.1, 0), (0.5, 2), (0.7, 3), (0.99, 4)])
def test_the_quantile_rule_takes_one_outcome(level, index):
    costs, distance = some_costs(2, 5, 30), np.arange(30)[None]
    scores = score(QuantileCost(level, 0.25), costs, distance)
    np.testing.assert_allclose(scores, costs[index] + 0.25 * distance, rtol=1e-6)
