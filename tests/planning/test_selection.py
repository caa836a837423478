"""Selection rules: their definitions solved another way, and what makes the reservation cost the right index."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.planning.selection import ExpectedCost, QuantileCost, ReservationCost


def score(rule, costs, distance):
    """Scores of all cells straight from the outcomes."""
    return rule(rule.summary(jnp.asarray(costs)), jnp.asarray(distance))


def some_costs(seed: int, outcomes: int, cells: int) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).gamma(2.0, 10.0, (outcomes, 1, cells)), axis=0).astype(np.float32)


def solved_by_bisection(outcomes: np.ndarray, price: float) -> float:
    """The r at which E[max(r - C, 0)] is the price."""
    low, high = float(outcomes.min()), float(outcomes.max()) + price + 1
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if np.maximum(middle - outcomes, 0).mean() < price else (low, middle)
    return high


@pytest.mark.parametrize("outcomes", [1, 2, 5, 8])
@pytest.mark.parametrize("weight", [0.3, 1.0])
def test_the_reservation_cost_solves_its_definition(outcomes, weight):
    costs = some_costs(outcomes, outcomes, 40)
    distance = np.random.default_rng(7).integers(1, 60, (1, 40))
    scores = np.asarray(score(ReservationCost(weight), costs, distance))
    wanted = [solved_by_bisection(costs[:, 0, cell], weight * distance[0, cell]) for cell in range(40)]
    np.testing.assert_allclose(scores[0], wanted, rtol=1e-4)


def test_with_one_outcome_both_rules_are_the_same():
    costs, distance = jnp.asarray(some_costs(0, 1, 30)), jnp.arange(30)[None]
    np.testing.assert_allclose(
        score(ReservationCost(0.7), costs, distance), score(ExpectedCost(0.7), costs, distance), rtol=1e-6
    )


def test_weight_zero_is_the_lowest_mean_and_the_best_case():
    costs, nothing = jnp.asarray(some_costs(1, 5, 30)), jnp.int32(0)
    np.testing.assert_allclose(score(ExpectedCost(0.0), costs, nothing), np.mean(costs, axis=0), rtol=1e-6)
    np.testing.assert_allclose(score(ReservationCost(0.0), costs, nothing), np.min(costs, axis=0), rtol=1e-6)


@pytest.mark.parametrize(("level", "index"), [(0.1, 0), (0.5, 2), (0.7, 3), (0.99, 4)])
def test_the_quantile_rule_takes_one_outcome(level, index):
    costs, distance = some_costs(2, 5, 30), np.arange(30)[None]
    scores = score(QuantileCost(level, 0.25), costs, distance)
    np.testing.assert_allclose(scores, costs[index] + 0.25 * distance, rtol=1e-6)


def test_of_two_subgoals_of_one_mean_the_uncertain_one_is_tried_first():
    costs = jnp.array([[[20.0, 5.0]], [[20.0, 35.0]]])
    near = jnp.array([[4, 4]])
    expected, reservation = score(ExpectedCost(1.0), costs, near)[0], score(ReservationCost(1.0), costs, near)[0]
    assert expected[0] == expected[1]
    assert reservation[1] < reservation[0]


def expected_total(order: tuple[int, ...], index: np.ndarray, boxes: np.ndarray, prices: np.ndarray) -> float:
    """Mean cost of opening boxes in an order, stopping when the best found is no dearer than the next box's index."""
    totals = []
    for outcome in itertools.product(range(boxes.shape[1]), repeat=len(boxes)):
        best, paid = np.inf, 0.0
        for box in order:
            if best <= index[box]:
                break
            paid += prices[box]
            best = min(best, boxes[box, outcome[box]])
        totals.append(paid + best)
    return float(np.mean(totals))


def best_possible(boxes: np.ndarray, prices: np.ndarray) -> float:
    """The least mean cost of any way to open boxes one by one and stop, by dynamic programming."""

    def value(best: float, left: frozenset[int]) -> float:
        tries = [prices[box] + np.mean([value(min(best, cost), left - {box}) for cost in boxes[box]]) for box in left]
        return min([best, *tries])

    return value(np.inf, frozenset(range(len(boxes))))


@pytest.mark.parametrize("seed", range(6))
def test_opening_boxes_by_reservation_cost_is_optimal(seed):
    rng = np.random.default_rng(seed)
    boxes, prices = np.sort(rng.gamma(2.0, 10.0, (3, 3)), axis=1), rng.integers(1, 9, 3)
    costs = jnp.asarray(boxes.T[:, None, :], jnp.float32)
    index = np.asarray(score(ReservationCost(1.0), costs, prices[None]))[0]
    order = tuple(np.argsort(index).tolist())
    assert expected_total(order, index, boxes, prices) == pytest.approx(best_possible(boxes, prices), rel=1e-5)
