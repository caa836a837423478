"""Training of the image-to-image translator: losses, state and step (sections III-B and IV-A)."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, UInt32

from dc2g_jax.errors import InputError
from dc2g_jax.estimation.pix2pix import Discriminator, Generator, TranslatorArchitecture, init_weights
from dc2g_jax.estimation.weights import with_weights
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.devices import divide
from dc2g_jax.training.cost_to_go import check_numbers, loss_or_nan
from dc2g_jax.training.image_pairs import ImagePair


class GeneratorLoss(NamedTuple):
    """Weights of the generator's loss.

    Attributes:
      l1: weight of the mean absolute error.
      gan: weight of the adversarial loss.
    """

    l1: float
    gan: float


#: pix2pix computes the absolute error of images from -1 to 1; here they are from 0 to 1.
_L1_SCALE = 2.0

#: The paper's three losses, by name; weights as in pix2pix.
TRANSLATOR_LOSSES = {
    "l1": GeneratorLoss(100.0, 0.0),
    "gan": GeneratorLoss(0.0, 1.0),
    "l1+gan": GeneratorLoss(100.0, 1.0),
}


@dataclasses.dataclass(frozen=True)
class TranslatorConfig:
    """Training configuration of a translator. Defaults are as in the paper.

    Attributes:
      architecture: architecture of the networks.
      loss: one of `TRANSLATOR_LOSSES`.
      batch_size: pairs per step.
      learning_rate: learning rate of Adam, for both networks.
      beta1: beta1 of Adam.

    Raises:
      InputError: the loss is unknown, or a number is invalid.
    """

    architecture: TranslatorArchitecture = dataclasses.field(default_factory=TranslatorArchitecture)
    loss: str = "l1+gan"
    batch_size: int = 1
    learning_rate: float = 2e-4
    beta1: float = 0.5

    def __post_init__(self) -> None:
        if self.loss not in TRANSLATOR_LOSSES:
            raise InputError(f"loss: no loss is called {self.loss!r}; use one of: {', '.join(TRANSLATOR_LOSSES)}")
        check_numbers(self.learning_rate, batch_size=self.batch_size)


@struct.dataclass
class TranslatorState:
    """The training state, saved and restored as a whole.

    Attributes:
      step: number of optimizer steps.
      key: key of the run, as data, for the order of the pairs and dropout. It is part of the state so that runs with
        different seeds share a compiled step.
      generator: weights of the generator.
      discriminator: weights of the discriminator; constant if the loss does not use them.
      generator_optimizer: optax state.
      discriminator_optimizer: optax state.
    """

    step: Int[Array, ""]
    key: UInt32[Array, "2"]
    generator: Any
    discriminator: Any
    generator_optimizer: Any
    discriminator_optimizer: Any


#: `(key of the run, step, data) -> batch`
DrawImages = Callable[[Array, Array, Any], ImagePair]


def _optimizer(config: TranslatorConfig) -> optax.GradientTransformation:
    return optax.adam(config.learning_rate, b1=config.beta1)


def init_translator(config: TranslatorConfig, *, seed: int) -> TranslatorState:
    """The state before the first step.

    Args:
      config: training configuration.
      seed: seed of weights, order of the pairs and dropout.
    """
    generator_key, discriminator_key, run_key = jax.random.split(jax.random.key(seed), 3)
    generator = init_weights(Generator, config.architecture, generator_key)
    discriminator = init_weights(Discriminator, config.architecture, discriminator_key)
    return TranslatorState(
        step=jnp.int32(0),
        key=jax.random.key_data(run_key),
        generator=generator,
        discriminator=discriminator,
        generator_optimizer=_optimizer(config).init(generator),
        discriminator_optimizer=_optimizer(config).init(discriminator),
    )


def discriminator_loss(
    architecture: TranslatorArchitecture, weights: Any, batch: ImagePair, generated: Float[Array, "b s s 3"]
) -> Float[Array, ""]:
    """Cross-entropy of classifying patches as true or generated: the sum of the means of both classes."""
    discriminate = with_weights(Discriminator, architecture, weights)
    true, false = (discriminate(batch.image, answers) for answers in (batch.target, generated))
    return jnp.mean(jax.nn.softplus(-true)) + jnp.mean(jax.nn.softplus(false))


def generator_loss(
    config: TranslatorConfig, discriminator: Any, batch: ImagePair, generated: Float[Array, "b s s 3"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The generator's loss, and the mean absolute error.

    The loss is the sum, weighted as in `TRANSLATOR_LOSSES`, of the mean absolute error of images from -1 to 1 and the
    cross-entropy of patches being classified as true.
    """
    loss = TRANSLATOR_LOSSES[config.loss]
    difference = jnp.mean(jnp.abs(generated - batch.target))
    total = loss.l1 * _L1_SCALE * difference
    if loss.gan:
        odds = with_weights(Discriminator, config.architecture, discriminator)(batch.image, generated)
        total += loss.gan * jnp.mean(jax.nn.softplus(-odds))
    return total, difference


def _updated(config: TranslatorConfig, weights: Any, gradient: Any, optimizer: Any) -> tuple[Any, Any]:
    updates, optimizer = _optimizer(config).update(gradient, optimizer, weights)
    return optax.apply_updates(weights, updates), optimizer


@functools.partial(jit, static_argnames=("config", "draw_batch", "mesh"), donate_argnames=("state",))
def translator_step(
    state: TranslatorState, data: Any, *, config: TranslatorConfig, draw_batch: DrawImages, mesh: Mesh
) -> tuple[TranslatorState, Float[Array, ""]]:
    """Take one step: update the discriminator, then the generator.

    The batch and the dropout of a step only depend on the run's key and the step number, so resumed training gives the
    same weights as uninterrupted training.

    Returns:
      The new state, and the mean absolute error of the generated images; NaN if a weight of either network is not
      finite.
    """
    architecture = config.architecture
    batch_key, dropout_key = jax.random.split(jax.random.wrap_key_data(state.key))
    batch = divide(draw_batch(batch_key, state.step, data), mesh)
    dropout_key = jax.random.fold_in(dropout_key, state.step)
    generated, backward = jax.vjp(
        lambda weights: with_weights(Generator, architecture, weights)(batch.image, dropout_key), state.generator
    )
    discriminator, discriminator_optimizer = state.discriminator, state.discriminator_optimizer
    if TRANSLATOR_LOSSES[config.loss].gan:
        gradient = jax.grad(lambda weights: discriminator_loss(architecture, weights, batch, generated))(discriminator)
        discriminator, discriminator_optimizer = _updated(config, discriminator, gradient, discriminator_optimizer)
    loss_of = functools.partial(generator_loss, config, discriminator, batch)
    by_picture, difference = jax.grad(loss_of, has_aux=True)(generated)
    (gradient,) = backward(by_picture)
    generator, generator_optimizer = _updated(config, state.generator, gradient, state.generator_optimizer)
    new = dataclasses.replace(
        state,
        step=state.step + 1,
        generator=generator,
        discriminator=discriminator,
        generator_optimizer=generator_optimizer,
        discriminator_optimizer=discriminator_optimizer,
    )
    return new, loss_or_nan(difference, (generator, discriminator))
