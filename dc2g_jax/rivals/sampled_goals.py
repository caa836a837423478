"""Rollouts on samples: search for goals in likely places, in imagination, and do what found them soonest."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.estimation import Estimator
from dc2g_jax.grid import Belief, bitboard
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation, predicted, unseen
from dc2g_jax.rivals.regions import find_regions


def sampled_cells(weights: Float[Array, "cell *batch"], count: int) -> Int[Array, "sample *batch"]:
    """Cells drawn in proportion to their weights, at even spacing (systematic sampling), without random numbers."""
    sums = jnp.cumsum(weights, axis=0)
    levels = ((jnp.arange(count) + 0.5) / count).reshape(-1, *(1 for _ in sums.shape)) * sums[-1]
    return jnp.minimum(jnp.sum(sums <= levels, axis=1), len(weights) - 1).astype(jnp.int32)


def rollout_costs(
    start: Float[Array, "region *batch"],
    between: Float[Array, "region region *batch"],
    there: Float[Array, "sample region *batch"],
    failure_cost: float,
    present: Bool[Array, "region *batch"],
) -> Float[Array, "region *batch"]:
    """Mean cost over the samples of a search that begins in each region and goes on to the nearest one left.

    A sampled goal is found in the region nearest to it.

    Args:
      start: cost from the robot to each region.
      between: cost from one region to another.
      there: cost from each region to each sampled goal.
      failure_cost: cost to find out that the goal is not in a region.
      present: whether the region exists. The cost of others is infinite.
    """
    regions = jnp.arange(len(start)).reshape(-1, *(1 for _ in start.shape[1:]))

    def at(values: Float[Array, "region ..."], region: Int[Array, "*batch"]) -> Array:
        index = jnp.broadcast_to(region, values.shape[1:])
        return jnp.take_along_axis(values, index[None], axis=0)[0]

    def one_sample(there: Float[Array, "region *batch"]) -> Float[Array, "region *batch"]:
        goal_in = jnp.argmin(jnp.where(present, there, jnp.inf), axis=0)

        def search(first: int) -> Array:
            here, left = jnp.full_like(goal_in, first), present & (regions != first)
            found = goal_in == first
            cost = start[first] + jnp.where(found, there[first], failure_cost)
            for _ in range(len(start) - 1):
                ways = jnp.where(left, at(between, here), jnp.inf)
                here = jnp.argmin(ways, axis=0)
                left = left & (regions != here)
                arrives = goal_in == here
                after = jnp.where(arrives, at(there, here), failure_cost)
                cost += jnp.where(found, 0, jnp.min(ways, axis=0) + after)
                found = found | arrives
            return jnp.where(present[first], cost, jnp.inf)

        return jnp.stack([search(first) for first in range(len(start))])

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
        failure = self.failure * self.rules.sensing.radius
        return regions.score(rollout_costs(regions.start, regions.between, there, failure, regions.present), belief)
