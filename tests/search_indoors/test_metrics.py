"""Scores of predicted cost maps, against loops over cells in plain NumPy."""

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.search_indoors.learning.metrics import (
    FIVE_ACTIONS,
    NINE_ACTIONS,
    OF_CLASSES,
    action_accuracy,
    best_actions,
    confusion,
    occupancy_scores,
)


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
