"""Training of the network that predicts cost maps: it learns, and is a function of its configuration alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.devices import first_copy
from experiments.objectnav.training import BETTER_RECIPE, PAPER_RECIPE, figures, validation_samples
from tests.support.trainings import CASES, COST_MAPS as CONFIG, journeys, train


@pytest.mark.slow
def test_figures_of_a_network_do_not_change():
    batches = validation_samples(journeys(), CONFIG, 8)
    state, _ = train(CASES["cost_maps"], CONFIG.steps)
    assert len(batches) == 2
    weights = first_copy(state.average)
    found = figures(weights, batches, CONFIG)
    metrics = {f"{metric} {kind}" for metric in ("F1", "IoU") for kind in ("free", "occupied")}
    metrics |= {"MPA", "mF1", "mIoU", "aAP5", "aAP9"}
    assert set(found) == metrics | {"validation_loss", "occupancy", "cost", "direction"}
    assert found == figures(weights, batches, CONFIG)
    assert 0 < found["mIoU"] < found["mF1"] < 100
    own = figures(weights, batches, dataclasses.replace(CONFIG, loss="experiments.studies.indoor_losses:no_direction"))
    np.testing.assert_allclose(own["validation_loss"], found["occupancy"] + 1.5 * found["cost"], atol=2e-4)


@pytest.mark.parametrize("recipe", [PAPER_RECIPE, BETTER_RECIPE], ids=lambda recipe: recipe.optimizer)
def test_the_rate_rises_to_its_peak_and_falls_to_its_end(recipe):
    """The moves of one weight whose gradient is always 1."""
    recipe = dataclasses.replace(recipe, weight_decay=0.0)
    transform = dataclasses.replace(CONFIG, recipe=recipe, steps=400).optimizer()
    weight, gradient = jnp.zeros(()), jnp.ones(())
    moves, state = [], transform.init(weight)
    update = jax.jit(transform.update)
    for _ in range(400):
        change, state = update(gradient, state, weight)
        moves.append(-float(change))
    # Momentum of 0.9 adds up to ten times the gradient.
    scale = 10 if recipe.optimizer == "sgd" else 1
    peak = int(np.argmax(moves))
    assert recipe.warmup * 400 - 1 <= peak <= recipe.warmup * 400 + 20
    assert max(moves) == pytest.approx(scale * recipe.peak, rel=0.02)
    assert moves[-1] == pytest.approx(scale * recipe.last, rel=0.1)


def test_the_papers_recipe():
    assert (PAPER_RECIPE.peak, PAPER_RECIPE.last, PAPER_RECIPE.weight_decay) == (15e-5, 1e-5, 0.01)
    assert PAPER_RECIPE.warmup == 25 / 200
    assert sum(PAPER_RECIPE.symmetries[1:4]) == pytest.approx(0.15)
    assert sum(PAPER_RECIPE.symmetries) == pytest.approx(1)
