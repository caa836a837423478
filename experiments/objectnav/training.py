"""Training of the network that predicts cost maps: recipes, steps, and validation."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from dc2g_jax.estimation import fresh_weights
from dc2g_jax.indoor.learning import networks
from dc2g_jax.indoor.learning.networks import CostMapArchitecture, Prediction
from dc2g_jax.indoor.maps.mapping import network_maps
from dc2g_jax.runtime import check_number, jit
from dc2g_jax.training import Supervised, TrainingState, state_of
from experiments.objectnav.data import (
    ALL_SYMMETRIES,
    LOCAL,
    NORMALIZATIONS,
    PAPER_ROTATIONS,
    UPRIGHT,
    JourneySet,
    Samples,
    draw_samples,
)
from experiments.objectnav.losses import (
    FIVE_ACTIONS,
    NINE_ACTIONS,
    action_accuracy,
    confusion,
    named_loss,
    occupancy_scores,
)


@dataclasses.dataclass(frozen=True)
class Recipe:
    """Settings of the optimization.

    Attributes:
      optimizer: a name of `OPTIMIZERS`.
      peak: learning rate after the warm-up.
      last: learning rate at the end of a cosine decay.
      warmup: share of the steps over which the rate rises to its peak.
      weight_decay: weight decay, see the optimizers.
      symmetries: probability of each of `learning.data.SYMMETRIES`.
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
class CostMapConfig(Supervised):
    """Configuration of a training run.

    Attributes:
      architecture: architecture of the network.
      recipe: settings of the optimization.
      steps: total number of optimizer steps.
      batch_size: samples per step.
      seed: seed of weights and batches.
      loss: a name for `named_loss`.

    Raises:
      InputError: a number is out of range, or the loss is unknown.
    """

    architecture: CostMapArchitecture = dataclasses.field(default_factory=CostMapArchitecture)
    recipe: Recipe = BETTER_RECIPE
    steps: int = 5000
    batch_size: int = 16
    seed: int = 0
    loss: str = "paper"

    def __post_init__(self) -> None:
        named_loss(self.loss)
        check_number("learning rate", float(np.float32(self.recipe.peak)), above=0)
        check_number("steps", self.steps, whole=True, least=1)
        check_number("batch size", self.batch_size, whole=True, least=1)

    @property
    def average_decay(self) -> float:
        """That of the recipe."""
        return self.recipe.average_decay

    def first_state(self, hyperparameters: None) -> TrainingState:
        """Random weights, of the seed."""
        weights_key, _ = jax.random.split(jax.random.key(self.seed))
        weights = fresh_weights(networks.CostMapNetwork, self.architecture, weights_key)
        return state_of(weights, self.optimizer(), self.average_decay)

    def learning_rate(self, hyperparameters: None = None) -> optax.Schedule:
        """That of the recipe."""
        recipe, warmup = self.recipe, round(self.recipe.warmup * self.steps)
        return optax.warmup_cosine_decay_schedule(0.0, recipe.peak, warmup, max(self.steps, warmup + 1), recipe.last)

    def optimizer(self, hyperparameters: None = None) -> optax.GradientTransformation:
        """The optimizer of the recipe with its learning rates."""
        return OPTIMIZERS[self.recipe.optimizer](self.learning_rate(), self.recipe.weight_decay)

    def draw(self, data: JourneySet, step: Int[Array, ""], hyperparameters: None) -> Samples:
        """The batch of a step, which only depends on the seed and the step."""
        _, batches_key = jax.random.split(jax.random.key(self.seed))
        return draw_samples(
            jax.random.fold_in(batches_key, step),
            data,
            batch_size=self.batch_size,
            symmetries=self.recipe.symmetries,
            normalize=NORMALIZATIONS[self.recipe.normalization],
        )

    def gradient(self, state: TrainingState, batch: Samples, hyperparameters: None) -> tuple[Float[Array, ""], Any]:
        """The mean loss of a batch, and its gradient."""
        of_weights = jax.value_and_grad(lambda weights: mean_loss(self, weights, batch), has_aux=True)
        (loss, _), gradient = of_weights(state.weights)
        return loss, gradient


def mean_loss(
    config: CostMapConfig, weights: Any, samples: Samples
) -> tuple[Float[Array, ""], tuple[dict[str, Array], Prediction]]:
    """Mean of the training's loss over a batch, the mean of each of its parts, and the predictions."""
    maps = jax.vmap(functools.partial(network_maps, local=LOCAL))(samples.cells)
    prediction = networks.apply(config.architecture, weights, maps, samples.target, samples.heading, samples.features)
    loss, losses = jax.tree.map(jnp.mean, jax.vmap(named_loss(config.loss))(prediction, samples.occupied, samples.cost))
    return loss, (losses, prediction)


@functools.partial(jit, static_argnames="config")
def _examine(weights: Any, samples: Samples, config: CostMapConfig) -> dict[str, Array]:
    """Losses, confusion matrix and action accuracies on a batch."""
    loss, (losses, prediction) = mean_loss(config, weights, samples)
    costs = prediction.fused_cost

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


def figures(weights: Any, batches: list[Samples], config: CostMapConfig) -> dict[str, float]:
    """Losses, and metrics of section III-B in percent, on validation samples."""
    found = [jax.tree.map(np.asarray, _examine(weights, batch, config)) for batch in batches]
    counts = sum(batch["confusion"].astype(np.float64) for batch in found)
    mean = {name: float(np.mean([batch[name] for batch in found])) for name in found[0] if name != "confusion"}
    percent: dict[str, Any] = occupancy_scores(jnp.asarray(counts, jnp.float32))
    percent |= {name: mean.pop(name) for name in ("aAP5", "aAP9")}
    mean["validation_loss"] = mean.pop("loss")
    return {
        **{name: round(value, 4) for name, value in mean.items()},
        **{name: round(100 * float(value), 2) for name, value in percent.items()},
    }
