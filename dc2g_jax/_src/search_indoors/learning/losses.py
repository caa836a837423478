"""Losses of predicted cost maps (section II-C, equations 1 to 4). All functions take one map."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from dc2g_jax._src.grid.shifting import shifted
from dc2g_jax._src.search_indoors.learning.networks import Prediction


class LossWeights(NamedTuple):
    """Weights of the three losses; defaults as in the paper.

    Attributes:
      occupancy: weight of equation (1).
      cost: weight of equation (2).
      direction: weight of equation (3).
    """

    occupancy: float = 1.0
    cost: float = 1.5
    direction: float = 1.0


def occupancy_loss(logits: Float[Array, "h w"], occupied: Bool[Array, "h w"]) -> Float[Array, ""]:
    """Mean binary cross entropy of occupancy, nats (equation 1).

    Args:
      logits: predicted log-odds of being occupied.
      occupied: whether the cells are occupied.
    """
    return jnp.mean(jax.nn.softplus(logits) - jnp.where(occupied, logits, 0))


def cost_loss(
    predicted: Float[Array, "h w"], true: Float[Array, "h w"], navigable: Bool[Array, "h w"]
) -> Float[Array, ""]:
    """Sum of the absolute errors on navigable cells, divided by the number of all cells (equation 2).

    Args:
      predicted: navigation cost.
      true: navigation cost; may be infinite on other cells.
      navigable: free cells with a path to the goal.
    """
    return jnp.mean(jnp.where(navigable, jnp.abs(predicted - jnp.where(navigable, true, 0)), 0))


def gradient(costs: Float[Array, "h w"], navigable: Bool[Array, "h w"]) -> Float[Array, "2 h w"]:
    """Gradient of a cost map per cell, down the rows and along them, from navigable cells only.

    Central differences where both neighbors are navigable, one-sided ones where one is, and 0 where neither is and on
    cells that are not navigable.

    Args:
      costs: costs, finite on navigable cells.
      navigable: cells that count.
    """
    values = jnp.where(navigable, costs, 0)

    def along(dx: int, dy: int) -> Float[Array, "h w"]:
        ahead, behind = shifted(navigable, -dx, -dy, False) & navigable, shifted(navigable, dx, dy, False) & navigable
        rise = jnp.where(ahead, shifted(values, -dx, -dy, 0) - values, 0) + jnp.where(
            behind, values - shifted(values, dx, dy, 0), 0
        )
        return jnp.where(ahead & behind, rise / 2, rise)

    return jnp.stack([along(0, 1), along(1, 0)])


def direction_loss(
    predicted: Float[Array, "h w"], true: Float[Array, "h w"], navigable: Bool[Array, "h w"], epsilon: float = 1e-8
) -> Float[Array, ""]:
    """Sum of 1 - cosine between the gradients on navigable cells, divided by the number of all cells (equation 3).

    Cells where the true gradient is 0 have no direction and do not count.

    Args:
      predicted: navigation cost.
      true: navigation cost; may be infinite on other cells.
      navigable: free cells with a path to the goal.
      epsilon: added to the squared length of the predicted gradient, so that the loss is smooth where that is 0.
    """
    ours, theirs = gradient(predicted, navigable), gradient(true, navigable)
    length = jnp.sqrt(jnp.sum(theirs**2, axis=0))
    slopes = length > 0
    ours_length = jnp.sqrt(jnp.sum(ours**2, axis=0) + epsilon)
    cosine = jnp.sum(ours * theirs, axis=0) / (ours_length * jnp.where(slopes, length, 1))
    return jnp.mean(jnp.where(slopes, 1 - cosine, 0))


def total_loss(
    prediction: Prediction,
    occupied: Bool[Array, "h w"],
    cost: Float[Array, "h w"],
    weights: LossWeights,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """The weighted sum of the three losses (equation 4), and each of them.

    Args:
      prediction: output of the network.
      occupied: whether the cells are occupied.
      cost: true navigation cost, infinite where no path leads to the goal.
      weights: weights of the losses.
    """
    navigable = ~occupied & jnp.isfinite(cost)
    losses = {
        "occupancy": occupancy_loss(prediction.occupancy_logits, occupied),
        "cost": cost_loss(prediction.cost, cost, navigable),
        "direction": direction_loss(prediction.cost, cost, navigable),
    }
    return sum((weight * losses[name] for name, weight in weights._asdict().items()), jnp.float32(0)), losses
