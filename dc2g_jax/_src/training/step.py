"""One optimizer step: the state of a training, the update of its weights, and the step on a batch of all devices."""

import functools
from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from dc2g_jax._src.runtime.devices import RUNS, divide, settle
from dc2g_jax._src.runtime.programs import jit


@struct.dataclass
class TrainingState:
    """The state of a training, saved and restored as a whole.

    Attributes:
      step: number of optimizer steps.
      weights: weights of the network or the networks.
      average: running average of the weights; `None` without one.
      optimizer: optax state.
    """

    step: Int[Array, ""]
    weights: Any
    average: Any
    optimizer: Any

    @property
    def trained(self) -> Any:
        """The weights to use: their average, if there is one."""
        return self.weights if self.average is None else self.average


class Supervised(Protocol):
    """What is trained, on what. Hashable, so that it can be a static argument of `jit`.

    Runs that only differ in their `hyperparameters`, a tree of arrays such as the seed, share a compiled step, and can
    be trained together. It is `None` where there are none.
    """

    @property
    def batch_size(self) -> int:
        """Examples per step."""
        ...

    @property
    def average_decay(self) -> float:
        """Decay of the running average of the weights; 0 for none."""
        return 0.0

    def first_state(self, hyperparameters: Any) -> TrainingState:
        """The state before the first step, see `state_of`."""
        ...

    def learning_rate(self, hyperparameters: Any) -> optax.Schedule:
        """`step ->` learning rate, from step 0, of a run or of each of several stacked ones."""
        ...

    def optimizer(self, hyperparameters: Any) -> optax.GradientTransformation:
        """The optimizer with its learning rate. Its initial state must not depend on the hyperparameters."""
        ...

    def draw(self, data: Any, step: Int[Array, ""], hyperparameters: Any) -> Any:
        """The batch of a step: arrays whose first axis is that of the examples."""
        ...

    def gradient(self, state: TrainingState, batch: Any, hyperparameters: Any) -> tuple[Float[Array, ""], Any]:
        """The loss of a batch, or what is shown as such, and the gradient of the weights."""
        ...


def state_of(weights: Any, optimizer: optax.GradientTransformation, average_decay: float = 0.0) -> TrainingState:
    """The state before the first step; without an average of the weights if its decay is 0."""
    average = jax.tree.map(jnp.array, weights) if average_decay else None
    return TrainingState(step=jnp.int32(0), weights=weights, average=average, optimizer=optimizer.init(weights))


@functools.partial(jit, static_argnames="training")
def first_state(hyperparameters: Any, *, training: Supervised) -> TrainingState:
    """The state of a run before its first step."""
    return training.first_state(hyperparameters)


def placed(state: Any, mesh: Mesh) -> Any:
    """The state on the devices of a mesh: whole on each, or the stacked runs divided among them."""
    return jax.device_put(state, NamedSharding(mesh, PartitionSpec(RUNS) if state.step.ndim else PartitionSpec()))


def _each_run(function: Callable[..., Any], state: TrainingState) -> Callable[..., Any]:
    """The function of one run, or of each of several runs, which are divided among the devices."""
    return function if state.step.ndim == 0 else jax.vmap(function, spmd_axis_name=RUNS)


# Batches and weights are two programs: in a single one, the compiler would compute a batch anew for each of its uses.
@functools.partial(jit, static_argnames=("training", "mesh"))
def draw_batches(state: TrainingState, data: Any, hyperparameters: Any, *, training: Supervised, mesh: Mesh) -> Any:
    """The batch of a step of each run, divided among the devices."""

    def of_run(state: TrainingState, hyperparameters: Any) -> Any:
        return divide(training.draw(data, state.step, hyperparameters), mesh)

    return _each_run(of_run, state)(state, hyperparameters)


@functools.partial(jit, static_argnames=("training",), donate_argnames="state")
def learn(
    state: TrainingState, batch: Any, hyperparameters: Any, *, training: Supervised
) -> tuple[TrainingState, Float[Array, "*runs"]]:
    """The state of each run after a step on its batch, and its loss, see `supervised_step`."""

    def of_run(state: TrainingState, batch: Any, hyperparameters: Any) -> tuple[TrainingState, Float[Array, ""]]:
        loss, gradient = training.gradient(state, batch, hyperparameters)
        updates, optimizer = training.optimizer(hyperparameters).update(gradient, state.optimizer, state.weights)
        weights = optax.apply_updates(state.weights, updates)
        average = state.average
        if average is not None:
            kept = jnp.minimum(training.average_decay, (1.0 + state.step) / (10.0 + state.step))  # smaller early on
            average = jax.tree.map(lambda a, w: kept * a + (1 - kept) * w, average, weights)
        new = TrainingState(step=state.step + 1, weights=weights, average=average, optimizer=optimizer)
        finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(weights)]
        loss = jnp.where(functools.reduce(jnp.logical_and, finite, jnp.isfinite(loss)), loss, jnp.nan)
        after = jax.tree.map(lambda now, before: jnp.where(jnp.isfinite(loss), now, before), new, state)
        return after.replace(step=new.step), loss

    return _each_run(of_run, state)(state, batch, hyperparameters)


@jit
def stacked(runs: list[Any]) -> Any:
    """Trees of several runs as one, with the runs on the first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *runs)


def supervised_step(
    state: TrainingState, data: Any, hyperparameters: Any = None, *, training: Supervised, mesh: Mesh
) -> tuple[TrainingState, Float[Array, "*runs"]]:
    """Take one optimizer step of one run, or of several whose states are stacked. The old state is donated.

    The batch is divided among the devices of a mesh, and so are the runs, see `runtime.devices.mesh_for_batch`. A batch
    only depends on the data, the hyperparameters and the number of the step, so interrupted and resumed training gives
    the same weights as training without interruption on the same devices. With another number of devices, a step
    differs by rounding. Steps are not combined into a longer program: inside a `scan`, XLA's CPU backend computes
    gradients of convolutions about ten times slower.

    If the loss or a weight of a run would not be finite, its state is kept, but for the number of steps, and its loss
    is NaN.

    Args:
      state: state of a run, or stacked states.
      data: what batches are drawn from, the same for all runs.
      hyperparameters: those of the run, or stacked ones.
      training: what is trained.
      mesh: the devices.

    Returns:
      The new state and the loss, or those of each run.
    """
    batch = draw_batches(state, data, hyperparameters, training=training, mesh=mesh)
    settle(batch)
    new = learn(state, batch, hyperparameters, training=training)
    settle(new)
    return new
