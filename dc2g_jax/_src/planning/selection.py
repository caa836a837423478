"""Rules that select a subgoal from estimated costs (Algorithm 2, line 11, and alternatives)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax._src.grid.poses import Pose

_Summary = TypeVar("_Summary", bound=Callable[..., Any])


class Selection:
    """Scores subgoals; the lowest score wins. Hashable, so that it can be a static argument of `jit`.

    Attributes:
      distance_weight: cost of an action on the path to a subgoal, in units of the cost-to-go. 0 ignores the distance,
        as in the paper.
    """

    distance_weight: float

    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """The part of an estimate that scores need, for any pose of the robot. The planner stores it.

        Args:
          costs: equally likely costs-to-go of every cell, in ascending order.
        """
        raise NotImplementedError

    def __call__(
        self, summary: Float[Array, "kept h w *batch"], distance: Int[Array, "..."]
    ) -> Float[Array, "h w *batch"]:
        """Score of each cell as a subgoal: the cost that the summary holds, plus weighted distance.

        Args:
          summary: summary of the estimate.
          distance: actions from the robot to every cell; arbitrary if `distance_weight` is 0.
        """
        return summary[0] + self.distance_weight * distance


def mean_of(values: Sequence[Array] | Array) -> Array:
    """The mean of arrays of one shape, or along the first axis.

    Added one by one: XLA has no code for a sum of floats along an axis within an operation.
    """
    return sum(values[1:], values[0]) / len(values)


def linear(summary: _Summary) -> _Summary:
    """Mark a `Selection.summary` that is a weighted sum of the outcomes, with the same weights for every cell.

    A network then computes the sum in its last layer, which is faster.
    """
    summary.linear = True  # type: ignore[attr-defined]
    return summary


@dataclasses.dataclass(frozen=True)
class Patience:
    """A penalty for staying near cells that look promising but reveal no goal.

    A network may mistake the back of a house for its front, whatever the robot observes there, and lead it into every
    corner. So each decision near a cell, beyond the first ones, adds to the cell's score, until another place is
    better. A robot that makes progress does not stay anywhere for so long.

    If the penalty is below the selection rule's distance weight, exploration still ends: each action toward a subgoal
    lowers its score by more than the penalty, so the lowest score falls until something is revealed.

    Attributes:
      radius: distance along either axis within which cells are near, in cells.
      decisions: number of decisions without penalty.
      price: penalty of each further decision, in units of the score.
    """

    radius: int
    decisions: int
    price: float

    def near(self, pose: Pose, height: int, width: int) -> Bool[Array, "h w *batch"]:
        """Cells near the robot."""
        rows, columns = (
            jnp.arange(size).reshape(*shape, *(1 for _ in pose.x.shape))
            for size, shape in ((height, (-1, 1)), (width, (1, -1)))
        )
        return (jnp.abs(rows - pose.y) <= self.radius) & (jnp.abs(columns - pose.x) <= self.radius)

    def cost(self, decided_near: Int[Array, "h w *batch"]) -> Float[Array, "h w *batch"]:
        """The penalty of cells, given the number of decisions made near each."""
        return self.price * jnp.maximum(decided_near - self.decisions, 0)


#: No penalty.
ENDLESS = Patience(radius=0, decisions=0, price=0.0)


@dataclasses.dataclass(frozen=True)
class ExpectedCost(Selection):
    """Mean cost-to-go plus weighted distance: distant subgoals must promise more than close ones.

    Weight 0 is the paper's rule (Algorithm 2, line 11).
    """

    distance_weight: float

    @linear
    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """The mean."""
        return mean_of(costs)[None]


@dataclasses.dataclass(frozen=True)
class QuantileCost(Selection):
    """A quantile of the cost-to-go plus weighted distance: risk-averse above 1/2, optimistic below 1/2.

    Attributes:
      level: level of the quantile, 0 to 1 (exclusive). Each of n outcomes represents 1/n of the distribution; the one
        whose part contains the level is used.
      distance_weight: cost of an action on the path.
    """

    level: float
    distance_weight: float

    @linear
    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """The quantile."""
        return costs[int(self.level * len(costs))][None]
