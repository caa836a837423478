"""Planners behind one small protocol: `init` once per world, `plan` once per step.

Worlds, beliefs and states are those of one robot or of a batch, whose axes come last.

A planner is a frozen dataclass and a pytree: what it learned (an estimator's weights) are its leaves, what it obeys
(rules) is static. So one compiled program serves every checkpoint of the same architecture.
"""

from typing import Any, ClassVar, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.estimation.estimators import Estimator, extent_of, update_estimates
from dc2g_jax.grid import bitboard, poses, search
from dc2g_jax.grid.bitboard import Board
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import PoseSet, every_heading
from dc2g_jax.grid.world import World
from dc2g_jax.planning import frontiers
from dc2g_jax.planning.rules import Rules
from dc2g_jax.planning.selection import ENDLESS, ExpectedCost, Patience, Selection

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
    """What a rollout asks of a planner. Both methods are pure and traced.

    Attributes:
      robots_a_core: how many robots side by side suit one core of a CPU.
      robots_on_large_maps: the same where the boards of so many do not stay in its caches.
    """

    robots_a_core: ClassVar[int]
    robots_on_large_maps: ClassVar[int]

    def init(self, world: World) -> Any:
        """The planner's state at the start of an episode in `world`.

        Only planners that know the map ahead of time (`Oracle`, an exact estimator) may read the world.
        """
        ...

    def plan(self, belief: Belief, state: Any) -> tuple[Plan, Any]:
        """Decide the next action from what has been observed."""
        ...


class MapRevisingPlanner(Planner, Protocol):
    """A planner that also serves where cells of the map may change their class, as a camera's do."""

    def revised(self, state: Any, changed: Board) -> Any:
        """What of a state still holds on a map where these cells have another class than at the last decision."""
        ...


@struct.dataclass
class Oracle:
    """Shortest plan to the nearest goal on the whole map: the lower bound every planner is measured against."""

    #: Many robots fill a core's vector lanes, and so do the rows of one; the numbers between do neither.
    robots_a_core: ClassVar[int] = 32
    robots_on_large_maps: ClassVar[int] = 1

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

    def revised(self, state: tuple[Board, Board], changed: Board) -> tuple[Board, Board]:
        """All of it: an oracle goes by the world."""
        return state


def reachable_cells(belief: Belief, before: Board) -> Board:
    """Reachable cells now (Algorithm 2, line 4), grown from those reachable a step before: ground is never lost."""
    robot = bitboard.single(belief.pose.x, belief.pose.y, *before.shape[:2])
    return bitboard.flood(robot | before, belief.traversable)


def _explore_or_finish(belief: Belief, reachable: Board, subgoals: PoseSet, rules: Rules) -> Plan:
    """Algorithm 2 once the subgoal is chosen: go to the goal if it is reachable, else explore.

    Gives up where there is no way to either: nothing is left to explore, or an estimate is no number.
    """
    goals = reachable & belief.goals
    goal_reachable = ~bitboard.is_empty(goals)
    targets = jnp.where(goal_reachable, rules.goal_poses(belief, goals, reachable), subgoals)
    first = search.first_action(belief.pose, targets, reachable)
    mode = jnp.where(first.found, jnp.where(goal_reachable, TO_GOAL, EXPLORE), GAVE_UP).astype(jnp.int32)
    return Plan(action=first.action, mode=mode, length=first.length, subgoals=targets)


@struct.dataclass
class Frontier:
    """Pure exploration: always to the nearest frontier-expanding pose (Yamauchi's frontier, the paper's baseline)."""

    rules: Rules = struct.field(pytree_node=False)
    robots_a_core: ClassVar[int] = Oracle.robots_a_core
    robots_on_large_maps: ClassVar[int] = Oracle.robots_on_large_maps

    def init(self, world: World) -> Board:
        """Nothing is reachable before the first observation."""
        return jnp.zeros_like(world.traversable)

    def plan(self, belief: Belief, state: Board) -> tuple[Plan, Board]:
        """Head for the nearest frontier-expanding pose, or for the goal once it is reachable."""
        reachable = reachable_cells(belief, state)
        candidates = self.rules.frontier_expanding(belief, reachable)
        return _explore_or_finish(belief, reachable, candidates, self.rules), reachable

    def revised(self, state: Board, changed: Board) -> Board:
        """None of it: ground can be lost."""
        return jnp.zeros_like(state)


@struct.dataclass
class DC2G:
    """Deep Cost-to-Go (Algorithm 2): to the frontier-expanding pose that the estimated cost-to-go speaks for.

    Subgoals are the frontier-expanding poses of the rules that reveal something when reached, and where there are none
    of them, all poses that do. So exploration always ends, whatever the rules. (The `complete` rules count no other
    poses in the first place; under the `reference` rules alone a robot can go back and forth for ever between two poses
    that show nothing.)

    By default, selection, rim, gain and patience are the paper's.

    Attributes:
      estimator: partial map in, costs-to-go out, lower is better.
      rules: what is seen and what counts as frontier.
      selection: what makes one subgoal better than another.
      rim_width: subgoals that see something more than so many cells beyond everything observed go before all others.
      views: axes that the map is mirrored along before the estimator is asked, a tuple a view: test-time augmentation
        spread over the steps. New estimates are of one view after the other, and the mean of each view's latest is gone
        by: errors that a network makes in one of them alone are halved, at no more questions. Views other than the map
        as it is are for estimators that read nothing but the map.
      gain_weight: information gain, in units of the score: by so much the score of a cell is lower where all of the
        field of view would be new. While nothing new is seen it stays as it is, so exploration ends all the same. Of
        headings that a cell is reached in as soon, the one that faces the most of what has not been observed is taken,
        where distance counts.
      patience: with places that go on promising a goal.
    """

    estimator: Estimator
    rules: Rules = struct.field(pytree_node=False)
    selection: Selection = struct.field(pytree_node=False, default=ExpectedCost(distance_weight=0.0))
    rim_width: int = struct.field(pytree_node=False, default=0)
    views: tuple[tuple[int, ...], ...] = struct.field(pytree_node=False, default=((),))
    gain_weight: float = struct.field(pytree_node=False, default=0.0)
    patience: Patience = struct.field(pytree_node=False, default=ENDLESS)
    #: A network answers many maps at once in less time each.
    robots_a_core: ClassVar[int] = 64
    robots_on_large_maps: ClassVar[int] = 16

    def init(self, world: World) -> "ExplorationState":
        """Nothing is reachable before the first observation; the estimator sets itself up."""
        nothing = jnp.zeros_like(world.traversable)
        estimator_state = self.estimator.init(world)
        view = jnp.zeros(nothing.shape[2:], jnp.int32)
        estimate = jax.eval_shape(self.estimate, world.terrain, (view, estimator_state))
        return ExplorationState(
            reachable=nothing,
            estimates=jnp.full((len(self.views), *estimate.shape), extent_of(self.estimator).prior, jnp.float32),
            estimated_from=nothing,
            view=view,
            decided_near=jnp.zeros(estimate.shape[1:], jnp.int32),
            estimator=estimator_state,
        )

    def estimate(
        self, terrain: UInt8[Array, "h w *batch"], state: tuple[Int[Array, "*batch"], Any]
    ) -> Float[Array, "kept h w *batch"]:
        """What the selection rule needs of an estimate.

        Args:
          terrain: observed class indices.
          state: which of the views to ask about, and the estimator's state.

        Raises:
          ValueError: the estimator's answer does not have the shape of the map behind an axis of outcomes.
        """
        view, estimator_state = state
        seen_as = terrain
        for number, axes in enumerate(self.views):
            seen_as = jnp.where(view == number, jnp.flip(terrain, axes), seen_as) if axes else seen_as
        costs = self.estimator.estimate(seen_as, estimator_state)
        if costs.shape[1:] != terrain.shape:
            raise ValueError(
                f"{type(self.estimator).__name__} answers with {list(costs.shape)} for a map of {list(terrain.shape)}; "
                "give [outcomes, *shape of the map], with one outcome at least"
            )
        answer = self.selection.summary(costs)
        summary = answer
        for number, axes in enumerate(self.views):
            back = jnp.flip(answer, [1 + axis for axis in axes])
            summary = jnp.where(view == number, back, summary) if axes else summary
        return summary

    def candidates(self, belief: Belief, reachable: Board) -> PoseSet:
        """Poses to choose a subgoal from (Algorithm 2, lines 6 to 8)."""
        revealing = frontiers.complete(belief, reachable, self.rules.sensing)
        preferred = self.rules.frontier_expanding(belief, reachable) & revealing
        candidates = jnp.where(poses.is_empty(preferred), revealing, preferred)
        if self.rim_width:
            opening = frontiers.opening(belief, candidates, self.rules.sensing, self.rim_width)
            candidates = jnp.where(poses.is_empty(opening), candidates, opening)
        return candidates

    def surcharge(
        self, belief: Belief, candidates: PoseSet, decided_near: Int[Array, "h w *batch"]
    ) -> Float[Array, "h w *batch"]:
        """What is added to the selection rule's score of each cell: patience lost, less information to be gained.

        Args:
          belief: what the robot knows.
          candidates: poses to choose from.
          decided_near: decisions made near every cell.
        """
        surcharge = jnp.zeros(decided_near.shape, jnp.float32)
        if self.patience.price:
            surcharge += self.patience.cost(decided_near)
        if self.gain_weight:
            sensing = self.rules.sensing
            of_one_cell = self.gain_weight / len(sensing.offsets[0])
            surcharge -= of_one_cell * frontiers.information_gain(belief, candidates, sensing)
        return surcharge

    def preferred(self, belief: Belief, nearest: PoseSet) -> PoseSet:
        """Of each cell's nearest candidates those to head for, should it be that cell."""
        return frontiers.facing_most(belief, nearest) if self.gain_weight else nearest

    def plan(self, belief: Belief, state: "ExplorationState") -> "tuple[Plan, ExplorationState]":
        """Head for the most promising frontier-expanding pose, or for the goal once it is reachable."""
        reachable = reachable_cells(belief, state.reachable)
        candidates = self.candidates(belief, reachable)
        undecided = ~poses.is_empty(candidates) & ~bitboard.intersects(reachable, belief.goals)
        # An estimate stands until something new is seen; robots that do not explore ask for none.
        outdated = undecided & ~bitboard.is_empty(belief.seen ^ state.estimated_from)
        asked_about = state.view, state.estimator
        extent = extent_of(self.estimator)
        latest = update_estimates(self.estimate, outdated, belief, asked_about, state.estimates[0], extent)[None]
        first = bitboard.is_empty(state.estimated_from)
        estimates = jnp.where(outdated, jnp.concatenate([latest, state.estimates[:-1]]), state.estimates)
        # The first answer stands for all views.
        estimates = jnp.where(first, latest, estimates)
        estimated_from = jnp.where(outdated, belief.seen, state.estimated_from)
        view = jnp.where(outdated, (state.view + 1) % len(self.views), state.view)
        nearest, lengths = candidates, jnp.int32(0)
        if self.selection.distance_weight:
            free = jnp.where(undecided, reachable, jnp.uint32(0))
            nearest, lengths = search.nearest_headings(belief.pose, candidates, free, belief.width)
            nearest = self.preferred(belief, nearest)
        decided_near = state.decided_near
        if self.patience.price:
            decided_near = decided_near + self.patience.near(belief.pose, belief.height, belief.width)
        # What subgoals are compared by, the lowest wins (Algorithm 2, line 11).
        score = self.selection(jnp.mean(estimates, axis=0), lengths) + self.surcharge(belief, candidates, decided_near)
        # Without a current estimate all candidates are equal, and of equal ones the plan goes to the nearest.
        subgoals = jnp.where(undecided, nearest & _lowest(score, poses.occupied(nearest), belief.width), candidates)
        plan = _explore_or_finish(belief, reachable, subgoals, self.rules)
        return plan, ExplorationState(reachable, estimates, estimated_from, view, decided_near, state.estimator)

    def revised(self, state: "ExplorationState", changed: Board) -> "ExplorationState":
        """All but the ground, which can be lost; the estimator is asked anew where what it was told has changed."""
        return state._replace(reachable=jnp.zeros_like(state.reachable), estimated_from=state.estimated_from & ~changed)


class ExplorationState(NamedTuple):
    """What DC2G keeps from one step to the next.

    Attributes:
      reachable: reachable cells at the last step.
      estimates: what the selection rule needs of the costs-to-go last estimated, of each view, the newest first.
      estimated_from: cells that had been observed when the newest was made.
      view: which one is to be asked about next.
      decided_near: how many decisions were made near each cell, where patience has an end.
      estimator: the estimator's own state.
    """

    reachable: Board
    estimates: Float[Array, "views kept h w *batch"]
    estimated_from: Board
    view: Int[Array, "*batch"]
    decided_near: Int[Array, "h w *batch"]
    estimator: Any


def _lowest(score: Float[Array, "h w *batch"], cells: Board, width: int) -> Board:
    """The cells of lowest score (Algorithm 2, line 11). Equal ones all stay: the plan goes to the nearest."""
    chosen_from = bitboard.unpack(cells, width)
    score = jnp.where(chosen_from, score, jnp.inf)
    return bitboard.pack(chosen_from & (score == jnp.min(score, axis=(0, 1))))
