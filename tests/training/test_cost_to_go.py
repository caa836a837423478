"""Training is a function of its configuration alone, whatever interrupts it, and it learns."""

import contextlib
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.datasets.pairs import TrainingSet
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.rollouts.devices import mesh_of
from dc2g_jax._src.training import cost_to_go
from dc2g_jax._src.training.cost_to_go import TrainingConfig, first_state, train_step
from dc2g_jax._src.training.translator import TranslatorConfig
from tests.support.states import assert_same_bits, infinite
from tests.support.trainings import COST_TO_GO as CONFIG, DRAW_PAIRS as DRAW, training_set


@pytest.fixture(scope="module")
def data() -> TrainingSet:
    return training_set()


def train(data, steps: int, state=None, config: TrainingConfig = CONFIG, devices=None):
    """Train on from a state (the first by default); the state is used up."""
    state = first_state(config) if state is None else state
    losses, mesh = [], mesh_of(devices)
    for _ in range(steps):
        state, loss = train_step(state, config.hyperparameters, data, recipe=config.recipe, draw_batch=DRAW, mesh=mesh)
        losses.append(float(loss))
    return state, losses


@pytest.fixture(scope="module")
def trained(data):
    """A run without interruption."""
    state, losses = train(data, CONFIG.steps)
    return jax.tree.map(np.array, state), losses


def test_the_same_configuration_gives_the_same_bits(data, trained):
    again, losses = train(data, CONFIG.steps)
    assert losses == trained[1]
    assert_same_bits(again, trained[0])


def test_another_seed_gives_other_weights(data):
    other = first_state(dataclasses.replace(CONFIG, seed=1))
    assert not np.array_equal(other.weights["embed"]["kernel"], first_state(CONFIG).weights["embed"]["kernel"])


def test_an_interrupted_run_ends_like_one_that_was_not(data, trained, tmp_path):
    state, losses = None, []
    for steps in (7, 20, CONFIG.steps - 27):
        # A new process each time.
        checkpoints = TrainingCheckpoints(tmp_path / "run", CONFIG, first_state=first_state)
        state = checkpoints.restore()
        assert (state is None) == (not losses)
        assert state is None or int(state.step) == len(losses)
        state, part = train(data, steps, state)
        losses += part
        checkpoints.save(state)
        checkpoints.close()
    assert losses == trained[1]
    assert_same_bits(state, trained[0])


def test_what_is_restored_is_what_was_saved(data, tmp_path):
    state, _ = train(data, 3)
    checkpoints = TrainingCheckpoints(tmp_path / "run", CONFIG, first_state=first_state)
    checkpoints.save(state)
    assert_same_bits(checkpoints.restore(), state)
    checkpoints.close()


@pytest.mark.parametrize(
    ("change", "mention"),
    [({"seed": 1}, "seed"), ({"learning_rate": 1e-4}, "learning_rate"), ({"architecture": Architecture()}, "widths")],
)
def test_a_folder_with_another_configuration_is_refused(tmp_path, change, mention):
    folder = tmp_path / "run"
    TrainingCheckpoints(folder, CONFIG, first_state=first_state).close()
    with pytest.raises(InputError) as caught:
        TrainingCheckpoints(folder, dataclasses.replace(CONFIG, **change), first_state=first_state)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    assert mention in message
    TrainingCheckpoints(folder, CONFIG, first_state=first_state).close()  # and is as it was


def test_a_folder_with_other_facts_is_refused(tmp_path):
    folder = tmp_path / "run"
    TrainingCheckpoints(folder, CONFIG, {"dataset": "houses", "extra": 3}, first_state=first_state).close()
    TrainingCheckpoints(folder, CONFIG, {"dataset": "houses", "extra": 3}, first_state=first_state).close()
    with pytest.raises(InputError, match=r"extra was 3 .*now 4"):
        TrainingCheckpoints(folder, CONFIG, {"dataset": "houses", "extra": 4}, first_state=first_state)


def test_a_damaged_configuration_is_refused(tmp_path):
    folder = tmp_path / "run"
    TrainingCheckpoints(folder, CONFIG, first_state=first_state).close()
    for content in ("{", "[1, 2]"):
        (folder / "config.json").write_text(content)
        with pytest.raises(InputError, match=r"config\.json"):
            TrainingCheckpoints(folder, CONFIG, first_state=first_state)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Orbax's, closed after a failure
def test_a_state_that_cannot_be_read_is_refused(trained, tmp_path):
    with contextlib.closing(TrainingCheckpoints(tmp_path, CONFIG, first_state=first_state)) as checkpoints:
        checkpoints.save(trained[0])
    for manifest in (tmp_path / "states").rglob("manifest.ocdbt"):
        manifest.write_bytes(b"damaged")
    with contextlib.closing(TrainingCheckpoints(tmp_path, CONFIG, first_state=first_state)) as checkpoints:
        with pytest.raises(InputError, match=rf"states/{CONFIG.steps}: cannot be restored"):
            checkpoints.restore()
        checkpoints.delete()
        assert checkpoints.restore() is None


@pytest.mark.parametrize(
    ("name", "value"),
    [("steps", 0), ("batch_size", 0), ("learning_rate", float("nan")), ("learning_rate", 0.0), ("seed", -1)],
)
def test_numbers_that_no_training_can_have_are_refused(name, value):
    with pytest.raises(InputError, match=f"{name.replace('_', ' ')} {value}"):
        dataclasses.replace(CONFIG, **{name: value})
    if name in ("batch_size", "learning_rate"):
        with pytest.raises(InputError, match=f"{name.replace('_', ' ')} {value}"):
            TranslatorConfig(**{name: value})


def test_the_loss_goes_down(trained):
    losses = trained[1]
    assert np.isfinite(losses).all()
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


def test_the_average_follows_the_weights(data, trained):
    assert int(trained[0].step) == CONFIG.steps
    state = first_state(CONFIG)
    wanted = jax.tree.leaves(jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), state.weights))
    for step in range(12):
        state, _ = train(data, 1, state)
        decay = min(CONFIG.average_decay, (1 + step) / (10 + step))
        wanted = [
            decay * average + (1 - decay) * np.asarray(weights)
            for average, weights in zip(wanted, jax.tree.leaves(state.weights), strict=True)
        ]
    for average, expected in zip(jax.tree.leaves(state.average), wanted, strict=True):
        np.testing.assert_allclose(average, expected, rtol=1e-4, atol=1e-6)


def test_weights_that_are_not_finite_are_noticed_in_the_step_that_makes_them(data):
    state = first_state(CONFIG)
    _, losses = train(data, 1, state.replace(optimizer=infinite(state.optimizer)))
    assert np.isnan(losses[0])


def test_all_at_once_is_like_by_parts(data, monkeypatch):
    by_parts, losses = train(data, 5)
    monkeypatch.setattr(cost_to_go, "platform", lambda mesh: "gpu")
    at_once, others = train(data, 5)
    np.testing.assert_allclose(losses, others, rtol=1e-4)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-5), by_parts, at_once)


def test_the_number_of_devices_changes_a_step_by_rounding_only(data):
    one, losses = train(data, 5, devices=jax.devices()[:1])
    two, others = train(data, 5, devices=jax.devices()[:2])
    np.testing.assert_allclose(losses, others, rtol=1e-6)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6), one, two)


def test_a_step_on_several_cores_is_over_when_it_returns(data):
    # Cores that exchange data wait for each other forever if too many programs are started behind.
    state = first_state(CONFIG)
    for _ in range(3):
        state, loss = train_step(state, CONFIG.hyperparameters, data, recipe=CONFIG.recipe, draw_batch=DRAW)
        assert all(leaf.is_ready() for leaf in jax.tree.leaves((state, loss)))


@pytest.mark.parametrize("count", [1, 2])
def test_a_step_is_compiled_once(data, count):
    programs, devices = [cost_to_go._draw, cost_to_go._gradient, cost_to_go._update], jax.devices()[:count]
    train(data, 1, devices=devices)
    before = [program.compiled_count() for program in programs]
    train(data, 3, devices=devices)
    other = dataclasses.replace(data, masks=~data.masks & jnp.asarray(bitboard.full(16, 16)))
    train(other, 1, devices=devices)
    changed = dataclasses.replace(CONFIG, seed=5, learning_rate=1e-4, losses=(("quantile", 0.5),))
    train(data, 1, config=changed, devices=devices)
    assert [program.compiled_count() for program in programs] == before
