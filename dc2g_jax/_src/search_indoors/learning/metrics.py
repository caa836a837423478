"""Metrics of predicted cost maps (section III-B). All functions take one map, except `occupancy_scores`."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax._src.grid.shifting import shifted

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
