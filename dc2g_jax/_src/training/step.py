"""One optimizer step: the state of a training, the update of its weights, and the step on a batch of all devices."""

import functools
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from dc2g_jax._src.programs import jit
from dc2g_jax._src.rollouts.devices import divide


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
    """What is trained, on what. Hashable, so that it can be a static argument of `jit`."""

    @property
    def average_decay(self) -> float:
        """Decay of the running average of the weights; 0 for none."""
        return 0.0

    def optimizer(self) -> optax.GradientTransformation:
        """The optimizer with its learning rate."""
        ...

    def draw(self, data: Any, step: Int[Array, ""]) -> Any:
        """The batch of a step: arrays whose first axis is that of the examples."""
        ...

    def gradient(self, state: TrainingState, data: Any, batch: Any) -> tuple[Float[Array, ""], Any]:
        """The loss of a batch, or what is shown as such, and the gradient of the weights."""
        ...


def state_of(weights: Any, optimizer: optax.GradientTransformation, average_decay: float = 0.0) -> TrainingState:
    """The state before the first step; without an average of the weights if its decay is 0."""
    average = jax.tree.map(jnp.array, weights) if average_decay else None
    return TrainingState(step=jnp.int32(0), weights=weights, average=average, optimizer=optimizer.init(weights))


def _running_average(average: Any, weights: Any, step: Int[Array, ""], decay: float) -> Any:
    """The running average of the weights after one more step. Early on, its decay is smaller."""
    kept = jnp.minimum(decay, (1.0 + step) / (10.0 + step))
    return jax.tree.map(lambda a, w: kept * a + (1 - kept) * w, average, weights)


def updated(
    state: TrainingState,
    loss: Float[Array, ""],
    gradient: Any,
    optimizer: optax.GradientTransformation,
    *,
    average_decay: float,
    rate: Float[Array, ""] | float = 1.0,
) -> tuple[TrainingState, Float[Array, ""]]:
    """The state after one step, and its loss.

    If the loss or a weight would not be finite, the state is kept, but for the number of steps, and the loss is NaN.

    Args:
      state: state before the step.
      loss: loss of the step's batch.
      gradient: gradient of the weights.
      optimizer: optimizer.
      average_decay: decay of the running average of the weights.
      rate: factor of the optimizer's learning rate.
    """
    updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.weights)
    weights = jax.tree.map(lambda w, u: w + rate * u, state.weights, updates)
    average = None
    if state.average is not None:
        average = _running_average(state.average, weights, state.step, average_decay)
    new = TrainingState(step=state.step + 1, weights=weights, average=average, optimizer=optimizer_state)
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(weights)]
    loss = jnp.where(functools.reduce(jnp.logical_and, finite, jnp.isfinite(loss)), loss, jnp.nan)
    kept = jax.tree.map(lambda now, before: jnp.where(jnp.isfinite(loss), now, before), new, state)
    return kept.replace(step=new.step), loss


@functools.partial(jit, static_argnames=("training", "mesh"), donate_argnames="state")
def supervised_step(
    state: TrainingState, data: Any, *, training: Supervised, mesh: Mesh
) -> tuple[TrainingState, Float[Array, ""]]:
    """Take one optimizer step, with the batch divided among the devices of a mesh. The old state is donated.

    A batch only depends on the data and the number of the step, so interrupted and resumed training gives the same
    weights as training without interruption.

    Returns:
      The new state and the loss, see `updated`.
    """
    batch = divide(training.draw(data, state.step), mesh)
    loss, gradient = training.gradient(state, data, batch)
    return updated(state, loss, gradient, training.optimizer(), average_decay=training.average_decay)
