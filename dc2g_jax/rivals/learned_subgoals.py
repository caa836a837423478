"""Learning over subgoals: the order of frontiers with the least expected cost, by Bellman's recursion."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float

from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import Belief
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, predicted
from dc2g_jax.rivals.regions import find_regions


def expected_costs(
    start: Float[Array, "region *batch"],
    between: Float[Array, "region region *batch"],
    success: Float[Array, "region *batch"],
    success_cost: Float[Array, "region *batch"],
    failure_cost: Float[Array, "region *batch"],
    present: Bool[Array, "region *batch"],
) -> Float[Array, "region *batch"]:
    """Expected cost of each first subgoal, if the others follow in the best order (Stein et al. 2018, equation 5).

    A subgoal leads to the goal with some probability and at some cost; else it costs something to find out, and the
    robot goes on to the next. When none is left, nothing more is added.

    Args:
      start: cost from the robot to each subgoal.
      between: cost from one subgoal to another.
      success: probability that the subgoal leads to the goal.
      success_cost: cost from the subgoal to the goal, if it does.
      failure_cost: cost to find out that it does not.
      present: whether the subgoal exists. The cost of others is infinite.
    """
    count = len(start)

    def by_way_of(number: int, way: Array, after: Array) -> Array:
        gained, lost = success[number] * success_cost[number], failure_cost[number] + after
        cost = way + gained + (1 - success[number]) * lost
        return jnp.where(present[number], cost, jnp.inf)

    #: Least expected cost with these subgoals left, from each subgoal.
    left: list[Array] = [jnp.zeros_like(start)]
    for some in range(1, 1 << count):
        members = [number for number in range(count) if some >> number & 1]
        options = [by_way_of(one, between[:, one], left[some ^ (1 << one)][one]) for one in members]
        least = jnp.min(jnp.stack(options), axis=0)
        left.append(jnp.where(jnp.isfinite(least), least, 0))
    full = (1 << count) - 1
    return jnp.stack([by_way_of(one, start[one], left[full ^ (1 << one)][one]) for one in range(count)])


def chances(outcomes: Float[Array, "outcome region *batch"], present: Bool[Array, "region *batch"]) -> Array:
    """Probability of each region to have the lowest cost, if all outcomes are equally likely and independent."""
    costs = jnp.where(present, outcomes, jnp.inf)
    # Whether outcome k of region i is below outcome l of region j; ties count half.
    own, other = costs[:, None, :, None], costs[None, :, None, :]
    below = jnp.mean(jnp.where(own == other, 0.5, own < other), axis=1)
    itself = jnp.eye(outcomes.shape[1]).reshape(1, *below.shape[1:3], *(1 for _ in below.shape[3:]))
    return jnp.where(present, jnp.mean(jnp.prod(jnp.where(itself == 1, 1.0, below), axis=2), axis=0), 0)


@struct.dataclass
class LearnedSubgoals(ChoosingPlanner):
    """The first subgoal of the order of frontiers with the least expected cost.

    After Stein, Bradley and Roy, "Learning over subgoals for efficient navigation of structured, unknown environments"
    (CoRL 2018), and its Bellman recursion. There, a network learned three numbers of each frontier from images: the
    probability that it leads to the goal, and the costs of success and of failure. Here the outcomes of the estimator
    tell the first two, at the best cell of each piece of the frontier: the probability that its cost is the lowest, and
    its mean cost. A failure costs a multiple of the sensing range. At most five pieces are ordered.

    Attributes:
      estimator: predicts costs-to-go in cells, with several outcomes.
      failure: cost of a failure, in sensing ranges.
    """

    estimator: Estimator = struct.field(kw_only=True)
    replan_fraction: float = struct.field(pytree_node=False, default=1.0)
    failure: float = struct.field(pytree_node=False, default=2.0)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """The expected cost at the best cell of each piece of the frontier."""
        outcomes = predicted(self.estimator, belief, situation.estimator)
        mean = jnp.mean(outcomes, axis=0)
        regions = find_regions(belief, situation, mean + jnp.min(situation.distance, axis=0))
        costs = expected_costs(
            regions.start,
            regions.between,
            chances(regions.at(outcomes), regions.present),
            regions.at(mean),
            jnp.full_like(regions.start, self.failure * self.rules.sensing.radius),
            regions.present,
        )
        return regions.score(costs, belief)
