"""Training of a cost-to-go network: configuration, state and step."""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jax.sharding import Mesh, NamedSharding, PartitionSpec as P
from jaxtyping import Array, Float, Int, UInt32

from dc2g_jax._src.datasets.pairs import Pair
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.programs import jit
from dc2g_jax._src.rollouts.devices import mesh_of, platform, settle
from dc2g_jax._src.training.losses import LOSSES, map_loss, named_loss
from dc2g_jax._src.training.step import TrainingState, state_of, updated

#: Maximum number of equal parts of a batch, which devices can share.
_MOST_PARTS = 8

#: Axes of the mesh in training: runs are divided among the first, parts of a batch among the second.
_RUNS, _PARTS = "runs", "parts"


def check_numbers(learning_rate: float, **counts: int) -> None:
    """Check the learning rate and counts such as the number of steps.

    Raises:
      InputError: a number is invalid; the message names it.
    """
    for name, count in counts.items():
        if count < 1:
            raise InputError(f"{name.replace('_', ' ')} {count}: give at least 1")
    if not 0 < np.float32(learning_rate) < np.inf:
        raise InputError(f"learning rate {learning_rate}: give a number above 0 that single precision holds")


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
        check_numbers(self.learning_rate, steps=self.steps, batch_size=self.batch_size)
        if not 0 <= self.seed < 2**32:
            raise InputError(f"seed {self.seed}: give a whole number from 0 to {2**32 - 1}")

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


#: `(key, data, batch_size=...) ->` training pairs.
DrawBatch = Callable[..., Pair]


def _learning_rate_schedule(recipe: TrainingConfig) -> optax.Schedule:
    """`step ->` learning rate: a linear warm-up, then a cosine decay to zero, for a peak of 1."""
    warmup = min(200, recipe.steps // 10)
    return optax.warmup_cosine_decay_schedule(0.0, 1.0, warmup, recipe.steps)


def learning_rates(config: TrainingConfig) -> Float[np.ndarray, "steps"]:
    """The learning rate of every step."""
    rates = jax.vmap(_learning_rate_schedule(config.recipe))(jnp.arange(config.steps))
    return config.learning_rate * np.asarray(rates)


def optimizer(recipe: TrainingConfig) -> optax.GradientTransformation:
    """AdamW with clipped gradients, for a peak learning rate of 1."""
    adamw = optax.adamw(_learning_rate_schedule(recipe), weight_decay=recipe.weight_decay)
    return optax.chain(optax.clip_by_global_norm(1.0), adamw)


def init_state(recipe: TrainingConfig, hyperparameters: Hyperparameters) -> TrainingState:
    """The state before the first step."""
    weights = compact_unet.init_weights(recipe.architecture, jax.random.key(hyperparameters.seed))
    return state_of(weights, optimizer(recipe), recipe.average_decay)


def first_state(config: TrainingConfig) -> TrainingState:
    """The state of a run before its first step."""
    return init_state(config.recipe, config.hyperparameters)


def mean_loss(
    recipe: TrainingConfig, loss_weights: Float[Array, "losses"], weights: Any, batch: Pair
) -> Float[Array, ""]:
    """Mean over a batch of the weighted sum of each map's losses, in units of the architecture's cost scale."""
    scale = recipe.architecture.cost_scale
    levels = jnp.asarray(recipe.architecture.quantiles, jnp.float32)
    estimate = compact_unet.apply(recipe.architecture, weights, batch.terrain) / scale

    def mean(name: str, weight: Float[Array, ""]) -> Float[Array, ""]:
        of_map = functools.partial(map_loss, named_loss(name), levels=levels)
        # A loss of weight 0 must not overflow.
        judged = jnp.where(weight > 0, estimate, 0.0)
        return weight * jnp.mean(jax.vmap(of_map)(judged, batch.target / scale, batch.weight))

    return jnp.sum(jnp.stack([mean(name, loss_weights[number]) for number, (name, _) in enumerate(recipe.losses)]))


def _updated(
    recipe: TrainingConfig,
    state: TrainingState,
    hyperparameters: Hyperparameters,
    loss: Float[Array, ""],
    gradient: Any,
) -> tuple[TrainingState, Float[Array, ""]]:
    """The state of one run after one step, and its loss, see `training.step.updated`."""
    rate, decay = hyperparameters.learning_rate, recipe.average_decay
    return updated(state, loss, gradient, optimizer(recipe), average_decay=decay, rate=rate)


@functools.cache
def _layout(mesh: Mesh, n_runs: int) -> Mesh:
    """A mesh with two axes: runs are divided among the first, each run's batches among the second."""
    groups = math.gcd(n_runs, mesh.size)
    return Mesh(mesh.devices.reshape(groups, -1), (_RUNS, _PARTS))


def _stacked(tree: Any, like: TrainingState) -> Any:
    """Arrays with an axis of runs, which is added for a single run."""
    return jax.tree.map(lambda leaf: leaf[None], tree) if like.step.ndim == 0 else tree


def _own_parts(recipe: TrainingConfig, layout: Mesh) -> int:
    """Parts of a batch per device. Surplus devices repeat the work of others."""
    return recipe.parts // math.gcd(recipe.parts, layout.shape[_PARTS])


# Pairs and gradients are two programs: in a single one, the compiler would recompute the pairs for each use.
@functools.partial(jit, static_argnames=("layout", "recipe", "draw_batch"))
def _draw(
    state: TrainingState, hyperparameters: Hyperparameters, data: Any, runs: Int[Array, "k"], parts: Int[Array, "p"],
    *, layout: Mesh, recipe: TrainingConfig, draw_batch: DrawBatch,
) -> Pair:  # fmt: skip
    """Draw, on each device, some of its parts of the batches of some of its runs: `[runs, devices of a run, pairs]`."""
    own_parts = _own_parts(recipe, layout)

    def own(steps: Array, hyperparameters: Hyperparameters, data: Any, runs: Array, parts: Array) -> Pair:
        first = jax.lax.axis_index(_PARTS) * own_parts % recipe.parts

        def of_run(run: Array) -> Pair:
            numbers = jax.tree.map(lambda leaf: leaf[run], hyperparameters)

            def part(number: Array) -> Pair:
                step, place = steps[run], first + number
                # A part only depends on the seed, the step and its number, so training can be resumed anywhere.
                of_batches = jax.random.fold_in(jax.random.key(numbers.seed), 1)
                key = jax.random.fold_in(jax.random.fold_in(of_batches, step), place)
                return draw_batch(key, data, batch_size=recipe.batch_size // recipe.parts)

            return jax.tree.map(lambda leaf: leaf.reshape(1, -1, *leaf.shape[2:]), jax.vmap(part)(parts))

        return jax.vmap(of_run)(runs)

    specs = (P(_RUNS), P(_RUNS), P(), P(), P())
    mapped = jax.shard_map(own, mesh=layout, in_specs=specs, out_specs=P(_RUNS, _PARTS), check_vma=False)
    steps, numbers = _stacked((state.step, hyperparameters), state)
    return mapped(steps, numbers, data, runs, parts)


@functools.partial(jit, static_argnames=("layout", "recipe"))
def _gradient(
    state: TrainingState, hyperparameters: Hyperparameters, batch: Pair, runs: Int[Array, "k"],
    *, layout: Mesh, recipe: TrainingConfig,
) -> tuple[Float[Array, "runs devices"], Any]:  # fmt: skip
    """Losses and gradients of the batches of `_draw`."""

    def own(weights: Any, loss_weights: Array, batch: Pair, runs: Array) -> tuple[Array, Any]:
        def of_run(weights: Any, loss_weights: Array, batch: Pair) -> tuple[Array, Any]:
            own_batch = jax.tree.map(lambda leaf: leaf[0], batch)
            found = jax.value_and_grad(functools.partial(mean_loss, recipe, loss_weights))(weights, own_batch)
            return jax.tree.map(lambda leaf: leaf[None], found)

        weights, loss_weights = jax.tree.map(lambda leaf: leaf[runs], (weights, loss_weights))
        if len(runs) > 1:
            return jax.vmap(of_run)(weights, loss_weights, batch)
        weights, loss_weights, batch = jax.tree.map(lambda leaf: leaf[0], (weights, loss_weights, batch))
        return jax.tree.map(lambda leaf: leaf[None], of_run(weights, loss_weights, batch))

    specs = (P(_RUNS), P(_RUNS), P(_RUNS, _PARTS), P())
    mapped = jax.shard_map(own, mesh=layout, in_specs=specs, out_specs=P(_RUNS, _PARTS), check_vma=False)
    weights, loss_weights = _stacked((state.weights, hyperparameters.loss_weights), state)
    return mapped(weights, loss_weights, batch, runs)


@functools.partial(jit, static_argnames=("layout", "recipe"), donate_argnames=("state",))
def _update(
    state: TrainingState, hyperparameters: Hyperparameters, found: Sequence[Sequence[tuple[Array, Any]]],
    *, layout: Mesh, recipe: TrainingConfig,
) -> tuple[TrainingState, Float[Array, "*runs"]]:  # fmt: skip
    """The state after one step, and the loss, on every device. `found` has losses and gradients of each run's parts."""

    def mean(*parts: Array) -> Array:
        return jax.lax.pmean(sum(parts) / len(parts), _PARTS)

    def own(states: TrainingState, hyperparameters: Hyperparameters, found: Sequence[Sequence[Any]]) -> Any:
        means = [jax.tree.map(mean, *of_run) for of_run in found]
        loss, gradient = jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[:, 0], *means)
        new, losses = jax.vmap(functools.partial(_updated, recipe))(states, hyperparameters, loss, gradient)
        return new, jax.lax.all_gather(losses, _RUNS, tiled=True)

    specs, out_specs = (P(_RUNS), P(_RUNS), P(_RUNS, _PARTS)), (P(_RUNS), P())
    mapped = jax.shard_map(own, mesh=layout, in_specs=specs, out_specs=out_specs, check_vma=False)
    states, numbers = _stacked((state, hyperparameters), state)
    updated = mapped(states, numbers, found)
    return jax.tree.map(lambda leaf: leaf[0], updated) if state.step.ndim == 0 else updated


def train_step(
    state: TrainingState,
    hyperparameters: Hyperparameters,
    data: Any,
    *,
    recipe: TrainingConfig,
    draw_batch: DrawBatch,
    mesh: Mesh | None = None,
) -> tuple[TrainingState, Float[Array, "*runs"]]:
    """Take one optimizer step of one run, or of several whose states are stacked.

    Runs are divided among the devices, and each run's batch among up to eight devices of the run. A CPU processes one
    part of one batch at a time, within its caches; an accelerator processes everything at once. The batch of a step
    only depends on the seed and the step number, so resumed training is bit-identical to uninterrupted training on the
    same devices. With another number of devices, a step differs by rounding, about 1e-6 of a weight. Steps are not
    combined into a longer program: inside a `scan`, XLA's CPU backend computes gradients of convolutions about ten
    times slower.

    If the loss or weights of a run would not be finite, the run keeps its weights, and its loss is NaN.

    Args:
      state: state of a run, or stacked states; donated.
      hyperparameters: hyperparameters of the run, or stacked ones.
      data: data for `draw_batch`, best replicated already, see `rollouts.devices.replicate`.
      recipe: static part of the configuration, the same for all runs.
      draw_batch: draws pairs.
      mesh: devices to train on; `None` for all.

    Returns:
      The new state and the loss, or those of each run.
    """
    layout = _layout(mesh_of() if mesh is None else mesh, state.step.size)
    sharding = NamedSharding(layout, P() if state.step.ndim == 0 else P(_RUNS))
    if state.step.sharding != sharding:  # also where it lies alike: programs are compiled for how it is written
        state = jax.device_put(state, sharding)
    own_runs, own_parts = state.step.size // layout.shape[_RUNS], _own_parts(recipe, layout)
    one_at_a_time = platform(layout) == "cpu"
    runs, parts = (
        np.split(np.arange(count, dtype=np.int32), count if one_at_a_time else 1) for count in (own_runs, own_parts)
    )

    def found(some_runs: np.ndarray, some_parts: np.ndarray) -> tuple[Array, Any]:
        batch = _draw(
            state, hyperparameters, data, some_runs, some_parts, layout=layout, recipe=recipe, draw_batch=draw_batch
        )
        return _gradient(state, hyperparameters, batch, some_runs, layout=layout, recipe=recipe)

    of_runs = [[found(some_runs, some_parts) for some_parts in parts] for some_runs in runs]
    settle(of_runs)
    new = _update(state, hyperparameters, of_runs, layout=layout, recipe=recipe)
    settle(new)
    return new


def mean_error(architecture: Architecture, weights: Any, batch: Pair) -> Float[Array, ""]:
    """Mean absolute error of the mean outcome, in cells: the weighted mean of each map, averaged over maps."""
    estimate = jnp.mean(compact_unet.apply(architecture, weights, batch.terrain), axis=-1, keepdims=True)
    of_map = functools.partial(map_loss, LOSSES["l1"], levels=jnp.array([0.5]))
    return jnp.mean(jax.vmap(of_map)(estimate, batch.target, batch.weight))
