"""How good a predicted cost map is (section III-B). For one map each, but for `occupancy_scores`, which takes any."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

#: Steps of a local policy, down the rows and along them. Staying comes first: of equal costs the first one counts.
FIVE_ACTIONS: tuple[tuple[int, int], ...] = ((0, 0), (0, 1), (-1, 0), (0, -1), (1, 0))
NINE_ACTIONS: tuple[tuple[int, int], ...] = (*FIVE_ACTIONS, (-1, 1), (-1, -1), (1, -1), (1, 1))


class OccupancyScores(NamedTuple):
    """Scores of the occupancy, as shares; means over free and occupied.

    Attributes:
      accuracy: of a class's cells, the share that is found (MPA).
      f1: harmonic mean of that and of the share of right ones among those found (mF1).
      iou: right ones by all that are in the class or predicted to be (mIoU).
    """

    accuracy: Float[Array, ""]
    f1: Float[Array, ""]
    iou: Float[Array, ""]


def confusion(predicted: Bool[Array, "h w"], true: Bool[Array, "h w"]) -> Int[Array, "2 2"]:
    """Numbers of cells by truth (row) and prediction (column), free before occupied. They add up over maps."""
    return jnp.stack(
        [jnp.stack([jnp.sum((true == row) & (predicted == column)) for column in (0, 1)]) for row in (0, 1)]
    )


def occupancy_scores(counts: Float[Array, "2 2"] | Int[Array, "2 2"]) -> OccupancyScores:
    """Scores from a confusion matrix. A class that is neither there nor predicted counts as found.

    Args:
      counts: see `confusion`.
    """
    right = jnp.diagonal(counts)
    there, predicted = jnp.sum(counts, axis=1), jnp.sum(counts, axis=0)

    def mean_share(part: Array, whole: Array) -> Float[Array, ""]:
        return jnp.mean(jnp.where(whole > 0, part / jnp.maximum(whole, 1), 1.0))

    return OccupancyScores(
        accuracy=mean_share(right, there),
        f1=mean_share(2 * right, there + predicted),
        iou=mean_share(right, there + predicted - right),
    )


def best_actions(costs: Float[Array, "h w"], actions: tuple[tuple[int, int], ...]) -> Int[Array, "h w"]:
    """The action that leads from each cell to the lowest cost, by its index; the first one of equals.

    Args:
      costs: infinite where there is no way. Beyond the map it is infinite too.
      actions: steps down the rows and along them.
    """
    height, width = costs.shape
    around = jnp.pad(costs, 1, constant_values=jnp.inf)
    return jnp.argmin(
        jnp.stack([around[1 + down : 1 + down + height, 1 + right : 1 + right + width] for down, right in actions]),
        axis=0,
    )


def action_accuracy(
    predicted: Float[Array, "h w"], true: Float[Array, "h w"], actions: tuple[tuple[int, int], ...]
) -> Float[Array, ""]:
    """Share of navigable cells at which the lowest cost nearby lies the same way (aAP5 and aAP9).

    Args:
      predicted: the final cost map, infinite or high where occupied.
      true: navigation cost, infinite where occupied or without a way to the goal.
      actions: `FIVE_ACTIONS` or `NINE_ACTIONS`.

    Returns:
      The share; 1 where no cell is navigable.
    """
    navigable = jnp.isfinite(true)
    same = navigable & (best_actions(predicted, actions) == best_actions(true, actions))
    count = jnp.sum(navigable)
    return jnp.where(count > 0, jnp.sum(same) / jnp.maximum(count, 1), 1.0)
