"""Training a cost-to-go network: state, one step, many steps in one program."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.estimation import networks
from dc2g_jax.estimation.losses import weighted_l1
from dc2g_jax.estimation.networks import Architecture


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """How to train.

    Attributes:
      architecture: the network.
      steps: optimiser steps in all; the learning rate falls to zero over them.
      batch_size: pairs a step.
      learning_rate: peak, after a short linear warm-up.
      weight_decay: decoupled weight decay.
      average_decay: decay of the running average of the weights, which is what is kept in the end.
      seed: of weights and batches.
    """

    architecture: Architecture = dataclasses.field(default_factory=Architecture)
    steps: int = 9000
    batch_size: int = 64
    learning_rate: float = 1.5e-3
    weight_decay: float = 1e-3
    average_decay: float = 0.998
    seed: int = 0


@struct.dataclass
class TrainingState:
    """Everything that training needs to go on; saved and restored as a whole.

    Attributes:
      step: optimiser steps taken.
      weights: the network's weights.
      average: running average of the weights.
      optimizer: optax state.
    """

    step: Int[Array, ""]
    weights: Any
    average: Any
    optimizer: Any


class Batch(Protocol):
    """Training pairs, see `dc2g_jax.datasets.pairs.Pair`."""

    @property
    def terrain(self) -> UInt8[Array, "b h w"]:
        """Observed class indices."""
        ...

    @property
    def target(self) -> Float[Array, "b h w"]:
        """Exact cost-to-go, in cells."""
        ...

    @property
    def weight(self) -> Float[Array, "b h w"]:
        """Weight of each cell in the loss."""
        ...


#: `(key, data) -> batch`
DrawBatch = Callable[[Array, Any], Batch]


def optimizer(config: TrainingConfig) -> optax.GradientTransformation:
    """AdamW with clipped gradients, a linear warm-up and a cosine decay to zero."""
    warmup = min(200, config.steps // 10)
    schedule = optax.warmup_cosine_decay_schedule(0.0, config.learning_rate, warmup, config.steps)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=config.weight_decay))


def init_state(config: TrainingConfig) -> TrainingState:
    """The state before the first step."""
    weights = networks.init_weights(config.architecture, jax.random.key(config.seed))
    return TrainingState(
        step=jnp.int32(0),
        weights=weights,
        average=jax.tree.map(jnp.array, weights),
        optimizer=optimizer(config).init(weights),
    )


def mean_loss(architecture: Architecture, weights: Any, batch: Batch) -> Float[Array, ""]:
    """Mean over a batch of each map's weighted L1 error, in units of the architecture's cost scale."""
    estimate = networks.apply(architecture, weights, batch.terrain)
    return jnp.mean(jax.vmap(weighted_l1)(estimate, batch.target, batch.weight)) / architecture.cost_scale


@functools.partial(jax.jit, static_argnames=("config", "draw_batch"), donate_argnames=("state",))
def train_step(
    state: TrainingState, data: Any, *, config: TrainingConfig, draw_batch: DrawBatch
) -> tuple[TrainingState, Float[Array, ""]]:
    """Take one optimiser step.

    The batch of a step depends on the seed and the number of the step alone, so training that was interrupted and
    resumed gives the same weights as training that was not. One step is one program: inside a `scan`, XLA's CPU
    backend runs the gradients of convolutions some twenty times slower.

    Returns:
      The new state and the loss, in cells.
    """
    transform = optimizer(config)
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(config.seed), 1), state.step)
    batch = draw_batch(key, data)
    loss, gradient = jax.value_and_grad(lambda weights: mean_loss(config.architecture, weights, batch))(state.weights)
    updates, optimizer_state = transform.update(gradient, state.optimizer, state.weights)
    weights = optax.apply_updates(state.weights, updates)
    # Early on the average is of the steps so far, later exponential.
    decay = jnp.minimum(config.average_decay, (1.0 + state.step) / (10.0 + state.step))
    average = jax.tree.map(lambda a, w: decay * a + (1 - decay) * w, state.average, weights)
    new = TrainingState(step=state.step + 1, weights=weights, average=average, optimizer=optimizer_state)
    return new, loss * config.architecture.cost_scale
