"""Rules that select a subgoal from estimated costs (Algorithm 2, line 11, and alternatives)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from jaxtyping import Array, Float, Int

_Summary = TypeVar("_Summary", bound=Callable[..., Any])


def linear(summary: _Summary) -> _Summary:
    """Mark a `Selection.summary` that is a weighted sum of the outcomes, with the same weights for every cell.

    A network then computes the sum in its last layer, which is faster.
    """
    summary.linear = True  # type: ignore[attr-defined]
    return summary


def mean_of(values: Sequence[Array] | Array) -> Array:
    """The mean of arrays of one shape, or along the first axis.

    Added one by one: XLA has no code for a sum of floats along an axis within an operation.
    """
    return sum(values[1:], values[0]) / len(values)


class Selection:
    """Scores subgoals; the lowest score wins. Hashable, so that it can be a static argument of `jit`.

    Attributes:
      distance_weight: cost of an action on the path to a subgoal, in units of the cost-to-go. 0 ignores the distance,
        as in the paper.
    """

    distance_weight: float

    @linear
    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """The part of an estimate that scores need, for any pose of the robot: the mean. The planner stores it.

        Args:
          costs: equally likely costs-to-go of every cell, in ascending order.
        """
        return mean_outcome(costs)

    def __call__(
        self, summary: Float[Array, "kept h w *batch"], distance: Int[Array, "..."]
    ) -> Float[Array, "h w *batch"]:
        """Score of each cell as a subgoal: the cost that the summary holds, plus weighted distance.

        Args:
          summary: summary of the estimate.
          distance: actions from the robot to every cell; arbitrary if `distance_weight` is 0.
        """
        return summary[0] + self.distance_weight * distance


@linear
def mean_outcome(costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "1 h w *batch"]:
    """The mean, as a summary."""
    return mean_of(costs)[None]


def only_outcome(costs: Float[Array, "1 h w *batch"]) -> Float[Array, "1 h w *batch"]:
    """The costs themselves: the summary where the estimator has already summarized them."""
    return costs


@dataclasses.dataclass(frozen=True)
class ExpectedCost(Selection):
    """Mean cost-to-go plus weighted distance: distant subgoals must promise more than close ones.

    Weight 0 is the paper's rule (Algorithm 2, line 11).
    """

    distance_weight: float


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
