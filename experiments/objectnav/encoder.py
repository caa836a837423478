"""Training of the encoder of camera images (section II-B): its answers to three tasks, their losses, and the task."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import nnx, struct
from jaxtyping import Array, Float, Int

from dc2g_jax.estimation import fresh_weights, with_weights, write_network
from dc2g_jax.indoor.learning.midlevel import BLOCK, BLOCKS, ENCODER, EncoderArchitecture, SmallEncoder
from dc2g_jax.indoor.maps.camera import CameraView
from dc2g_jax.indoor.maps.classes import OBJECT_CLASSES
from dc2g_jax.runtime import jit
from dc2g_jax.training import Supervised, Task, TrainingState, state_of

#: Least number of pixels of a class that counts as present in an image, and the depth at which errors are cut, meters.
_PRESENT, _FAR = 12, 10.0

#: Largest number of images for validation.
_VALIDATION_VIEWS = 512


class Answers(struct.PyTreeNode):
    """Answers of the encoder to the three tasks, for blocks of 4 x 4 pixels.

    Attributes:
      classes: log-odds of the class of each block.
      presence: log-odds that the image shows an object of each class.
      depth: depth of each block, tens of meters.
    """

    classes: Float[Array, "b 12 16 17"]
    presence: Float[Array, "b 17"]
    depth: Float[Array, "b 12 16"]


def answers(encoder: SmallEncoder, features: Float[Array, "b f"]) -> Answers:
    """The answers for images with these features."""
    blocks = nnx.relu(encoder.widen(features)).reshape(len(features), *BLOCKS, 8)
    found = encoder.blocks(nnx.relu(encoder.smooth(blocks)))
    return Answers(found[..., 1:], encoder.presence(features), found[..., 0])


def task_losses(answered: Answers, views: CameraView) -> dict[str, Float[Array, ""]]:
    """Mean losses of the three tasks over a batch: cross entropies in nats, error of the depth in tens of meters."""
    classes = views.classes[:, BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]
    depth = views.depth[:, BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]
    present = jnp.sum(jax.nn.one_hot(views.classes, len(OBJECT_CLASSES)), axis=(1, 2)) >= _PRESENT
    error = jnp.abs(answered.depth - jnp.minimum(depth, _FAR) / 10)
    return {
        "segmentation": jnp.mean(optax.softmax_cross_entropy_with_integer_labels(answered.classes, classes)),
        "presence": jnp.mean(optax.sigmoid_binary_cross_entropy(answered.presence, present)),
        "depth": jnp.sum(jnp.where(depth > 0, error, 0)) / jnp.maximum(jnp.sum(depth > 0), 1),
    }


@dataclasses.dataclass(frozen=True)
class EncoderTraining(Supervised):
    """Training of the default encoder on images.

    Attributes:
      architecture: architecture of the encoder.
      steps: number of optimizer steps.
      batch_size: images per step.
      seed: seed of weights and batches.
    """

    architecture: EncoderArchitecture
    steps: int
    batch_size: int = 64
    seed: int = 0

    def first_state(self, hyperparameters: None) -> TrainingState:
        """Random weights, of the seed."""
        weights = fresh_weights(SmallEncoder, self.architecture, jax.random.key(self.seed))
        return state_of(weights, self.optimizer())

    def learning_rate(self, hyperparameters: None = None) -> optax.Schedule:
        """A cosine decay to zero."""
        return optax.cosine_decay_schedule(2e-3, max(self.steps, 1))

    def optimizer(self, hyperparameters: None = None) -> optax.GradientTransformation:
        """Adam."""
        return optax.adam(self.learning_rate())

    def draw(self, data: CameraView, step: Int[Array, ""], hyperparameters: None) -> CameraView:
        """Random images."""
        key = jax.random.fold_in(jax.random.key(self.seed + 1), step)
        chosen = jax.random.randint(key, (self.batch_size,), 0, len(data.image))
        return jax.tree.map(lambda leaf: leaf[chosen], data)

    def losses(self, weights: Any, views: CameraView) -> dict[str, Float[Array, ""]]:
        """See `task_losses`."""
        network = with_weights(SmallEncoder, self.architecture, weights)
        return task_losses(answers(network, network.encode(views.image)), views)

    def gradient(self, state: TrainingState, batch: CameraView, hyperparameters: None) -> tuple[Float[Array, ""], Any]:
        """The sum of the losses, and its gradient."""
        return jax.value_and_grad(lambda weights: sum(self.losses(weights, batch).values(), jnp.float32(0)))(
            state.weights
        )


def encoder_task(training: EncoderTraining, views: CameraView, card: Mapping[str, Any] | None = None) -> Task:
    """The task of training the default encoder. The result is reproducible by seed to the bit.

    Args:
      training: the training.
      views: all images; the first ones are also those of validations.
      card: facts for its card.
    """
    losses = jit(training.losses)
    some = jax.tree.map(lambda leaf: leaf[:_VALIDATION_VIEWS], views)
    return Task(
        training=training,
        data=views,
        runs={"": training},
        steps=training.steps,
        validate=lambda weights, step: {name: float(loss) for name, loss in losses(weights, some).items()},
        save=lambda folder, weights, facts: write_network(
            folder, weights, training.architecture, ENCODER, {**(card or {}), **facts}
        ),
        name="encoder",
    )
