"""Planners behind one small protocol: `init` once per world, `plan` once per step.

A planner is a frozen dataclass and a pytree: what it learned (an estimator's weights) are its leaves, what it obeys
(rules) is static. So one compiled program serves every checkpoint of the same architecture.
"""

from typing import Any, Protocol

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Int

from dc2g_jax.estimation.estimators import Estimator
from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.bitboard import Board
from dc2g_jax.grid.poses import PoseSet, every_heading
from dc2g_jax.grid.world import World
from dc2g_jax.gridworld import Belief
from dc2g_jax.planning import frontiers
from dc2g_jax.planning.rules import Rules

#: Plan modes.
EXPLORE, TO_GOAL, GAVE_UP = 0, 1, 2
MODE_NAMES = ("explore", "to_goal", "gave_up")


@struct.dataclass
class Plan:
    """One decision.

    Attributes:
      action: 0 forward, 1 turn left, 2 turn right; without meaning when the planner gave up.
      mode: `EXPLORE`, `TO_GOAL` or `GAVE_UP`.
      length: number of actions to the subgoal.
      subgoals: poses the plan leads into (the nearest of them).
    """

    action: Int[Array, "*batch"]
    mode: Int[Array, "*batch"]
    length: Int[Array, "*batch"]
    subgoals: PoseSet


class Planner(Protocol):
    """What a rollout asks of a planner. Both methods are pure and traced; use `jax.vmap` for many robots."""

    def init(self, world: World) -> Any:
        """The planner's state at the start of an episode in `world`.

        Only planners that know the map ahead of time (`Oracle`, an exact estimator) may read the world.
        """
        ...

    def plan(self, belief: Belief, state: Any) -> tuple[Plan, Any]:
        """Decide the next action from what has been observed."""
        ...


@struct.dataclass
class Oracle:
    """Shortest plan to the nearest goal on the whole map: the lower bound every planner is measured against."""

    def init(self, world: World) -> tuple[Board, Board]:
        """The whole map: traversable cells and goal cells."""
        return world.traversable, world.goals

    def plan(self, belief: Belief, state: tuple[Board, Board]) -> tuple[Plan, tuple[Board, Board]]:
        """First action of the shortest plan; gives up where there is none."""
        traversable, goals = state
        subgoals = every_heading(goals)
        first = search.first_action(belief.pose, subgoals, traversable)
        mode = jnp.where(first.found, TO_GOAL, GAVE_UP).astype(jnp.int32)
        return Plan(action=first.action, mode=mode, length=first.length, subgoals=subgoals), state


def _reachable(belief: Belief, before: Board) -> Board:
    """Reachable cells now (Algorithm 2, line 4), grown from those reachable a step before: ground is never lost."""
    robot = bitboard.single(belief.pose.x, belief.pose.y, *before.shape)
    return bitboard.flood(robot | before, belief.traversable)


def _explore_or_finish(belief: Belief, reachable: Board, candidates: PoseSet, subgoals: PoseSet, rules: Rules) -> Plan:
    """Algorithm 2 once the subgoal is chosen: go to the goal if it is reachable, else explore, else give up."""
    goals = reachable & belief.goals
    goal_reachable = ~bitboard.is_empty(goals)
    targets = jnp.where(goal_reachable, rules.goal_poses(belief, goals, reachable), subgoals)
    first = search.first_action(belief.pose, targets, reachable)
    exploring = jnp.where(bitboard.is_empty(candidates), GAVE_UP, EXPLORE)
    mode = jnp.where(goal_reachable, TO_GOAL, exploring).astype(jnp.int32)
    return Plan(action=first.action, mode=mode, length=first.length, subgoals=targets)


@struct.dataclass
class Frontier:
    """Pure exploration: always to the nearest frontier-expanding pose (Yamauchi's frontier, the paper's baseline)."""

    rules: Rules = struct.field(pytree_node=False)

    def init(self, world: World) -> Board:
        """Nothing is reachable before the first observation."""
        return jnp.zeros_like(world.traversable)

    def plan(self, belief: Belief, state: Board) -> tuple[Plan, Board]:
        """Head for the nearest frontier-expanding pose, or for the goal once it is reachable."""
        reachable = _reachable(belief, state)
        candidates = self.rules.frontier_expanding(belief, reachable)
        return _explore_or_finish(belief, reachable, candidates, candidates, self.rules), reachable


@struct.dataclass
class DC2G:
    """Deep Cost-to-Go (Algorithm 2): to the frontier-expanding pose with the lowest estimated cost-to-go.

    Subgoals are the frontier-expanding poses of the rules that reveal something when reached, and where there are none
    of them, all poses that do. So exploration always ends, whatever the rules. (The `complete` rules count no other
    poses in the first place; under the `reference` rules alone a robot can go back and forth for ever between two poses
    that show nothing.)

    Attributes:
      estimator: partial map in, cost-to-go grid out, lower is better.
      rules: what is seen and what counts as frontier.
      distance_weight: cost added per action of distance to a subgoal. 0 is the paper's rule; with a positive weight
        a subgoal far off must promise more than one close by. In units of the estimate per action.
      patience: actions after which the estimate is no longer trusted and the robot explores what is nearest: an
        estimator that has not led to a goal by then misleads it here. `None` to trust it for ever, as the paper does.
    """

    estimator: Estimator
    rules: Rules = struct.field(pytree_node=False)
    distance_weight: float = struct.field(pytree_node=False, default=0.0)
    patience: int | None = struct.field(pytree_node=False, default=None)

    def init(self, world: World) -> tuple[Board, Any]:
        """Nothing is reachable before the first observation; the estimator sets itself up."""
        return jnp.zeros_like(world.traversable), self.estimator.init(world)

    def plan(self, belief: Belief, state: tuple[Board, Any]) -> tuple[Plan, tuple[Board, Any]]:
        """Head for the most promising frontier-expanding pose, or for the goal once it is reachable."""
        before, estimator_state = state
        reachable = _reachable(belief, before)
        revealing = frontiers.complete(belief, reachable, self.rules.sensing)
        preferred = self.rules.frontier_expanding(belief, reachable) & revealing
        candidates = jnp.where(bitboard.is_empty(preferred), revealing, preferred)
        score = self.estimator.estimate(belief.terrain, estimator_state)[None]
        if self.distance_weight:
            lengths = search.distances(belief.pose, reachable, belief.width)
            score = score + self.distance_weight * lengths
        if self.patience is not None:
            # Of poses with equal scores the plan goes to the nearest.
            score = jnp.where(belief.steps < self.patience, score, 0.0)
        subgoals = _lowest(score, candidates, belief.width)
        plan = _explore_or_finish(belief, reachable, candidates, subgoals, self.rules)
        return plan, (reachable, estimator_state)


def _lowest(score: Array, candidates: PoseSet, width: int) -> PoseSet:
    """The candidates of lowest score (Algorithm 2, line 11). Equal ones all stay: the plan goes to the nearest."""
    is_candidate = bitboard.unpack(candidates, width)
    score = jnp.where(is_candidate, score, jnp.inf)
    return bitboard.pack(is_candidate & (score == jnp.min(score)))
