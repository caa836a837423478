"""Training of the image-to-image translator: losses, state and step (sections III-B and IV-A)."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int, UInt32

from dc2g_jax._src.estimation.weights import with_weights
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number
from dc2g_jax._src.training.step import Supervised, TrainingState, state_of
from experiments.translator.network import Discriminator, Generator, TranslatorArchitecture, init_weights
from experiments.translator.pairs import ImagePair

#: pix2pix computes the absolute error of images from -1 to 1; here they are from 0 to 1.
_L1_SCALE = 2.0

#: The paper's three losses, by name: weights of the mean absolute error and of the adversarial loss, as in pix2pix.
TRANSLATOR_LOSSES = {"l1": (100.0, 0.0), "gan": (0.0, 1.0), "l1+gan": (100.0, 1.0)}


@dataclasses.dataclass(frozen=True)
class TranslatorConfig:
    """Training configuration of a translator. Defaults are as in the paper.

    Attributes:
      architecture: architecture of the networks.
      loss: one of `TRANSLATOR_LOSSES`.
      batch_size: pairs per step.
      learning_rate: learning rate of Adam, for both networks.
      beta1: beta1 of Adam.
      seed: seed of weights, order of the pairs and dropout.

    Raises:
      InputError: the loss is unknown, a number is invalid, or batches of one image were to be normalized by the batch.
    """

    architecture: TranslatorArchitecture = dataclasses.field(default_factory=TranslatorArchitecture)
    loss: str = "l1+gan"
    batch_size: int = 1
    learning_rate: float = 2e-4
    beta1: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        check_name("loss", self.loss, TRANSLATOR_LOSSES)
        check_number("learning rate", float(np.float32(self.learning_rate)), above=0)
        check_number("batch size", self.batch_size, whole=True, least=1)
        if self.architecture.normalization == "batch" and self.batch_size == 1:
            raise InputError("batch size 1: batch normalization needs more images (--batch-size 4)")

    @property
    def hyperparameters(self) -> UInt32[Array, ""]:
        """The seed: runs that only differ in it can be trained together."""
        return jnp.uint32(self.seed)


#: `(key of the run, step, data) -> batch`
DrawImages = Callable[[Array, Array, Any], ImagePair]


def _keys(seed: UInt32[Array, ""]) -> Array:
    """Keys of the generator's and the discriminator's weights, and of the pairs and dropout."""
    return jax.random.split(jax.random.key(seed), 3)


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
    l1, gan = TRANSLATOR_LOSSES[config.loss]
    difference = jnp.mean(jnp.abs(generated - batch.target))
    total = l1 * _L1_SCALE * difference
    if gan:
        odds = with_weights(Discriminator, config.architecture, discriminator)(batch.image, generated)
        total += gan * jnp.mean(jax.nn.softplus(-odds))
    return total, difference


@dataclasses.dataclass(frozen=True)
class TranslatorTraining(Supervised):
    """Training of both networks of a translator: in a step first the discriminator, then the generator.

    The hyperparameter of a run is its seed.

    Attributes:
      config: training configuration, whose seed does not matter.
      draw_batch: draws pairs.
    """

    config: TranslatorConfig
    draw_batch: DrawImages

    @property
    def batch_size(self) -> int:
        """That of the configuration."""
        return self.config.batch_size

    def first_state(self, hyperparameters: UInt32[Array, ""]) -> TrainingState:
        """The state before the first step; its weights are those of `generator` and `discriminator`."""
        generator_key, discriminator_key, _ = _keys(hyperparameters)
        weights = {
            "generator": init_weights(Generator, self.config.architecture, generator_key),
            "discriminator": init_weights(Discriminator, self.config.architecture, discriminator_key),
        }
        return state_of(weights, self.optimizer(hyperparameters))

    def learning_rate(self, hyperparameters: UInt32[Array, "*runs"]) -> optax.Schedule:
        """A constant."""
        return optax.constant_schedule(self.config.learning_rate)

    def optimizer(self, hyperparameters: UInt32[Array, ""]) -> optax.GradientTransformation:
        """Adam, for both networks. A discriminator that the loss does not use has no gradient and keeps its weights."""
        return optax.adam(self.config.learning_rate, b1=self.config.beta1)

    def draw(self, data: Any, step: Int[Array, ""], hyperparameters: UInt32[Array, ""]) -> ImagePair:
        """The pairs of a step, which only depend on the seed and the step."""
        batch_key, _ = jax.random.split(_keys(hyperparameters)[2])
        return self.draw_batch(batch_key, step, data)

    def gradient(
        self, state: TrainingState, batch: ImagePair, hyperparameters: UInt32[Array, ""]
    ) -> tuple[Float[Array, ""], Any]:
        """The mean absolute error of the generated images, and the gradients of the losses of both networks."""
        config, architecture = self.config, self.config.architecture
        generator, discriminator = state.weights["generator"], state.weights["discriminator"]
        _, dropout_key = jax.random.split(_keys(hyperparameters)[2])
        dropout_key = jax.random.fold_in(dropout_key, state.step)
        generated, backward = jax.vjp(
            lambda weights: with_weights(Generator, architecture, weights)(batch.image, dropout_key), generator
        )
        of_discriminator = jax.tree.map(jnp.zeros_like, discriminator)
        if TRANSLATOR_LOSSES[config.loss][1]:
            of_discriminator = jax.grad(lambda weights: discriminator_loss(architecture, weights, batch, generated))(
                discriminator
            )
            # The generator is judged by the discriminator of after the step.
            gradient = {"generator": jax.tree.map(jnp.zeros_like, generator), "discriminator": of_discriminator}
            updates, _ = self.optimizer(hyperparameters).update(gradient, state.optimizer, state.weights)
            discriminator = optax.apply_updates(discriminator, updates["discriminator"])
        loss_of = functools.partial(generator_loss, config, discriminator, batch)
        by_picture, difference = jax.grad(loss_of, has_aux=True)(generated)
        (of_generator,) = backward(by_picture)
        return difference, {"generator": of_generator, "discriminator": of_discriminator}
