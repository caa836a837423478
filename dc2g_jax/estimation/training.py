"""Training a cost-to-go network: state, one step, steps of several runs."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, UInt8, UInt32

from dc2g_jax.errors import InputError
from dc2g_jax.estimation import networks
from dc2g_jax.estimation.losses import LOSSES, map_loss
from dc2g_jax.estimation.networks import Architecture


def check_numbers(learning_rate: float, **counts: int) -> None:
    """Refuse numbers that no training can have.

    Raises:
      InputError: names the number.
    """
    for name, count in counts.items():
        if count < 1:
            raise InputError(f"{name.replace('_', ' ')} {count}: give at least 1")
    if not 0 < learning_rate < float("inf"):
        raise InputError(f"learning rate {learning_rate}: give a number above 0")


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """How to train.

    Attributes:
      architecture: the network.
      steps: optimiser steps in all; the learning rate falls to zero over them.
      batch_size: pairs a step.
      losses: names of losses, see `dc2g_jax.estimation.losses.LOSSES`, and the weight of each.
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
    weights = networks.init_weights(recipe.architecture, jax.random.key(hyperparameters.seed))
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
    estimate = networks.apply(recipe.architecture, weights, batch.terrain) / scale

    def mean(name: str) -> Float[Array, ""]:
        of_map = functools.partial(map_loss, LOSSES[name], levels=levels)
        return jnp.mean(jax.vmap(of_map)(estimate, batch.target / scale, batch.weight))

    return jnp.sum(loss_weights * jnp.stack([mean(name) for name, _ in recipe.losses]))


def loss_or_nan(loss: Float[Array, ""], weights: Any) -> Float[Array, ""]:
    """A step's loss; NaN where it is infinite, or a weight after the step is not finite."""
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(weights)]
    return jnp.where(functools.reduce(jnp.logical_and, finite, jnp.isfinite(loss)), loss, jnp.nan)


def running_average(average: Any, weights: Any, step: Int[Array, ""], decay: float) -> Any:
    """The average of weights after one more step: early on of the steps so far, later exponential."""
    kept = jnp.minimum(decay, (1.0 + step) / (10.0 + step))
    return jax.tree.map(lambda a, w: kept * a + (1 - kept) * w, average, weights)


def _step(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    transform = optimizer(recipe)
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(hyperparameters.seed), 1), state.step)
    batch = draw_batch(key, data)
    loss, gradient = jax.value_and_grad(
        lambda weights: mean_loss(recipe, hyperparameters.loss_weights, weights, batch)
    )(state.weights)
    updates, optimizer_state = transform.update(gradient, state.optimizer, state.weights)
    weights = jax.tree.map(lambda w, u: w + hyperparameters.learning_rate * u, state.weights, updates)
    average = running_average(state.average, weights, state.step, recipe.average_decay)
    new = TrainingState(step=state.step + 1, weights=weights, average=average, optimizer=optimizer_state)
    return new, loss_or_nan(loss, weights)


@functools.partial(jax.jit, static_argnames=("recipe", "draw_batch"), donate_argnames=("state",))
def train_step(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    """Take one optimiser step.

    The batch of a step depends on the seed and the number of the step alone, so training that was interrupted and
    resumed gives the same weights as training that was not. One step is one program: inside a `scan`, XLA's CPU
    backend runs the gradients of convolutions some twenty times slower.

    Returns:
      The new state and the loss, as `loss_or_nan` has it.
    """
    return _step(state, hyperparameters, data, recipe=recipe, draw_batch=draw_batch)


def init_states(recipe: TrainingConfig, hyperparameters: Hyperparameters) -> TrainingState:
    """The states of several runs before the first step, stacked; each as `init_state` gives it."""
    return jax.vmap(functools.partial(init_state, recipe))(hyperparameters)


def _step_while_finite(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    """A step; where the loss is NaN after it, everything but the number of the step stays as it was."""
    new, loss = _step(state, hyperparameters, data, recipe=recipe, draw_batch=draw_batch)
    kept = jax.tree.map(lambda now, before: jnp.where(jnp.isfinite(loss), now, before), new, state)
    return kept.replace(step=new.step), loss


@functools.partial(jax.jit, static_argnames=("recipe", "draw_batch"), donate_argnames=("states",))
def train_steps_together(
    states: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, "runs"]]:
    """`train_steps` with all runs in one program: what accelerators are for."""
    one_step = functools.partial(_step_while_finite, recipe=recipe, draw_batch=draw_batch)
    return jax.vmap(one_step, in_axes=(0, 0, None))(states, hyperparameters, data)


@functools.partial(jax.jit, static_argnames=("recipe", "draw_batch"), donate_argnames=("states",))
def _step_of_run(
    states: TrainingState,
    run: Int[Array, ""],
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, ""]]:
    """One run's step, in its place in the stack."""
    state, numbers = jax.tree.map(lambda leaf: leaf[run], (states, hyperparameters))
    new, loss = _step_while_finite(state, numbers, data, recipe=recipe, draw_batch=draw_batch)
    put = functools.partial(jax.lax.dynamic_update_index_in_dim, index=run, axis=0)
    return jax.tree.map(put, states, new), loss


def train_steps_in_turn(
    states: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, "runs"]]:
    """`train_steps` with one run after the other, by one program: a CPU's convolutions fill its cores with one."""
    losses = []
    for run in range(len(hyperparameters.seed)):
        states, loss = _step_of_run(states, jnp.int32(run), hyperparameters, data, recipe=recipe, draw_batch=draw_batch)
        losses.append(loss)
    return states, jnp.stack(losses)


def train_steps(
    states: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
) -> tuple[TrainingState, Float[Array, "runs"]]:
    """Take one optimiser step of several runs, each on batches of its own, the way that is fast on the device.

    A run whose loss or weights would not be finite keeps those that it had, and its loss is NaN; the others go on.

    Args:
      states: states of all runs, stacked; used up.
      hyperparameters: of all runs, stacked.
      data: what `draw_batch` draws from; shared.
      recipe: what all runs have in common.
      draw_batch: see `train_step`.

    Returns:
      The new states and the losses.
    """
    take = train_steps_in_turn if jax.default_backend() == "cpu" else train_steps_together
    return take(states, hyperparameters, data, recipe=recipe, draw_batch=draw_batch)


def mean_error(architecture: Architecture, weights: Any, batch: Batch) -> Float[Array, ""]:
    """Mean absolute error in cells of the mean outcome, over the weighted cells of each map and over maps."""
    estimate = jnp.mean(networks.apply(architecture, weights, batch.terrain), axis=-1, keepdims=True)
    of_map = functools.partial(map_loss, LOSSES["l1"], levels=jnp.array([0.5]))
    return jnp.mean(jax.vmap(of_map)(estimate, batch.target, batch.weight))
