"""Every supervised training is a function of its configuration alone, whatever interrupts it, and it learns."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.runtime import devices
from dc2g_jax._src.runtime.devices import mesh_for_batch
from dc2g_jax._src.training.step import draw_batches, learn, placed, supervised_step
from tests.support.compiling import compiled_count
from tests.support.states import assert_same_bits, infinite
from tests.support.trainings import CASES, Case, train


@pytest.fixture(scope="module", params=["cost_to_go", "translator", pytest.param("cost_maps", marks=pytest.mark.slow)])
def case(request) -> Case:
    return CASES[request.param]


@pytest.fixture(scope="module")
def trained(case):
    """A run without interruption."""
    state, losses = train(case, case.steps)
    return jax.tree.map(np.array, state), losses


def test_the_same_configuration_gives_the_same_bits(case, trained):
    again, losses = train(case, case.steps)
    assert losses == trained[1]
    assert_same_bits(again, trained[0])


def test_the_loss_goes_down(case, trained):
    losses = trained[1]
    assert np.isfinite(losses).all()
    assert np.mean(losses[-4:]) < case.left * np.mean(losses[:4])


def test_an_interrupted_run_ends_like_one_that_was_not(case, trained, tmp_path):
    losses = []
    for steps in (7, 9, case.steps - 16):
        # A new process each time.
        checkpoints = TrainingCheckpoints(
            tmp_path / "run", case.config, first_state=lambda _: case.training.first_state(case.hyperparameters)
        )
        state = checkpoints.restore()
        assert int(state.step) == len(losses)
        state, part = train(case, steps, state)
        losses += part
        checkpoints.save(state)
        assert_same_bits(checkpoints.restore(), state)
        checkpoints.close()
    assert losses == trained[1]
    assert_same_bits(state, trained[0])


@pytest.mark.parametrize("count", [1, 2])
def test_a_step_is_compiled_once(case, count):
    own = jax.devices()[:count]
    train(case, 1, devices=own)
    before = [compiled_count(program) for program in (draw_batches, learn)]
    train(case, 3, devices=own)
    train(case, 1, devices=own, hyperparameters=case.others)
    assert [compiled_count(program) for program in (draw_batches, learn)] == before


def with_effect(weights: Any) -> Any:
    """Weights without the biases that the next normalization takes out: rounding alone moves those."""
    if not isinstance(weights, dict):
        return weights
    kept = {name: with_effect(part) for name, part in weights.items()}
    return kept | {"convolution": {"kernel": kept["convolution"]["kernel"]}} if "norm" in kept else kept


def test_the_number_of_devices_changes_a_step_by_rounding_only(case):
    """Five steps move half of the weights by 4e-3 or more. Rounding is to change them by 1e-4 at most."""
    one, losses = train(case, 5, devices=jax.devices()[:1])
    two, others = train(case, 5, devices=jax.devices()[:2])
    np.testing.assert_allclose(losses, others, rtol=1e-5)
    pair = (with_effect(state.weights) for state in (one, two))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4), *pair)


def test_weights_that_are_not_finite_are_noticed_in_the_step_that_makes_them(case):
    state = case.training.first_state(case.hyperparameters)
    _, losses = train(case, 1, state.replace(optimizer=infinite(state.optimizer)))
    assert np.isnan(losses[0])


@pytest.mark.slow
def test_runs_of_the_translator_together_are_like_alone(monkeypatch):
    monkeypatch.setattr(devices, "platform", lambda mesh: "gpu")
    case, keys = CASES["translator"], [jnp.uint32(seed) for seed in range(2)]
    mesh = mesh_for_batch(case.config.batch_size, 2)
    first = [case.training.first_state(jnp.uint32(seed)) for seed in range(2)]
    states = placed(jax.tree.map(lambda *leaves: jnp.stack(leaves), *first), mesh)
    together = []
    for _ in range(3):
        states, loss = supervised_step(states, case.data(), jnp.stack(keys), training=case.training, mesh=mesh)
        together.append(np.asarray(loss))
    for run in range(2):
        _, alone = train(case, 3, first[run], hyperparameters=keys[run])
        np.testing.assert_allclose(np.array(together)[:, run], alone, rtol=1e-4)
