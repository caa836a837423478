"""Training of a cost-to-go network: configuration, state and step."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jaxtyping import Array, Float, Int, UInt32

from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.runtime.errors import check_number, check_seed
from dc2g_jax._src.runtime.programs import apart, jit
from dc2g_jax._src.training.losses import LOSSES, Loss, map_loss, named_loss
from dc2g_jax._src.training.pairs import Pair
from dc2g_jax._src.training.step import Supervised, TrainingState, state_of

#: Validation pairs that a network is given at a time.
_PAIRS_AT_A_TIME = 64

#: Maximum number of equal parts of a batch, which devices can share.
_MOST_PARTS = 8


def least_memory(config: "TrainingConfig", height: int, width: int) -> float:
    """Bytes that a step surely needs for maps of this size: the pairs, and the features of the first layer."""
    architecture = config.architecture
    features = (architecture.embedding or architecture.widths[0]) / architecture.patch**2
    return config.batch_size * height * width * (9.0 + 4 * features)


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """Training configuration.

    Attributes:
      architecture: architecture of the network.
      steps: total number of optimizer steps, over which the learning rate decays to zero.
      batch_size: pairs per step; a multiple of 8 keeps up to eight devices busy.
      losses: names of losses, see `training.losses.named_loss`, with their weights.
      learning_rate: peak learning rate, after a short linear warm-up.
      weight_decay: decoupled weight decay.
      average_decay: decay of the running average of the weights, which is the final network.
      seed: seed of weights and batches.

    Raises:
      InputError: a number is invalid.
    """

    architecture: Architecture = dataclasses.field(default_factory=Architecture)
    steps: int = 48000
    batch_size: int = 64
    losses: tuple[tuple[str, float], ...] = (("quantile", 1.0),)
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
    average_decay: float = 0.998
    seed: int = 0

    def __post_init__(self) -> None:
        check_number("learning rate", float(np.float32(self.learning_rate)), above=0)
        check_number("steps", self.steps, whole=True, least=1)
        check_number("batch size", self.batch_size, whole=True, least=1)
        check_seed(self.seed)

    @property
    def parts(self) -> int:
        """Number of equal parts of a batch, which devices can share: 1 if the batch size is odd."""
        return math.gcd(self.batch_size, _MOST_PARTS)

    @property
    def recipe(self) -> "TrainingConfig":
        """The static part of the configuration: the same for all runs that only differ in `hyperparameters`."""
        names = tuple((name, 1.0) for name, _ in self.losses)
        return dataclasses.replace(self, losses=names, learning_rate=1.0, seed=0)

    @property
    def hyperparameters(self) -> "Hyperparameters":
        """The traced part of the configuration."""
        return Hyperparameters(
            seed=jnp.uint32(self.seed),
            learning_rate=jnp.float32(self.learning_rate),
            loss_weights=jnp.asarray([weight for _, weight in self.losses], jnp.float32),
        )


@struct.dataclass
class Hyperparameters:
    """Parameters in which runs with the same recipe differ.

    Attributes:
      seed: seed of weights and batches.
      learning_rate: peak learning rate.
      loss_weights: weight of each of the recipe's losses.
    """

    seed: UInt32[Array, "*runs"]
    learning_rate: Float[Array, "*runs"]
    loss_weights: Float[Array, "*runs losses"]


def mean_loss(
    recipe: TrainingConfig,
    loss_weights: Float[Array, "losses"],
    estimate: Float[Array, "b h w quantiles"],
    batch: Pair,
    own_losses: Mapping[str, Loss] = MappingProxyType({}),
) -> Float[Array, ""]:
    """Mean over a batch of the weighted sum of each map's losses, in units of the architecture's cost scale.

    Args:
      recipe: names of the losses, and the architecture.
      loss_weights: weights of the losses.
      estimate: the network's quantiles of the cost-to-go, in cells.
      batch: the pairs.
      own_losses: losses by names that only this program knows.
    """
    scale = recipe.architecture.cost_scale
    levels = jnp.asarray(recipe.architecture.quantiles, jnp.float32)
    estimate, target = estimate / scale, batch.target / scale

    def mean(name: str, weight: Float[Array, ""]) -> Float[Array, ""]:
        of_map = functools.partial(map_loss, own_losses.get(name) or named_loss(name), levels=levels)
        # A loss of weight 0 must not overflow.
        judged = jnp.where(weight > 0, estimate, 0.0)
        return weight * jnp.mean(jax.vmap(of_map)(judged, target, batch.weight))

    return jnp.sum(jnp.stack([mean(name, loss_weights[number]) for number, (name, _) in enumerate(recipe.losses)]))


@dataclasses.dataclass(frozen=True)
class CostToGoTraining(Supervised):
    """Training of a cost-to-go network.

    Attributes:
      recipe: static part of the configuration, the same for all runs.
      draw_batch: draws pairs: `(key, data, batch_size=...) ->` pairs.
      own_losses: names and functions of losses, for those that only this program knows.
    """

    recipe: TrainingConfig
    draw_batch: Callable[..., Pair]
    own_losses: tuple[tuple[str, Loss], ...] = ()

    @property
    def batch_size(self) -> int:
        """That of the recipe."""
        return self.recipe.batch_size

    @property
    def average_decay(self) -> float:
        """That of the recipe."""
        return self.recipe.average_decay

    def first_state(self, hyperparameters: Hyperparameters) -> TrainingState:
        """Random weights, of the seed."""
        weights = compact_unet.init_weights(self.recipe.architecture, jax.random.key(hyperparameters.seed))
        return state_of(weights, self.optimizer(hyperparameters), self.average_decay)

    def learning_rate(self, hyperparameters: Hyperparameters) -> optax.Schedule:
        """A linear warm-up, then a cosine decay to zero."""
        steps = self.recipe.steps
        schedule = optax.warmup_cosine_decay_schedule(0.0, 1.0, min(200, steps // 10), steps)
        return lambda step: hyperparameters.learning_rate * schedule(step)

    def optimizer(self, hyperparameters: Hyperparameters) -> optax.GradientTransformation:
        """AdamW with clipped gradients."""
        adamw = optax.adamw(self.learning_rate(hyperparameters), weight_decay=self.recipe.weight_decay)
        return optax.chain(optax.clip_by_global_norm(1.0), adamw)

    def draw(self, data: Any, step: Int[Array, ""], hyperparameters: Hyperparameters) -> Pair:
        """The pairs of a step, which only depend on the seed, the step and the number of parts."""
        of_step = jax.random.fold_in(jax.random.fold_in(jax.random.key(hyperparameters.seed), 1), step)
        keys = jax.vmap(functools.partial(jax.random.fold_in, of_step))(jnp.arange(self.recipe.parts))
        draw = functools.partial(self.draw_batch, batch_size=self.recipe.batch_size // self.recipe.parts)
        parts = jax.vmap(draw, in_axes=(0, None))(keys, data)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), parts)

    def gradient(
        self, state: TrainingState, batch: Pair, hyperparameters: Hyperparameters
    ) -> tuple[Float[Array, ""], Any]:
        """The mean loss of a batch, and its gradient."""
        of_weights = functools.partial(compact_unet.apply, self.recipe.architecture, terrain=batch.terrain)
        estimate, of_estimate = jax.vjp(of_weights, state.weights)

        def loss_of(estimate: Array, batch: Pair, loss_weights: Array) -> Float[Array, ""]:
            return mean_loss(self.recipe, loss_weights, estimate, batch, dict(self.own_losses))

        # A program of its own: within the network's, XLA would compute the gradient for each use, in a slow order.
        loss, gradient = apart(jax.value_and_grad(loss_of), estimate, batch, hyperparameters.loss_weights)
        return loss, of_estimate(gradient)[0]


@functools.partial(jit, static_argnames="architecture")
def validation_error(architecture: Architecture, weights: Any, pairs: Pair) -> Float[Array, ""]:
    """Mean absolute error of the mean outcome on pairs, whose number is a multiple of 64, in cells.

    It is the weighted mean of each map, averaged over maps.
    """

    def of_chunk(chunk: Pair) -> Float[Array, ""]:
        estimate = jnp.mean(compact_unet.apply(architecture, weights, chunk.terrain), axis=-1, keepdims=True)
        of_map = functools.partial(map_loss, LOSSES["l1"], levels=jnp.array([0.5]))
        return jnp.mean(jax.vmap(of_map)(estimate, chunk.target, chunk.weight))

    chunks = jax.tree.map(lambda leaf: leaf.reshape(-1, _PAIRS_AT_A_TIME, *leaf.shape[1:]), pairs)
    return jnp.mean(jax.lax.map(of_chunk, chunks))
