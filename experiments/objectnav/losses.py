"""Losses and metrics of predicted cost maps (sections II-C and III-B). All but `occupancy_scores` take one map."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.grid import shifted
from dc2g_jax.indoor.learning.networks import Prediction
from dc2g_jax.runtime import own_part

#: Weights of the three losses in equation (4), as in the paper.
LOSS_WEIGHTS = {"occupancy": 1.0, "cost": 1.5, "direction": 1.0}


def occupancy_loss(logits: Float[Array, "h w"], occupied: Bool[Array, "h w"]) -> Float[Array, ""]:
    """Mean binary cross entropy of occupancy, nats (equation 1)."""
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
    predicted: Float[Array, "h w"], true: Float[Array, "h w"], navigable: Bool[Array, "h w"]
) -> Float[Array, ""]:
    """Sum of 1 - cosine between the gradients on navigable cells, divided by the number of all cells (equation 3).

    Cells where the true gradient is 0 have no direction and do not count.
    """
    ours, theirs = gradient(predicted, navigable), gradient(true, navigable)
    length = jnp.sqrt(jnp.sum(theirs**2, axis=0))
    slopes = length > 0
    ours_length = jnp.sqrt(jnp.sum(ours**2, axis=0) + 1e-8)  # smooth where the gradient is 0
    cosine = jnp.sum(ours * theirs, axis=0) / (ours_length * jnp.where(slopes, length, 1))
    return jnp.mean(jnp.where(slopes, 1 - cosine, 0))


def total_loss(
    prediction: Prediction, occupied: Bool[Array, "h w"], cost: Float[Array, "h w"]
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """The weighted sum of the three losses (equation 4), and each of them."""
    navigable = ~occupied & jnp.isfinite(cost)
    losses = {
        "occupancy": occupancy_loss(prediction.occupancy_logits, occupied),
        "cost": cost_loss(prediction.cost, cost, navigable),
        "direction": direction_loss(prediction.cost, cost, navigable),
    }
    return sum((weight * losses[name] for name, weight in LOSS_WEIGHTS.items()), jnp.float32(0)), losses


#: `(prediction, occupied, cost) ->` the loss of a map, and its parts by name.
Loss = Callable[[Prediction, Bool[Array, "h w"], Float[Array, "h w"]], tuple[Float[Array, ""], dict[str, Any]]]

#: Losses by name.
LOSSES: dict[str, Loss] = {"paper": total_loss}


def named_loss(name: str) -> Loss:
    """A loss by name, one of `LOSSES` or `package.module:Name`.

    Raises:
      InputError: the name is unknown.
    """
    return LOSSES[name] if name in LOSSES else own_part("loss", name, LOSSES)


#: Steps of a local policy, (rows, columns). Staying comes first, because the first of equal costs counts.
FIVE_ACTIONS: tuple[tuple[int, int], ...] = ((0, 0), (0, 1), (-1, 0), (0, -1), (1, 0))
NINE_ACTIONS: tuple[tuple[int, int], ...] = (*FIVE_ACTIONS, (-1, 1), (-1, -1), (1, -1), (1, 1))

#: Scores of one class: `F1` and `IoU`, whose means are `mF1` and `mIoU`.
OF_CLASSES = ("F1 free", "F1 occupied", "IoU free", "IoU occupied")


def confusion(predicted: Bool[Array, "h w"], true: Bool[Array, "h w"]) -> Int[Array, "2 2"]:
    """Confusion matrix of a map: cells by truth (row) and prediction (column), free before occupied. It is additive."""
    return jnp.bincount((2 * true + predicted).ravel(), length=4).reshape(2, 2)


def occupancy_scores(counts: Float[Array, "2 2"] | Int[Array, "2 2"]) -> dict[str, Float[Array, ""]]:
    """Scores of predicted occupancy from 0 to 1.

    A class that is neither present nor predicted has score 1.

    Args:
      counts: confusion matrix of one or more maps, see `confusion`.

    Returns:
      Means over the classes free and occupied, by the paper's names: `MPA`, the recall; `mF1`, the harmonic mean of
      recall and precision; and `mIoU`, the intersection over union of predicted and true cells. Then `OF_CLASSES`.
    """
    right = jnp.diagonal(counts)
    there, predicted = jnp.sum(counts, axis=1), jnp.sum(counts, axis=0)

    def share(part: Array, whole: Array) -> Float[Array, "2"]:
        return jnp.where(whole > 0, part / jnp.maximum(whole, 1), 1.0)

    f1, iou = share(2 * right, there + predicted), share(right, there + predicted - right)
    means = {"MPA": share(right, there), "mF1": f1, "mIoU": iou}
    return {name: jnp.mean(scores) for name, scores in means.items()} | dict(zip(OF_CLASSES, (*f1, *iou), strict=True))


def best_actions(costs: Float[Array, "h w"], actions: tuple[tuple[int, int], ...]) -> Int[Array, "h w"]:
    """Index of the action that leads from each cell to the lowest cost; ties to the first action.

    Args:
      costs: costs of cells, infinite without path. Costs beyond the map are infinite.
      actions: steps, (rows, columns).
    """
    around = [shifted(costs, -right, -down, jnp.inf) for down, right in actions]
    return jnp.argmin(jnp.stack(around), axis=0)


def action_accuracy(
    predicted: Float[Array, "h w"], true: Float[Array, "h w"], actions: tuple[tuple[int, int], ...]
) -> Float[Array, ""]:
    """Share of navigable cells whose best action is the same for predicted and true costs (aAP5 and aAP9).

    Args:
      predicted: the final cost map, infinite or high where occupied.
      true: navigation cost, infinite where occupied or without a path to the goal.
      actions: `FIVE_ACTIONS` or `NINE_ACTIONS`.

    Returns:
      The share; 1 if no cell is navigable.
    """
    navigable = jnp.isfinite(true)
    same = navigable & (best_actions(predicted, actions) == best_actions(true, actions))
    count = jnp.sum(navigable)
    return jnp.where(count > 0, jnp.sum(same) / jnp.maximum(count, 1), 1.0)
