"""The losses that are compared with the paper's, and the figures of smoothness, against loops in plain NumPy."""

import json
import shutil

import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.learning.networks import Prediction
from experiments.objectnav.losses import named_loss
from experiments.studies.indoor_losses import BLOCKED, Options, bends, hollows, main
from tests.support.refusals import refusal

SHAPE = (8, 9)


def maps(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random(SHAPE) < 0.2
    cost = np.where(occupied | (rng.random(SHAPE) < 0.1), np.inf, rng.uniform(0, 2, SHAPE)).astype(np.float32)
    return (
        Prediction(*jnp.asarray(rng.normal(0, 1, (2, *SHAPE)), jnp.float32)),
        jnp.asarray(occupied),
        jnp.asarray(cost),
    )


@pytest.mark.parametrize(("name", "weights"), [("no_direction", (1, 1.5, 0)), ("cost_alone", (0, 1.5, 1))])
def test_a_loss_is_the_papers_without_a_part(name, weights):
    sample = maps(0)
    _, parts = named_loss("paper")(*sample)
    expected = sum(
        weight * parts[part] for weight, part in zip(weights, ("occupancy", "cost", "direction"), strict=True)
    )
    np.testing.assert_allclose(named_loss(f"experiments.studies.indoor_losses:{name}")(*sample)[0], expected, rtol=1e-6)


def test_one_map_is_judged_in_walls_too():
    prediction, occupied, cost = maps(1)
    _, parts = named_loss("experiments.studies.indoor_losses:one_map")(prediction, occupied, cost)
    label = np.where(occupied, BLOCKED, np.asarray(cost))
    error = np.abs(np.asarray(prediction.cost + prediction.occupancy_logits) - label)
    np.testing.assert_allclose(parts["cost"], error[np.isfinite(label)].sum() / error.size, rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_bends_and_hollows_by_hand(seed):
    prediction, occupied, cost = maps(seed)
    navigable, values = np.asarray(~occupied & jnp.isfinite(cost)), np.asarray(prediction.cost)
    total, count, low = 0.0, 0, np.zeros(SHAPE, bool)
    for row, column in np.argwhere(navigable):
        for step in ((0, 1), (1, 0)):
            ends = [(row + sign * step[0], column + sign * step[1]) for sign in (-1, 1)]
            if all(0 <= r < SHAPE[0] and 0 <= c < SHAPE[1] and navigable[r, c] for r, c in ends):
                total += abs(sum(float(values[end]) for end in ends) - 2 * float(values[row, column]))
                count += 1
        near = [
            values[r, c]
            for r in range(max(row - 1, 0), min(row + 2, SHAPE[0]))
            for c in range(max(column - 1, 0), min(column + 2, SHAPE[1]))
            if navigable[r, c] and (r, c) != (row, column)
        ]
        low[row, column] = bool(near) and values[row, column] < min(near)
    found, number = bends(prediction.cost, jnp.asarray(navigable))
    np.testing.assert_allclose(found, total, rtol=1e-5)
    assert int(number) == count
    np.testing.assert_array_equal(hollows(prediction.cost, jnp.asarray(navigable)), low)


def test_networks_of_other_data_and_without_the_papers_loss_are_refused(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "validation.safetensors").write_bytes(name.encode())
        (tmp_path / name / "network.json").write_text(json.dumps({"loss": "experiments.studies.indoor_losses:one_map"}))
    both = tuple(tmp_path / name for name in ("a", "b"))
    refusal(lambda: main(Options(networks=both, out=tmp_path / "out")), "validation.safetensors", "same data")
    shutil.copyfile(both[0] / "validation.safetensors", both[1] / "validation.safetensors")
    refusal(lambda: main(Options(networks=both, out=tmp_path / "out")), "paper's loss")
    refusal(lambda: main(Options(networks=both, out=tmp_path / "out", maps=20)), "--maps 20", "multiple of 16")
