"""Training of the network that predicts cost maps: recipes, training steps, and validation on unseen houses."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh
from jaxtyping import Array, Float

from dc2g_jax.estimation.weights import fresh_weights
from dc2g_jax.objectnav import networks
from dc2g_jax.objectnav.data import (
    ALL_SYMMETRIES,
    LOCAL,
    NORMALIZATIONS,
    PAPER_ROTATIONS,
    UPRIGHT,
    JourneySet,
    Samples,
    draw_samples,
)
from dc2g_jax.objectnav.losses import LossWeights, total_loss
from dc2g_jax.objectnav.mapping import network_maps
from dc2g_jax.objectnav.metrics import FIVE_ACTIONS, NINE_ACTIONS, action_accuracy, confusion, occupancy_scores
from dc2g_jax.objectnav.networks import CostMapArchitecture, CostMapEstimator, Prediction, fused_cost
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.devices import divide
from dc2g_jax.training.cost_to_go import TrainingState, check_numbers, loss_or_nan, running_average


@dataclasses.dataclass(frozen=True)
class Recipe:
    """Settings of the optimization.

    Attributes:
      optimizer: a name of `OPTIMIZERS`.
      peak: learning rate after the warm-up.
      last: learning rate at the end of a cosine decay.
      warmup: share of the steps over which the rate rises to its peak.
      weight_decay: weight decay, see the optimizers.
      symmetries: probability of each of `dc2g_jax.objectnav.data.SYMMETRIES`.
      normalization: a name of `NORMALIZATIONS`.
      average_decay: decay of the running average of the weights, which is saved; 0 saves the weights themselves.
    """

    optimizer: str
    peak: float
    last: float
    warmup: float
    weight_decay: float
    symmetries: tuple[float, ...]
    normalization: str
    average_decay: float


#: Optimizers by name: `(learning rate by step, weight decay) -> optimizer`. SGD adds the decay to the gradient. The
#: paper does not state its momentum; 0.9 is usual. AdamW clips gradients, and its decay is decoupled.
OPTIMIZERS: dict[str, Callable[[optax.Schedule, float], optax.GradientTransformation]] = {
    "sgd": lambda rate, decay: optax.chain(optax.add_decayed_weights(decay), optax.sgd(rate, momentum=0.9)),
    "adamw": lambda rate, decay: optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=decay)),
}

#: The recipe of the paper (section III-D), whose warm-up takes 25 of 200 epochs.
PAPER_RECIPE = Recipe("sgd", 15e-5, 1e-5, 0.125, 0.01, PAPER_ROTATIONS, "share", 0.0)

#: A recipe that is better after minutes of training: costs in meters, all symmetries.
BETTER_RECIPE = Recipe("adamw", 1.5e-3, 1e-5, 0.05, 0.01, ALL_SYMMETRIES, "relative", 0.998)

RECIPES = {"better": BETTER_RECIPE, "paper": PAPER_RECIPE}


@dataclasses.dataclass(frozen=True)
class CostMapConfig:
    """Configuration of a training run.

    Attributes:
      architecture: architecture of the network.
      recipe: settings of the optimization.
      loss_weights: weights of the three losses.
      steps: total number of optimizer steps.
      batch_size: samples per step.
      seed: seed of weights and batches.

    Raises:
      InputError: a number is out of range.
    """

    architecture: CostMapArchitecture = dataclasses.field(default_factory=CostMapArchitecture)
    recipe: Recipe = BETTER_RECIPE
    loss_weights: LossWeights = dataclasses.field(default_factory=LossWeights)
    steps: int = 5000
    batch_size: int = 16
    seed: int = 0

    def __post_init__(self) -> None:
        check_numbers(self.recipe.peak, steps=self.steps, batch_size=self.batch_size)


def learning_rate_schedule(config: CostMapConfig) -> optax.Schedule:
    """`step ->` learning rate of the recipe."""
    recipe, warmup = config.recipe, round(config.recipe.warmup * config.steps)
    return optax.warmup_cosine_decay_schedule(0.0, recipe.peak, warmup, max(config.steps, warmup + 1), recipe.last)


def optimizer(config: CostMapConfig) -> optax.GradientTransformation:
    """The optimizer of the recipe with its learning-rate schedule."""
    return OPTIMIZERS[config.recipe.optimizer](learning_rate_schedule(config), config.recipe.weight_decay)


def first_state(config: CostMapConfig) -> TrainingState:
    """The state before the first step."""
    weights_key, _ = jax.random.split(jax.random.key(config.seed))
    weights = fresh_weights(networks.CostMapNetwork, config.architecture, weights_key)
    return TrainingState(
        step=jnp.int32(0),
        weights=weights,
        average=jax.tree.map(jnp.array, weights),
        optimizer=optimizer(config).init(weights),
    )


def mean_loss(
    config: CostMapConfig, weights: Any, samples: Samples
) -> tuple[Float[Array, ""], tuple[dict[str, Array], Prediction]]:
    """Mean of equation (4) over a batch, the mean of each of its losses, and the predictions."""
    maps = jax.vmap(functools.partial(network_maps, local=LOCAL))(samples.cells)
    prediction = networks.apply(config.architecture, weights, maps, samples.target, samples.heading, samples.features)
    of_map = functools.partial(total_loss, weights=config.loss_weights)
    loss, losses = jax.tree.map(jnp.mean, jax.vmap(of_map)(prediction, samples.occupied, samples.cost))
    return loss, (losses, prediction)


@functools.partial(jit, static_argnames=("config", "mesh"), donate_argnames="state")
def train_step(
    state: TrainingState, data: JourneySet, *, config: CostMapConfig, mesh: Mesh
) -> tuple[TrainingState, Float[Array, ""]]:
    """Take one optimizer step. The old state is donated.

    The batch depends only on the seed and the number of the step, so interrupted and resumed training gives the same
    weights as training without interruption.

    Returns:
      The new state and the loss, see `dc2g_jax.training.cost_to_go.loss_or_nan`.
    """
    recipe = config.recipe
    _, batches_key = jax.random.split(jax.random.key(config.seed))
    samples = draw_samples(
        jax.random.fold_in(batches_key, state.step),
        data,
        batch_size=config.batch_size,
        symmetries=recipe.symmetries,
        normalize=NORMALIZATIONS[recipe.normalization],
    )
    samples = divide(samples, mesh)
    (loss, _), gradient = jax.value_and_grad(lambda weights: mean_loss(config, weights, samples), has_aux=True)(
        state.weights
    )
    updates, optimizer_state = optimizer(config).update(gradient, state.optimizer, state.weights)
    weights = optax.apply_updates(state.weights, updates)
    average = running_average(state.average, weights, state.step, recipe.average_decay)
    new = TrainingState(step=state.step + 1, weights=weights, average=average, optimizer=optimizer_state)
    return new, loss_or_nan(loss, weights)


@functools.partial(jit, static_argnames="config")
def _examine(weights: Any, samples: Samples, config: CostMapConfig) -> dict[str, Array]:
    """Losses, confusion matrix and action accuracies on a batch."""
    loss, (losses, prediction) = mean_loss(config, weights, samples)
    costs = fused_cost(prediction.occupancy, prediction.cost)

    def accuracy(actions: tuple[tuple[int, int], ...]) -> Array:
        return jnp.mean(jax.vmap(functools.partial(action_accuracy, actions=actions))(costs, samples.cost))

    return {
        "loss": loss,
        **losses,
        "confusion": jnp.sum(jax.vmap(confusion)(prediction.occupancy > 0.5, samples.occupied), axis=0),
        "aAP5": accuracy(FIVE_ACTIONS),
        "aAP9": accuracy(NINE_ACTIONS),
    }


def validation_samples(data: JourneySet, config: CostMapConfig, count: int) -> list[Samples]:
    """Fixed samples for validation, without symmetries, in batches of the training's size."""
    draw = jit(
        functools.partial(
            draw_samples,
            batch_size=config.batch_size,
            symmetries=UPRIGHT,
            normalize=NORMALIZATIONS[config.recipe.normalization],
        )
    )
    keys = jax.random.split(jax.random.key(0), max(count // config.batch_size, 1))
    return [draw(key, data) for key in keys]


def figures(estimator: CostMapEstimator, batches: list[Samples], config: CostMapConfig) -> dict[str, float]:
    """Losses, and metrics of section III-B in percent, on validation samples.

    Args:
      estimator: the network.
      batches: samples, see `validation_samples`.
      config: configuration of its training.
    """
    found = [jax.tree.map(np.asarray, _examine(estimator.weights, batch, config)) for batch in batches]
    counts = sum(batch["confusion"].astype(np.float64) for batch in found)
    mean = {name: float(np.mean([batch[name] for batch in found])) for name in found[0] if name != "confusion"}
    percent: dict[str, Any] = occupancy_scores(jnp.asarray(counts, jnp.float32))
    percent |= {name: mean.pop(name) for name in ("aAP5", "aAP9")}
    return {
        **{name: round(value, 4) for name, value in mean.items()},
        **{name: round(100 * float(value), 2) for name, value in percent.items()},
    }
