"""Training the translator is a function of its configuration alone, whatever interrupts it, and it learns."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.weights import with_weights
from dc2g_jax._src.runtime.errors import InputError
from experiments.translator.network import Discriminator
from experiments.translator.pairs import ImageSet
from experiments.translator.training import (
    TRANSLATOR_LOSSES,
    TranslatorConfig,
    TranslatorTraining,
    discriminator_loss,
    generator_loss,
)
from tests.support.states import infinite
from tests.support.trainings import CASES, DRAW_IMAGES as DRAW, TRANSLATOR as CONFIG, image_set, train


@pytest.fixture(scope="module")
def data() -> ImageSet:
    return image_set()


def first_state(seed: int):
    return TranslatorTraining(CONFIG, DRAW).first_state(jnp.uint32(seed))


def first_layers(state) -> tuple[np.ndarray, np.ndarray]:
    layers = state.weights["generator"]["down0"], state.weights["discriminator"]["layer0"]
    return tuple(np.array(layer["convolution"]["kernel"]) for layer in layers)


def test_the_discriminator_learns_only_where_it_is_asked():
    case, l1 = CASES["translator"], dataclasses.replace(CONFIG, loss="l1")
    start = first_layers(first_state(0))
    both = first_layers(train(case, 1)[0])
    assert not np.array_equal(both[0], start[0])
    assert not np.array_equal(both[1], start[1])
    alone = first_layers(train(case._replace(training=TranslatorTraining(l1, DRAW)), 1)[0])
    assert not np.array_equal(alone[0], start[0])
    assert np.array_equal(alone[1], start[1])


def test_the_discriminator_loss_is_the_cross_entropy(data):
    batch = DRAW(jax.random.key(0), jnp.int32(0), data)
    generated = 1 - batch.target
    weights = first_state(0).weights["discriminator"]
    judge = jax.jit(with_weights(Discriminator, CONFIG.architecture, weights))
    believed, doubted = (
        1 / (1 + np.exp(-np.asarray(judge(batch.image, answer)))) for answer in (batch.target, generated)
    )
    loss = jax.jit(functools.partial(discriminator_loss, CONFIG.architecture))(weights, batch, generated)
    assert float(loss) == pytest.approx(np.mean(-np.log(believed)) + np.mean(-np.log(1 - doubted)), rel=1e-5)


@pytest.mark.parametrize(("loss", "by_difference", "by_doubt"), [("l1", 100, 0), ("gan", 0, 1), ("l1+gan", 100, 1)])
def test_the_generator_loss_is_that_of_pix2pix(data, loss, by_difference, by_doubt):
    batch = DRAW(jax.random.key(0), jnp.int32(0), data)
    generated, weights = 0.7 * batch.target, first_state(0).weights["discriminator"]
    odds = jax.jit(with_weights(Discriminator, CONFIG.architecture, weights))(batch.image, generated)
    doubt = np.mean(-np.log(1 / (1 + np.exp(-np.asarray(odds, np.float64)))))
    # pix2pix takes pictures from -1 to 1.
    difference = np.mean(np.abs((2 * np.asarray(generated) - 1) - (2 * np.asarray(batch.target) - 1)))
    config = dataclasses.replace(CONFIG, loss=loss)
    total, half = jax.jit(functools.partial(generator_loss, config))(weights, batch, generated)
    assert float(total) == pytest.approx(by_difference * difference + by_doubt * doubt, rel=1e-5)
    assert float(half) == pytest.approx(difference / 2, rel=1e-5)


def test_another_seed_gives_other_weights():
    one, other = (first_state(seed).weights["generator"] for seed in (0, 1))
    assert not np.array_equal(one["down0"]["convolution"]["kernel"], other["down0"]["convolution"]["kernel"])


def test_an_unknown_loss_is_refused_with_those_there_are():
    with pytest.raises(InputError) as caught:
        TranslatorConfig(loss="l2")
    message = str(caught.value)
    assert "\n" not in message
    for name in ("l2", *TRANSLATOR_LOSSES):
        assert repr(name) in message or name in message


@pytest.mark.parametrize("network", ["generator", "discriminator"])
def test_weights_that_are_not_finite_are_noticed_in_the_step_that_makes_them(network):
    state = first_state(0)
    adam, *rest = state.optimizer
    broken = adam._replace(mu=adam.mu | {network: infinite(adam.mu[network])})
    _, differences = train(CASES["translator"], 1, state.replace(optimizer=(broken, *rest)))
    assert np.isnan(differences[0])
