"""Training a cost-to-go network: its numbers, its state, one step."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jaxtyping import Array, Float, Int, UInt8, UInt32

from dc2g_jax.errors import InputError
from dc2g_jax.estimation.networks import compact_unet
from dc2g_jax.estimation.networks.compact_unet import Architecture
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.devices import ONE_CORE, on_cores
from dc2g_jax.training.losses import LOSSES, map_loss

#: Equal parts that a batch is made of, at most. Each core of a CPU takes one at a time, and works within its caches.
_MOST_PARTS = 8


def check_numbers(learning_rate: float, **counts: int) -> None:
    """Refuse numbers that no training can have.

    Raises:
      InputError: names the number.
    """
    for name, count in counts.items():
        if count < 1:
            raise InputError(f"{name.replace('_', ' ')} {count}: give at least 1")
    if not 0 < np.float32(learning_rate) < np.inf:
        raise InputError(f"learning rate {learning_rate}: give a number above 0 that single precision holds")


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """How to train.

    Attributes:
      architecture: the network.
      steps: optimizer steps in all; the learning rate falls to zero over them.
      batch_size: pairs a step; a multiple of 8 keeps up to eight cores of a CPU busy.
      losses: names of losses, see `dc2g_jax.training.losses.LOSSES`, and the weight of each.
      learning_rate: peak, after a short linear warm-up.
      weight_decay: decoupled weight decay.
      average_decay: decay of the running average of the weights, which is what is kept in the end.
      seed: of weights and batches.

    Raises:
      InputError: for numbers that no training can have.
    """

    architecture: Architecture = dataclasses.field(default_factory=Architecture)
    steps: int = 12000
    batch_size: int = 64
    losses: tuple[tuple[str, float], ...] = (("quantile", 1.0),)
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
    average_decay: float = 0.998
    seed: int = 0

    def __post_init__(self) -> None:
        check_numbers(self.learning_rate, steps=self.steps, batch_size=self.batch_size)
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed {self.seed}: give a whole number from 0 to {2**32 - 1}")

    @property
    def parts(self) -> int:
        """Equal parts that a batch is drawn in, and how many cores of a CPU a step can use: one where it is odd."""
        return math.gcd(self.batch_size, _MOST_PARTS)

    @property
    def recipe(self) -> "TrainingConfig":
        """What is compiled into a training step: the same for all runs that differ in numbers only."""
        names = tuple((name, 1.0) for name, _ in self.losses)
        return dataclasses.replace(self, losses=names, learning_rate=1.0, seed=0)

    @property
    def hyperparameters(self) -> "Hyperparameters":
        """The numbers that a training step is given."""
        return Hyperparameters(
            seed=jnp.uint32(self.seed),
            learning_rate=jnp.float32(self.learning_rate),
            loss_weights=jnp.asarray([weight for _, weight in self.losses], jnp.float32),
        )


@struct.dataclass
class Hyperparameters:
    """Numbers in which runs of one recipe differ.

    Attributes:
      seed: of weights and batches.
      learning_rate: peak learning rate.
      loss_weights: weight of each of the recipe's losses.
    """

    seed: UInt32[Array, "*runs"]
    learning_rate: Float[Array, "*runs"]
    loss_weights: Float[Array, "*runs losses"]


@struct.dataclass
class TrainingState:
    """Everything that training needs to go on; saved and restored as a whole.

    Attributes:
      step: optimizer steps taken.
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


class DrawBatch(Protocol):
    """How pairs are drawn."""

    def __call__(self, key: Array, data: Any, *, batch_size: int) -> Batch:
        """So many pairs out of the data."""
        ...


def learning_rate_schedule(recipe: TrainingConfig) -> optax.Schedule:
    """`step ->` learning rate: a linear warm-up, then a cosine decay to zero, for a peak of 1."""
    warmup = min(200, recipe.steps // 10)
    return optax.warmup_cosine_decay_schedule(0.0, 1.0, warmup, recipe.steps)


def optimizer(recipe: TrainingConfig) -> optax.GradientTransformation:
    """AdamW with clipped gradients, for a peak learning rate of 1."""
    adamw = optax.adamw(learning_rate_schedule(recipe), weight_decay=recipe.weight_decay)
    return optax.chain(optax.clip_by_global_norm(1.0), adamw)


def init_state(recipe: TrainingConfig, hyperparameters: Hyperparameters) -> TrainingState:
    """The state before the first step."""
    weights = compact_unet.init_weights(recipe.architecture, jax.random.key(hyperparameters.seed))
    return TrainingState(
        step=jnp.int32(0),
        weights=weights,
        average=jax.tree.map(jnp.array, weights),
        optimizer=optimizer(recipe).init(weights),
    )


def first_state(config: TrainingConfig) -> TrainingState:
    """The state of a run before its first step."""
    return init_state(config.recipe, config.hyperparameters)


def mean_loss(
    recipe: TrainingConfig, loss_weights: Float[Array, "losses"], weights: Any, batch: Batch
) -> Float[Array, ""]:
    """Mean over a batch of each map's losses, weighted and added up, in units of the architecture's cost scale."""
    scale = recipe.architecture.cost_scale
    levels = jnp.asarray(recipe.architecture.quantiles, jnp.float32)
    estimate = compact_unet.apply(recipe.architecture, weights, batch.terrain) / scale

    def mean(name: str, weight: Float[Array, ""]) -> Float[Array, ""]:
        of_map = functools.partial(map_loss, LOSSES[name], levels=levels)
        # A loss of no weight is not to overflow where others do not.
        judged = jnp.where(weight > 0, estimate, 0.0)
        return weight * jnp.mean(jax.vmap(of_map)(judged, batch.target / scale, batch.weight))

    return jnp.sum(jnp.stack([mean(name, loss_weights[number]) for number, (name, _) in enumerate(recipe.losses)]))


def loss_or_nan(loss: Float[Array, ""], weights: Any) -> Float[Array, ""]:
    """A step's loss; NaN where it is infinite, or a weight after the step is not finite."""
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(weights)]
    return jnp.where(functools.reduce(jnp.logical_and, finite, jnp.isfinite(loss)), loss, jnp.nan)


def running_average(average: Any, weights: Any, step: Int[Array, ""], decay: float) -> Any:
    """The average of weights after one more step: early on of the steps so far, later exponential."""
    kept = jnp.minimum(decay, (1.0 + step) / (10.0 + step))
    return jax.tree.map(lambda a, w: kept * a + (1 - kept) * w, average, weights)


def _part_of_batch(
    step: Int[Array, ""],
    part: Int[Array, ""],
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> Batch:
    """Depends on the seed and the two numbers alone, so that training can be interrupted anywhere."""
    of_batches = jax.random.fold_in(jax.random.key(hyperparameters.seed), 1)
    key = jax.random.fold_in(jax.random.fold_in(of_batches, step), part)
    return draw_batch(key, data, batch_size=recipe.batch_size // recipe.parts)


def _updated(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    loss: Float[Array, ""],
    gradient: Any,
    recipe: TrainingConfig,
) -> tuple[TrainingState, Float[Array, ""]]:
    """The state one step on, and its loss as `loss_or_nan` has it."""
    updates, optimizer_state = optimizer(recipe).update(gradient, state.optimizer, state.weights)
    weights = jax.tree.map(lambda w, u: w + hyperparameters.learning_rate * u, state.weights, updates)
    average = running_average(state.average, weights, state.step, recipe.average_decay)
    new = TrainingState(step=state.step + 1, weights=weights, average=average, optimizer=optimizer_state)
    return new, loss_or_nan(loss, weights)


def _loss_and_gradient(
    weights: Any, batch: Batch, loss_weights: Float[Array, "losses"], *, recipe: TrainingConfig
) -> tuple[Float[Array, ""], Any]:
    return jax.value_and_grad(functools.partial(mean_loss, recipe, loss_weights))(weights, batch)


def train_step_at_once(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    """`train_step` as a pure function that can be traced, all of the batch at once: what accelerators are for."""

    def draw(part: Int[Array, ""]) -> Batch:
        return _part_of_batch(state.step, part, hyperparameters, data, recipe=recipe, draw_batch=draw_batch)

    parts = jax.vmap(draw)(jnp.arange(recipe.parts))
    batch = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), parts)
    loss, gradient = _loss_and_gradient(state.weights, batch, hyperparameters.loss_weights, recipe=recipe)
    return _updated(state, hyperparameters, loss, gradient, recipe)


_compiled_step_at_once = jit(train_step_at_once, static_argnames=("recipe", "draw_batch"), donate_argnames=("state",))

# Two programs for each core, since in one the compiler makes the pairs again for each use of them.
_on_one_core = functools.partial(jit, compiler_options=ONE_CORE)
_draw_on_one_core = _on_one_core(_part_of_batch, static_argnames=("recipe", "draw_batch"))
_gradient_on_one_core = _on_one_core(_loss_and_gradient, static_argnames=("recipe",))


@functools.partial(jit, static_argnames=("recipe",), donate_argnames=("state",))
def _updated_from_parts(
    state: TrainingState, hyperparameters: Hyperparameters, parts: Sequence[Any], *, recipe: TrainingConfig
) -> tuple[TrainingState, Float[Array, ""]]:
    loss, gradient = jax.tree.map(lambda *leaves: sum(leaves) / len(leaves), *parts)
    return _updated(state, hyperparameters, loss, gradient, recipe)


def train_step_by_parts(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    """`train_step` with a part of the batch at a time on each core of a CPU.

    The parts are the same on any number of cores, and are added up in order; but XLA's convolutions round otherwise on
    another number of cores. It starts programs of its own on threads of its own, so it cannot be traced:
    `train_step_at_once` can.
    """

    def gradient(part: int) -> tuple[Float[Array, ""], Any]:
        pairs = _draw_on_one_core(
            state.step, jnp.int32(part), hyperparameters, data, recipe=recipe, draw_batch=draw_batch
        )
        return _gradient_on_one_core(state.weights, pairs, hyperparameters.loss_weights, recipe=recipe)

    return _updated_from_parts(state, hyperparameters, on_cores(gradient, recipe.parts), recipe=recipe)


def train_step(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    """Take one optimizer step, the way that is fast on the device.

    The batch of a step depends on the seed and the number of the step alone, so training that was interrupted and
    resumed gives the same weights as training that was not. No step is part of a longer program: inside a `scan`,
    XLA's CPU backend runs the gradients of convolutions some twenty times slower.

    Args:
      state: the state; used up.
      hyperparameters: of the run.
      data: what `draw_batch` draws from.
      recipe: what is compiled into a step.
      draw_batch: draws pairs.

    Returns:
      The new state and the loss, as `loss_or_nan` has it.
    """
    take = train_step_by_parts if jax.default_backend() == "cpu" else _compiled_step_at_once
    return take(state, hyperparameters, data, recipe=recipe, draw_batch=draw_batch)


def mean_error(architecture: Architecture, weights: Any, batch: Batch) -> Float[Array, ""]:
    """Mean absolute error in cells of the mean outcome, over the weighted cells of each map and over maps."""
    estimate = jnp.mean(compact_unet.apply(architecture, weights, batch.terrain), axis=-1, keepdims=True)
    of_map = functools.partial(map_loss, LOSSES["l1"], levels=jnp.array([0.5]))
    return jnp.mean(jax.vmap(of_map)(estimate, batch.target, batch.weight))
