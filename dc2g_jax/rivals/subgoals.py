"""Connected pieces of the frontier as subgoals, the ways between them, and planners that choose the first of them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import Belief, Pose, bitboard, poses, search
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, at_cells, frontiers, predicted, unseen

#: Pieces of the frontier that are looked at, at most. Plans are made over all orders of them.
MOST_REGIONS = 5


class Regions(NamedTuple):
    """Pieces of the frontier, each with its best cell, the one of lowest cost.

    Attributes:
      present: whether there are so many pieces; values of the others do not matter.
      x: column of the best cell.
      y: its row.
      start: actions from the robot to it.
      between: actions from one best cell to another, beginning in heading 0.
    """

    present: Bool[Array, "region *batch"]
    x: Int[Array, "region *batch"]
    y: Int[Array, "region *batch"]
    start: Float[Array, "region *batch"]
    between: Float[Array, "region region *batch"]

    def at(self, values: Array) -> Array:
        """The values `[... h w *batch]` at the best cells, `[... region *batch]`."""
        return at_cells(values, self.x, self.y)

    def score(self, values: Float[Array, "region *batch"], belief: Belief) -> PoseValues:
        """Scores of all poses: the value of the region on its best cell, infinity elsewhere."""
        # Without the barrier, XLA would compute the values again for every cell.
        values = jax.lax.optimization_barrier(values)
        score = jnp.full((belief.height, belief.width, *belief.pose.x.shape), jnp.inf)
        rows, columns = (
            index.reshape(*index.shape, *(1 for _ in belief.pose.x.shape))
            for index in jnp.indices((belief.height, belief.width))
        )
        for number in range(MOST_REGIONS):
            here = (rows == self.y[number]) & (columns == self.x[number]) & self.present[number]
            score = jnp.where(here, values[number], score)
        return jnp.broadcast_to(score, (poses.HEADINGS, *score.shape))


def find_regions(belief: Belief, situation: Situation, cost: Float[Array, "h w *batch"]) -> Regions:
    """The pieces of the frontier whose best cells have the lowest cost, in its order.

    Frontier cells belong together if at most one cell lies between them.

    Args:
      belief: belief of the robot.
      situation: what the planner chooses from.
      cost: cost of every cell.
    """
    left = frontiers.frontier_cells(belief, situation.reachable) & poses.occupied(situation.candidates)
    found = []
    for _ in range(MOST_REGIONS):
        open_cells = bitboard.unpack(left, belief.width)
        flat = jnp.where(open_cells, cost, jnp.inf).reshape(-1, *cost.shape[2:])
        y, x = jnp.divmod(jnp.argmin(flat, axis=0).astype(jnp.int32), belief.width)
        found.append((~bitboard.is_empty(left), x, y))
        seed = bitboard.single(x, y, *left.shape[:2])
        left = left & ~bitboard.flood(seed, left | bitboard.neighbors(left))
    present, x, y = (jnp.stack(values) for values in zip(*found, strict=True))
    actions = jnp.min(jnp.where(situation.distance >= 0, situation.distance, situation.distance.size), axis=0)
    # One search for all regions: their axis is the last of the batch.
    last = [jnp.moveaxis(values, 0, -1) for values in (x, y)]
    ground = jnp.broadcast_to(situation.reachable[..., None], (*situation.reachable.shape, MOST_REGIONS))
    ways = search.distances(Pose(last[0], last[1], jnp.zeros_like(last[0])), ground, belief.width)
    ways = jnp.min(jnp.where(ways >= 0, ways, situation.distance.size), axis=0)
    between = jnp.stack([at_cells(ways[..., number], x, y) for number in range(MOST_REGIONS)])
    return Regions(present, x, y, at_cells(actions, x, y).astype(jnp.float32), between.astype(jnp.float32))


def expected_costs(
    regions: Regions, success: Float[Array, "region *batch"], gain: Float[Array, "region *batch"], failure: float
) -> Float[Array, "region *batch"]:
    """Expected cost of each first subgoal, if the others follow in the best order (Stein et al. 2018, equation 5).

    A subgoal leads to the goal with some probability and at some cost; else it costs something to find out, and the
    robot goes on to the next. When none is left, nothing more is added.

    Args:
      regions: the subgoals. The cost of those that are not present is infinite.
      success: probability that the subgoal leads to the goal.
      gain: cost from the subgoal to the goal, if it does.
      failure: cost to find out that it does not.
    """
    present, _, _, start, between = regions
    count = len(start)

    def by_way_of(number: int, way: Array, after: Array) -> Array:
        cost = way + success[number] * gain[number] + (1 - success[number]) * (failure + after)
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
        success, failure = chances(regions.at(outcomes), regions.present), self.failure * self.rules.sensing.radius
        return regions.score(expected_costs(regions, success, regions.at(mean), failure), belief)


def sampled_cells(weights: Float[Array, "cell *batch"], count: int) -> Int[Array, "sample *batch"]:
    """Cells drawn in proportion to their weights, at even spacing (systematic sampling), without random numbers."""
    sums = jnp.cumsum(weights, axis=0)
    levels = ((jnp.arange(count) + 0.5) / count).reshape(-1, *(1 for _ in sums.shape)) * sums[-1]
    return jnp.minimum(jnp.sum(sums <= levels, axis=1), len(weights) - 1).astype(jnp.int32)


def rollout_costs(
    regions: Regions, there: Float[Array, "sample region *batch"], failure: float
) -> Float[Array, "region *batch"]:
    """Mean cost over the samples of a search that begins in each region and goes on to the nearest one left.

    A sampled goal is found in the region nearest to it.

    Args:
      regions: the regions. The cost of those that are not present is infinite.
      there: cost from each region to each sampled goal.
      failure: cost to find out that the goal is not in a region.
    """
    present, _, _, start, between = regions
    numbers = jnp.arange(len(start)).reshape(-1, *(1 for _ in start.shape[1:]))

    def at(values: Float[Array, "region ..."], region: Int[Array, "*batch"]) -> Array:
        index = jnp.broadcast_to(region, values.shape[1:])
        return jnp.take_along_axis(values, index[None], axis=0)[0]

    def one_sample(there: Float[Array, "region *batch"]) -> Float[Array, "region *batch"]:
        goal_in = jnp.argmin(jnp.where(present, there, jnp.inf), axis=0)

        def beginning_in(first: int) -> Array:
            here, left = jnp.full_like(goal_in, first), present & (numbers != first)
            found = goal_in == first
            cost = start[first] + jnp.where(found, there[first], failure)
            for _ in range(len(start) - 1):
                ways = jnp.where(left, at(between, here), jnp.inf)
                here = jnp.argmin(ways, axis=0)
                left = left & (numbers != here)
                arrives = goal_in == here
                after = jnp.where(arrives, at(there, here), failure)
                cost += jnp.where(found, 0, jnp.min(ways, axis=0) + after)
                found = found | arrives
            return jnp.where(present[first], cost, jnp.inf)

        return jnp.stack([beginning_in(first) for first in range(len(start))])

    return jnp.mean(jax.vmap(one_sample)(there), axis=0)


@struct.dataclass
class SampledGoals(ChoosingPlanner):
    """The piece of the frontier from which simulated searches find sampled goals soonest.

    After Silver and Veness, "Monte-Carlo planning in large POMDPs" (POMCP, NeurIPS 2010): samples of the hidden state
    are played through from every first choice, by a simple policy. There, a tree grows with the simulations; here only
    the first choice is compared. A sample is the place of a goal, not a whole map: an unobserved cell, the likelier the
    less the estimator expects it to cost from there. In a simulation, the robot finds the goal in the piece of the
    frontier that is nearest to it, as the crow flies; else it goes on to the nearest piece left.

    Attributes:
      estimator: predicts costs-to-go in cells.
      samples: number of sampled goals.
      temperature: cost that lowers the probability of a cell to 1 / e, in cells.
      failure: cost of a search in vain, in sensing ranges.
    """

    estimator: Estimator = struct.field(kw_only=True)
    replan_fraction: float = struct.field(pytree_node=False, default=1.0)
    samples: int = struct.field(pytree_node=False, default=16)
    temperature: float = struct.field(pytree_node=False, default=4.0)
    failure: float = struct.field(pytree_node=False, default=2.0)

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """The mean cost of the simulations, at the best cell of each piece of the frontier."""
        mean = jnp.mean(predicted(self.estimator, belief, situation.estimator), axis=0)
        regions = find_regions(belief, situation, mean + jnp.min(situation.distance, axis=0))
        least = jnp.min(mean, axis=(0, 1))
        unknown = bitboard.unpack(unseen(belief), belief.width)
        weights = jnp.where(unknown, jnp.exp((least - mean) / self.temperature), 0)
        y, x = jnp.divmod(sampled_cells(weights.reshape(-1, *least.shape), self.samples), belief.width)
        there = (jnp.abs(x[:, None] - regions.x) + jnp.abs(y[:, None] - regions.y)).astype(jnp.float32)
        return regions.score(rollout_costs(regions, there, self.failure * self.rules.sensing.radius), belief)
