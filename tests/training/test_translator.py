"""Training the translator is a function of its configuration alone, whatever interrupts it, and it learns."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.checkpoints import TrainingCheckpoints
from dc2g_jax._src.estimation.pix2pix import Discriminator
from dc2g_jax._src.estimation.weights import with_weights
from dc2g_jax._src.rollouts.devices import mesh_of, replicate
from dc2g_jax._src.training.image_pairs import ImageSet
from dc2g_jax._src.training.step import supervised_step
from dc2g_jax._src.training.translator import (
    TRANSLATOR_LOSSES,
    TranslatorConfig,
    TranslatorTraining,
    discriminator_loss,
    first_state,
    generator_loss,
    run_key,
)
from tests.support.states import assert_same_bits, infinite
from tests.support.trainings import DRAW_IMAGES as DRAW, TRANSLATOR as CONFIG, image_set

STEPS = 30


@pytest.fixture(scope="module")
def data() -> ImageSet:
    return image_set()


def train(data, steps: int, state=None, config: TranslatorConfig = CONFIG, devices=None, seed=0):
    mesh, differences = mesh_of(devices), []
    state = first_state(config, seed=0) if state is None else state
    state, pairs = replicate((state, (run_key(seed), data)), mesh)
    for _ in range(steps):
        state, difference = supervised_step(state, pairs, training=TranslatorTraining(config, DRAW), mesh=mesh)
        differences.append(float(difference))
    return state, differences


@pytest.fixture(scope="module")
def trained(data):
    """A run without interruption."""
    state, differences = train(data, STEPS)
    return jax.tree.map(np.array, state), differences


def test_an_interrupted_run_ends_like_one_that_was_not(data, trained, tmp_path):
    state, differences = None, []
    for steps in (7, STEPS - 7):
        # A new process each time.
        checkpoints = TrainingCheckpoints(tmp_path / "run", CONFIG, first_state=functools.partial(first_state, seed=0))
        state = checkpoints.restore()
        assert (state is None) == (not differences)
        state, part = train(data, steps, state)
        differences += part
        checkpoints.save(state)
        checkpoints.close()
    assert differences == trained[1]
    assert_same_bits(state, trained[0])


def test_it_learns(trained):
    differences = trained[1]
    assert np.isfinite(differences).all()
    assert np.mean(differences[-5:]) < 0.8 * np.mean(differences[:5])


def first_layers(state) -> tuple[np.ndarray, np.ndarray]:
    layers = state.weights["generator"]["down0"], state.weights["discriminator"]["layer0"]
    return tuple(np.array(layer["convolution"]["kernel"]) for layer in layers)


def test_the_discriminator_learns_only_where_it_is_asked(data, trained):
    start = first_layers(first_state(CONFIG, seed=0))
    both = first_layers(trained[0])
    assert not np.array_equal(both[0], start[0])
    assert not np.array_equal(both[1], start[1])
    alone = first_layers(train(data, 1, config=dataclasses.replace(CONFIG, loss="l1"))[0])
    assert not np.array_equal(alone[0], start[0])
    assert np.array_equal(alone[1], start[1])


def test_the_discriminator_loss_is_the_cross_entropy(data):
    batch = DRAW(jax.random.key(0), jnp.int32(0), data)
    generated = 1 - batch.target
    weights = first_state(CONFIG, seed=0).weights["discriminator"]
    judge = jax.jit(with_weights(Discriminator, CONFIG.architecture, weights))
    believed, doubted = (
        1 / (1 + np.exp(-np.asarray(judge(batch.image, answer)))) for answer in (batch.target, generated)
    )
    loss = jax.jit(functools.partial(discriminator_loss, CONFIG.architecture))(weights, batch, generated)
    assert float(loss) == pytest.approx(np.mean(-np.log(believed)) + np.mean(-np.log(1 - doubted)), rel=1e-5)


@pytest.mark.parametrize(("loss", "by_difference", "by_doubt"), [("l1", 100, 0), ("gan", 0, 1), ("l1+gan", 100, 1)])
def test_the_generator_loss_is_that_of_pix2pix(data, loss, by_difference, by_doubt):
    batch = DRAW(jax.random.key(0), jnp.int32(0), data)
    generated, weights = 0.7 * batch.target, first_state(CONFIG, seed=0).weights["discriminator"]
    odds = jax.jit(with_weights(Discriminator, CONFIG.architecture, weights))(batch.image, generated)
    doubt = np.mean(-np.log(1 / (1 + np.exp(-np.asarray(odds, np.float64)))))
    # pix2pix takes pictures from -1 to 1.
    difference = np.mean(np.abs((2 * np.asarray(generated) - 1) - (2 * np.asarray(batch.target) - 1)))
    config = dataclasses.replace(CONFIG, loss=loss)
    total, half = jax.jit(functools.partial(generator_loss, config))(weights, batch, generated)
    assert float(total) == pytest.approx(by_difference * difference + by_doubt * doubt, rel=1e-5)
    assert float(half) == pytest.approx(difference / 2, rel=1e-5)


def test_another_seed_gives_other_weights():
    one, other = (first_state(CONFIG, seed=seed).weights["generator"] for seed in (0, 1))
    assert not np.array_equal(one["down0"]["convolution"]["kernel"], other["down0"]["convolution"]["kernel"])


def test_an_unknown_loss_is_refused_with_those_there_are():
    with pytest.raises(InputError) as caught:
        TranslatorConfig(loss="l2")
    message = str(caught.value)
    assert "\n" not in message
    for name in ("l2", *TRANSLATOR_LOSSES):
        assert repr(name) in message or name in message


@pytest.mark.parametrize("network", ["generator", "discriminator"])
def test_weights_that_are_not_finite_are_noticed_in_the_step_that_makes_them(data, network):
    state = first_state(CONFIG, seed=0)
    adam, *rest = state.optimizer
    broken = adam._replace(mu=adam.mu | {network: infinite(adam.mu[network])})
    _, differences = train(data, 1, state.replace(optimizer=(broken, *rest)))
    assert np.isnan(differences[0])


def with_effect(weights) -> dict:
    """Weights of a network without the biases that the next normalization takes out: rounding alone moves those."""
    layers = {name: dict(layer) for name, layer in weights.items()}
    for layer in layers.values():
        if "norm" in layer:
            layer["convolution"] = {"kernel": layer["convolution"]["kernel"]}
    return layers


def test_the_number_of_devices_changes_a_step_by_rounding_only(data):
    """Five steps move half of the weights by 4e-3 or more. Rounding is to change them by 1e-4 at most."""
    one, differences = train(data, 5, devices=jax.devices()[:1])
    two, others = train(data, 5, devices=jax.devices()[:2])
    np.testing.assert_allclose(differences, others, rtol=1e-5)
    for network in ("generator", "discriminator"):
        pair = (with_effect(state.weights[network]) for state in (one, two))
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4), *pair)


@pytest.mark.parametrize("count", [1, 2])
def test_a_step_is_compiled_once(data, count):
    devices = jax.devices()[:count]
    state, _ = train(data, 1, devices=devices)
    before = supervised_step.compiled_count()
    train(data, 1, first_state(CONFIG, seed=1), devices=devices, seed=1)
    state, _ = train(data, 2, state, devices=devices)
    train(dataclasses.replace(data, masks=data.masks ^ jnp.uint32(1)), 1, state, devices=devices)
    assert supervised_step.compiled_count() == before
