"""The losses of equations (1) to (4), against loops over cells in plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.learning.networks import Prediction
from experiments.objectnav.losses import (
    FIVE_ACTIONS,
    NINE_ACTIONS,
    OF_CLASSES,
    action_accuracy,
    best_actions,
    confusion,
    cost_loss,
    direction_loss,
    gradient,
    occupancy_loss,
    occupancy_scores,
    total_loss,
)

SHAPE = (7, 9)


def slope(costs, navigable, row, column, step):
    """Rise of the cost by the cell in one direction, from navigable neighbors."""
    rises = []
    for sign in (1, -1):
        other = row + sign * step[0], column + sign * step[1]
        inside = 0 <= other[0] < SHAPE[0] and 0 <= other[1] < SHAPE[1]
        if inside and navigable[other]:
            rises.append(sign * (float(costs[other]) - float(costs[row, column])))
    return sum(rises) / len(rises) if rises else 0.0


def by_hand(logits, cost, occupied, true):
    """The three losses."""
    total = np.zeros(3)
    navigable = ~occupied & np.isfinite(true)
    for row in range(SHAPE[0]):
        for column in range(SHAPE[1]):
            cell = row, column
            probability = 1 / (1 + np.exp(-float(logits[cell])))
            total[0] -= np.log(probability if occupied[cell] else 1 - probability)
            if not navigable[cell]:
                continue
            total[1] += abs(float(true[cell]) - float(cost[cell]))
            ours, theirs = (
                np.array([slope(costs, navigable, row, column, step) for step in ((1, 0), (0, 1))])
                for costs in (cost, true)
            )
            if np.linalg.norm(theirs) > 0:
                total[2] += 1 - ours @ theirs / np.sqrt((ours @ ours + 1e-8) * (theirs @ theirs))
    return total / (SHAPE[0] * SHAPE[1])


@pytest.fixture(scope="module")
def losses():
    return jax.jit(total_loss)


@pytest.mark.parametrize("seed", range(4))
def test_losses_are_those_of_the_equations(losses, seed):
    rng = np.random.default_rng(seed)
    logits, cost = rng.normal(0, 2, (2, *SHAPE)).astype(np.float32)
    occupied, cut_off = rng.random((2, *SHAPE)) < np.array([0.4, 0.1])[:, None, None]
    true = np.where(occupied | cut_off, np.inf, rng.uniform(0, 3, SHAPE)).astype(np.float32)
    expected = by_hand(logits, cost, occupied, true)
    total, parts = losses(Prediction(jnp.asarray(logits), jnp.asarray(cost)), occupied, true)
    np.testing.assert_allclose([parts[name] for name in ("occupancy", "cost", "direction")], expected, rtol=1e-5)
    np.testing.assert_allclose(total, expected @ (1.0, 1.5, 1.0), rtol=1e-5)


def test_the_truth_costs_nothing(losses):
    rows, columns = np.indices(SHAPE)
    true = np.hypot(rows, columns).astype(np.float32)
    occupied = np.zeros(SHAPE, bool)
    total, _ = losses(Prediction(jnp.full(SHAPE, -30.0), jnp.asarray(true)), occupied, true)
    assert float(total) < 1e-6
    # The direction is that of the slope, whatever its length and the cost's level.
    assert float(direction_loss(jnp.asarray(5 * true + 2), jnp.asarray(true), jnp.asarray(~occupied))) < 1e-6
    assert float(direction_loss(jnp.asarray(-true), jnp.asarray(true), jnp.asarray(~occupied))) == pytest.approx(2)
    assert float(cost_loss(jnp.asarray(true + 0.5), jnp.asarray(true), jnp.asarray(~occupied))) == pytest.approx(0.5)


def test_a_gradient_does_not_look_through_walls():
    costs = jnp.asarray([[0.0, 5.0, 9.0, 9.5]])
    navigable = jnp.asarray([[True, False, True, True]])
    assert gradient(costs, navigable).tolist() == [[[0, 0, 0, 0]], [[0, 0, 0.5, 0.5]]]


def test_losses_and_their_slopes_are_finite_where_nothing_is_navigable():
    nothing = jnp.ones(SHAPE, bool)

    def loss(cost):
        prediction = Prediction(jnp.full(SHAPE, 80.0), cost)
        return total_loss(prediction, nothing, jnp.full(SHAPE, jnp.inf))[0]

    value, slopes = jax.jit(jax.value_and_grad(loss))(jnp.zeros(SHAPE))
    assert float(value) == 0
    assert not np.asarray(slopes).any()
    # A level prediction has a slope of its own to learn from.
    true = jnp.asarray(np.indices(SHAPE)[0], jnp.float32)
    slopes = jax.jit(jax.grad(lambda cost: direction_loss(cost, true, nothing)))(jnp.zeros(SHAPE))
    assert np.isfinite(slopes).all()


def test_occupancy_is_sure_without_overflow():
    logits = jnp.asarray([[200.0, -200.0]])
    assert float(occupancy_loss(logits, jnp.asarray([[True, False]]))) == 0
    assert float(occupancy_loss(logits, jnp.asarray([[False, True]]))) == 200


def test_scores_of_the_occupancy():
    rng = np.random.default_rng(0)
    true, predicted = rng.random((2, 12, 9)) < np.array([0.3, 0.45])[:, None, None]
    counts = confusion(jnp.asarray(predicted), jnp.asarray(true))
    accuracy, f1, iou = [], [], []
    for kind in (False, True):
        right = np.sum((true == kind) & (predicted == kind))
        recall, precision = right / np.sum(true == kind), right / np.sum(predicted == kind)
        accuracy.append(recall)
        f1.append(2 * recall * precision / (recall + precision))
        iou.append(right / np.sum((true == kind) | (predicted == kind)))
    assert int(counts[0, 1]) == np.sum(~true & predicted)
    expected = dict(zip(("MPA", "mF1", "mIoU"), np.mean([accuracy, f1, iou], axis=1), strict=True))
    expected |= {"F1 free": f1[0], "F1 occupied": f1[1], "IoU free": iou[0], "IoU occupied": iou[1]}
    assert occupancy_scores(counts) == pytest.approx(expected, rel=1e-6)


def test_a_class_that_is_nowhere_counts_as_found():
    free = jnp.zeros((3, 3), bool)
    means = ("MPA", "mF1", "mIoU")
    assert occupancy_scores(confusion(free, free)) == dict.fromkeys((*means, *OF_CLASSES), 1)
    assert occupancy_scores(confusion(~free, free)) == {**dict.fromkeys((*means, *OF_CLASSES), 0), "MPA": 0.5}


def best_by_hand(costs, row, column, diagonal):
    """The offset of the lowest cost nearby: staying first, then to the right and on to the left around."""
    order = [(0, 0), (0, 1), (-1, 0), (0, -1), (1, 0)]
    order += [(-1, 1), (-1, -1), (1, -1), (1, 1)] if diagonal else []
    found = []
    for down, right in order:
        other = row + down, column + right
        inside = 0 <= other[0] < costs.shape[0] and 0 <= other[1] < costs.shape[1]
        found.append(costs[other] if inside else np.inf)
    return order[int(np.argmin(found))]


@pytest.mark.parametrize("actions", [FIVE_ACTIONS, NINE_ACTIONS], ids=len)
def test_accuracy_of_actions(actions):
    rng = np.random.default_rng(1)
    true = np.where(rng.random((6, 8)) < 0.3, np.inf, rng.uniform(0, 1, (6, 8))).astype(np.float32)
    predicted = (np.where(np.isinf(true), 0.5, true) + rng.normal(0, 0.2, true.shape)).astype(np.float32)
    navigable = np.argwhere(np.isfinite(true))
    same = [
        best_by_hand(true, *cell, len(actions) == 9) == best_by_hand(predicted, *cell, len(actions) == 9)
        for cell in navigable.tolist()
    ]
    assert 0.1 < np.mean(same) < 0.9
    found = action_accuracy(jnp.asarray(predicted), jnp.asarray(true), actions)
    assert float(found) == pytest.approx(np.mean(same))
    assert float(action_accuracy(jnp.asarray(true), jnp.asarray(true), actions)) == 1


def test_equal_costs_mean_staying():
    assert not np.asarray(best_actions(jnp.ones((3, 3)), NINE_ACTIONS)).any()


def test_a_map_without_a_path_is_correct():
    nowhere = jnp.full((3, 3), jnp.inf)
    assert float(action_accuracy(jnp.zeros((3, 3)), nowhere, FIVE_ACTIONS)) == 1
