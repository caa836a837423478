"""Which subgoal to head for, given what each may cost: selection rules (Algorithm 2, line 11, and beyond)."""

import dataclasses
from typing import Protocol

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.grid.poses import Pose


class Selection(Protocol):
    """Scores subgoals; the lowest score wins. Hashable, so a static value under `jit`.

    Attributes:
      distance_weight: cost of an action on the way to a subgoal, in units of the cost-to-go. With 0 the distance does
        not matter, as in the paper.
    """

    @property
    def distance_weight(self) -> float:
        """See above."""
        ...

    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """What of an estimate is needed for the score, wherever the robot is: what a planner keeps.

        Args:
          costs: equally likely costs-to-go of every cell, ascending.
        """
        ...

    def __call__(
        self, summary: Float[Array, "kept h w *batch"], distance: Int[Array, "..."]
    ) -> Float[Array, "h w *batch"]:
        """Score of heading for each cell.

        Args:
          summary: of the estimate.
          distance: actions from the robot to every cell; any where `distance_weight` is 0.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Patience:
    """How long a robot believes in a place that goes on promising a goal and shows none.

    A network may take the back of a house for its front whatever the robot sees there, and lead it into every corner.
    So each decision made near a cell, beyond the first ones, adds to the cell's score: in the end another place is
    better. A robot that gets along does not stay near anything for so long.

    With a price below the selection rule's distance weight exploration ends as it does without: each action on the way
    takes off more than it adds, so the lowest score falls until something is revealed.

    Attributes:
      radius: what is near, in cells, along either axis.
      decisions: how many are free.
      price: of each further one, in units of the score.
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
        """What is added to the score of a cell near which so many decisions have been made."""
        return self.price * jnp.maximum(decided_near - self.decisions, 0)


#: Patience without end.
ENDLESS = Patience(radius=0, decisions=0, price=0.0)


class _OneCost:
    """One cost for every cell, plus weighted distance."""

    distance_weight: float

    def __call__(
        self, summary: Float[Array, "kept h w *batch"], distance: Int[Array, "..."]
    ) -> Float[Array, "h w *batch"]:
        """Score of heading for each cell."""
        return summary[0] + self.distance_weight * distance


@dataclasses.dataclass(frozen=True)
class ExpectedCost(_OneCost):
    """Mean cost-to-go, plus weighted distance: a subgoal far off must promise more than one close by.

    Weight 0 is the paper's rule (Algorithm 2, line 11).
    """

    distance_weight: float

    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """The mean."""
        return jnp.mean(costs, axis=0, keepdims=True)


@dataclasses.dataclass(frozen=True)
class QuantileCost(_OneCost):
    """A quantile of the cost-to-go, plus weighted distance: above 1/2 averse to risk, below 1/2 optimistic.

    Attributes:
      level: 0 to 1 (exclusive). Of n outcomes, each of which stands for its n-th of the distribution, the one in whose
        part the level lies.
      distance_weight: cost of an action on the way.
    """

    level: float
    distance_weight: float

    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """The quantile."""
        return costs[int(self.level * len(costs))][None]


@dataclasses.dataclass(frozen=True)
class ReservationCost:
    """What is a try worth? The optimal rule for opening boxes of unknown cost one by one (Weitzman 1979).

    Going to a subgoal to find out what it costs is opening a box, at the price of the way there. The reservation cost r
    of a box with price p and random cost C solves E[max(r - C, 0)] = p: where something of cost r was to be had for
    certain, opening it would neither gain nor lose. Opening boxes in the order of their reservation costs is optimal.
    So a subgoal close by that might turn out cheap is tried before one of the same mean that cannot. With one outcome,
    this is `ExpectedCost`.

    For n outcomes in ascending order, r = min over k of (their k smallest added up + n p) / k.
    """

    distance_weight: float

    def summary(self, costs: Float[Array, "outcomes h w *batch"]) -> Float[Array, "kept h w *batch"]:
        """All outcomes."""
        return costs

    def __call__(
        self, summary: Float[Array, "kept h w *batch"], distance: Int[Array, "..."]
    ) -> Float[Array, "h w *batch"]:
        """Score of heading for each cell."""
        outcomes = len(summary)
        price = outcomes * self.distance_weight * distance
        smallest, least = jnp.zeros_like(summary[0]), jnp.full_like(summary[0], jnp.inf)
        for number, cost in enumerate(summary, start=1):
            smallest = smallest + cost
            least = jnp.minimum(least, (smallest + price) / number)
        return least
