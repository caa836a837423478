"""Training of the network that predicts cost maps: it learns, and is a function of its configuration alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.rollouts.devices import mesh_of, replicate
from dc2g_jax._src.search_indoors.learning.data import JourneySet
from dc2g_jax._src.search_indoors.learning.networks import CostMapEstimator
from dc2g_jax._src.search_indoors.learning.training import (
    BETTER_RECIPE,
    PAPER_RECIPE,
    figures,
    first_state,
    validation_samples,
)
from dc2g_jax._src.training.step import supervised_step
from tests.support.states import assert_same_bits, infinite
from tests.support.trainings import COST_MAPS as CONFIG, journeys


@pytest.fixture(scope="module")
def data() -> JourneySet:
    return journeys()


def train(data, steps, state=None, devices=None):
    losses, mesh = [], mesh_of(devices)
    state, data = replicate((first_state(CONFIG) if state is None else state, data), mesh)
    for _ in range(steps):
        state, loss = supervised_step(state, data, training=CONFIG, mesh=mesh)
        losses.append(float(loss))
    return state, losses


@pytest.fixture(scope="module")
def trained(data):
    state, losses = train(data, CONFIG.steps)
    return jax.tree.map(np.array, state), losses


def test_the_loss_goes_down(trained):
    losses = trained[1]
    assert np.isfinite(losses).all()
    assert np.mean(losses[-4:]) < 0.8 * np.mean(losses[:4])


def test_an_interrupted_run_ends_like_one_that_was_not(data, trained, tmp_path):
    state, losses = train(data, 9)
    for first in (9, CONFIG.steps):
        checkpoints = TrainingCheckpoints(tmp_path / "run", CONFIG, first_state=first_state)
        checkpoints.save(state)
        state = checkpoints.restore()
        checkpoints.close()
        assert int(state.step) == first
        state, part = train(data, CONFIG.steps - first, state)
        losses += part
    assert losses == trained[1]
    assert_same_bits(state, trained[0])


@pytest.mark.parametrize("count", [1, 2])
def test_a_step_is_compiled_once(data, count):
    train(data, 1, devices=jax.devices()[:count])
    before = supervised_step.compiled_count()
    train(data, 3, devices=jax.devices()[:count])
    assert supervised_step.compiled_count() == before


def test_the_number_of_devices_changes_a_step_by_rounding_only(data):
    """Five steps move half of the weights by 4e-3 or more. Rounding is to change them by 1e-4 at most."""
    one, losses = train(data, 5, devices=jax.devices()[:1])
    two, others = train(data, 5, devices=jax.devices()[:2])
    np.testing.assert_allclose(losses, others, rtol=1e-5)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4), one, two)


def test_figures_of_a_network_do_not_change(data, trained):
    batches = validation_samples(data, CONFIG, 8)
    assert len(batches) == 2
    estimator = CostMapEstimator(weights=trained[0].average, architecture=CONFIG.architecture)
    found = figures(estimator, batches, CONFIG)
    metrics = {f"{metric} {kind}" for metric in ("F1", "IoU") for kind in ("free", "occupied")}
    metrics |= {"MPA", "mF1", "mIoU", "aAP5", "aAP9"}
    assert set(found) == metrics | {"loss", "occupancy", "cost", "direction"}
    assert found == figures(estimator, batches, CONFIG)
    assert 0 < found["mIoU"] < found["mF1"] < 100


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


def test_weights_that_are_not_finite_are_noticed_in_the_step_that_makes_them(data):
    state = first_state(CONFIG)
    _, losses = train(data, 1, state.replace(optimizer=infinite(state.optimizer)))
    assert np.isnan(losses[0])
