"""Connected pieces of the frontier as subgoals, and the ways between them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.grid import Belief, Pose, bitboard, poses, search
from dc2g_jax.planning import PoseValues, Situation, at_cells, frontiers

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
