"""What most rivals share: score the frontier-expanding poses, head for the best, and keep to it for a while."""

import math
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int

from dc2g_jax._src.estimation.estimators import Estimator, update_where
from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import PoseSet, every_heading
from dc2g_jax._src.grid.squares import corner_sums, in_rectangle
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.planning.planners import (
    Ask,
    Assessment,
    SubgoalPlanner,
    explore_or_finish,
    observed_terrain,
    preferred_poses,
)
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.runtime.programs import apart

#: Scores of poses, or values of them.
PoseValues = Float[Array, "heading h w *batch"]


#: Scores that differ by less, relatively, are ties. XLA may compute a score twice and round it otherwise, so that none
#: would be equal to the lowest.
_ROUNDING = 1e-5


class Situation(NamedTuple):
    """What a planner chooses from.

    Attributes:
      reachable: reachable cells.
      candidates: poses to choose from.
      distance: actions from the robot to every pose, -1 for unreachable ones.
      kept: the subgoals chosen before that would still reveal something.
      estimator: state of the estimator, if there is one.
    """

    reachable: Board
    candidates: PoseSet
    distance: Int[Array, "heading h w *batch"]
    kept: PoseSet
    estimator: Any


class Chosen(NamedTuple):
    """State between steps.

    Attributes:
      reachable: reachable cells at the last step.
      subgoals: poses of the lowest score when they were chosen; the plan leads to the nearest.
      chosen_from: cells that had been observed then.
      score: lowest score of a candidate on every cell then; infinity without candidates.
      estimator: state of the estimator, if there is one.
    """

    reachable: Board
    subgoals: PoseSet
    chosen_from: Board
    score: Float[Array, "h w *batch"]
    estimator: Any


def exploring_poses(belief: Belief, reachable: Board, rules: Rules) -> PoseSet:
    """The frontier-expanding poses that reveal something when reached; without any, all poses that do."""
    return preferred_poses(belief, reachable, frontiers.complete(belief, reachable, rules.sensing), rules)


def unknown_share(belief: Belief, radius: int) -> Float[Array, "h w *batch"]:
    """Share of unobserved cells in the square of `2 radius + 1` cells around each cell; none lie off the map."""
    unknown = bitboard.unpack(frontiers.unseen(belief), belief.width)
    y, x = jnp.indices(unknown.shape, jnp.int32)[:2].reshape(2, -1, *unknown.shape[2:])
    around = in_rectangle(corner_sums(unknown), x - radius, y - radius, x + radius + 1, y + radius + 1)
    return around.reshape(unknown.shape).astype(jnp.float32) / (2 * radius + 1) ** 2


def predicted(estimator: Estimator, belief: Belief, state: Any) -> Float[Array, "outcomes h w *batch"]:
    """The estimated costs-to-go of every cell, in cells, for an estimator that reads the whole map."""
    return apart(estimator.estimate, observed_terrain(belief), state).astype(jnp.float32)


@struct.dataclass
class ChoosingPlanner(SubgoalPlanner):
    """Heads for the frontier-expanding pose of the lowest score, or for the goal once it is reachable.

    It keeps to its choice until that pose would reveal nothing more, or enough has been seen since. Nothing is chosen
    anew while nothing new is seen, so exploration ends.

    Attributes:
      rules: field of view and definition of frontiers.
      replan_fraction: share of the cells in the field of view that must be newly seen before the planner chooses anew.
    """

    rules: Rules = struct.field(pytree_node=False)
    replan_fraction: float = struct.field(pytree_node=False, default=math.inf)
    batch_per_core: ClassVar[int] = 8

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """Score of every pose; the lowest of a candidate wins. Values of other poses do not matter."""
        raise NotImplementedError

    def prepare(self, belief: Belief, situation: Situation) -> Any:
        """What is remembered from a choice to the next, in place of the estimator's state; called before the scores."""
        del belief
        return situation.estimator

    def init(self, world: World) -> Chosen:
        """Nothing is reachable before the first observation."""
        nothing, estimator = jnp.zeros_like(world.traversable), getattr(self, "estimator", None)
        score = jnp.full((world.height, world.width, *nothing.shape[2:]), jnp.inf)
        state = () if estimator is None else estimator.init(world)
        return Chosen(nothing, every_heading(nothing), nothing, score, state)

    def choices(self, belief: Belief, reachable: Board) -> PoseSet:
        """See `exploring_poses`."""
        return exploring_poses(belief, reachable, self.rules)

    def ask(self, belief: Belief, state: Chosen) -> Chosen:
        """The state after another choice: the poses of the lowest score."""
        _, (_, reachable, candidates) = self.look(belief, state)
        distance = search.distances(belief.pose, reachable, belief.width)
        situation = Situation(reachable, candidates, distance, state.subgoals & candidates, state.estimator)
        situation = situation._replace(estimator=self.prepare(belief, situation))
        eligible = poses.unpack(candidates, belief.width) & (distance >= 0)
        score = jnp.where(eligible, apart(self.score, belief, situation), jnp.inf)
        lowest = jnp.min(score, axis=(0, 1, 2))
        best = eligible & (score <= lowest + _ROUNDING * (1 + jnp.abs(lowest)))
        return Chosen(reachable, poses.pack(best), belief.seen, jnp.min(score, axis=0), situation.estimator)

    def conclude(self, belief: Belief, state: Chosen, looked: Any, ask: Ask) -> tuple[Assessment, Chosen]:
        """Head for the chosen pose, or for the goal. Candidates and scores are those of the choice."""
        _, (due, reachable, candidates) = looked
        state = update_where(ask, due, belief, state)
        plan = explore_or_finish(belief, reachable, state.subgoals & candidates, self.rules)
        rated = candidates & bitboard.pack(state.score < jnp.inf)
        return Assessment(plan, reachable, rated, state.score), state._replace(reachable=reachable)
