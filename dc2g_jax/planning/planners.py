"""Planners behind one small protocol: `init` once per world, `plan` once per step.

`assess` decides as `plan` does, and also says what from.

Worlds, beliefs and states are those of one robot or of a batch, whose axes come last.

A planner is a frozen dataclass and a pytree: what it learned (an estimator's weights) are its leaves, what it obeys
(rules) is static. So one compiled program serves every checkpoint of the same architecture.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.estimation.estimators import Estimates, Estimator, NetworkCostToGo, extent_of, update_estimates
from dc2g_jax.estimation.padding import PaddedNetwork, mirrored
from dc2g_jax.grid import bitboard, poses, search
from dc2g_jax.grid.bitboard import Board
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import Pose, PoseSet, every_heading
from dc2g_jax.grid.terrain import OUTSIDE
from dc2g_jax.grid.world import World
from dc2g_jax.planning import frontiers
from dc2g_jax.planning.nearby import Nearby, nearby
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


@struct.dataclass
class Assessment:
    """One decision, and what it was made from: what recordings, figures and `OnlinePlanner` show.

    Attributes:
      plan: the decision.
      ground: cells that the plan may lead over.
      candidates: poses to choose a subgoal from.
      score: of every cell with a candidate, the lowest wins; `None` where the nearest candidate wins. Without meaning
        where the planner does not explore.
      cost_to_go: the cost-to-go of every cell that the planner goes by, where it does not explore the last one; `None`
        if it goes by none.
    """

    plan: Plan
    ground: Board
    candidates: PoseSet
    score: Float[Array, "h w *batch"] | None = None
    cost_to_go: Float[Array, "h w *batch"] | None = None


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


class AssessingPlanner(Planner, Protocol):
    """A planner that says what its plans are made of."""

    def assess(self, belief: Belief, state: Any) -> tuple[Assessment, Any]:
        """Decide the next action, and say what from. What nobody looks at is not computed where this is compiled."""
        ...

    def plan(self, belief: Belief, state: Any) -> tuple[Plan, Any]:
        """Decide the next action from what has been observed."""
        assessment, state = self.assess(belief, state)
        return assessment.plan, state


class MapRevisingPlanner(Planner, Protocol):
    """A planner that also serves where cells of the map may change their class, as a camera's do."""

    def revised(self, state: Any, changed: Board) -> Any:
        """What of a state still holds on a map where these cells have another class than at the last decision."""
        ...


@struct.dataclass
class Oracle(AssessingPlanner):
    """Shortest plan to the nearest goal on the whole map: the lower bound every planner is measured against."""

    #: Many robots fill a core's vector lanes, and so do the rows of one; the numbers between do neither.
    robots_a_core: ClassVar[int] = 32
    robots_on_large_maps: ClassVar[int] = 1

    def init(self, world: World) -> tuple[Board, Board]:
        """The whole map: traversable cells and goal cells."""
        return world.traversable, world.goals

    def assess(self, belief: Belief, state: tuple[Board, Board]) -> tuple[Assessment, tuple[Board, Board]]:
        """Head for the nearest goal; give up where there is no way. There is nothing to choose."""
        traversable, goals = state
        subgoals = every_heading(goals)
        first = search.first_action(belief.pose, subgoals, traversable)
        mode = jnp.where(first.found, TO_GOAL, GAVE_UP).astype(jnp.int32)
        plan = Plan(action=first.action, mode=mode, length=first.length, subgoals=subgoals)
        return Assessment(plan, traversable, candidates=jnp.zeros_like(subgoals)), state

    def revised(self, state: tuple[Board, Board], changed: Board) -> tuple[Board, Board]:
        """All of it: an oracle goes by the world."""
        return state


def reachable_cells(belief: Belief, before: Board) -> Board:
    """Reachable cells now (Algorithm 2, line 4), grown from those reachable a step before: ground is never lost."""
    robot = bitboard.single(belief.pose.x, belief.pose.y, *before.shape[:2])
    return bitboard.flood(robot | before, belief.traversable)


def assess(planner: Planner, belief: Belief, state: Any, rules: Rules) -> tuple[Assessment, Any]:
    """What a planner decides, and what from.

    Of a planner without `assess`, the candidates are those of the rules, over reachable ground, and the nearest wins.
    So it is where a subclass has a `plan` of its own and inherits `assess`, which then speaks of another plan.
    """
    classes = type(planner).__mro__
    own_assess, own_plan = (
        next((depth for depth, kind in enumerate(classes) if name in vars(kind)), len(classes))
        for name in ("assess", "plan")
    )
    if own_assess <= own_plan:
        return planner.assess(belief, state)  # type: ignore[attr-defined]
    plan, state = planner.plan(belief, state)
    reachable = reachable_cells(belief, jnp.zeros_like(belief.seen))
    return Assessment(plan, reachable, rules.frontier_expanding(belief, reachable)), state


def measured(
    belief: Belief, assessment: Assessment
) -> tuple[Int[Array, "heading h w *batch"], Float[Array, "h w *batch"]]:
    """Actions from the robot to every pose, -1 where there is no way; and scores, NaN on cells without candidates."""
    distance = search.distances(belief.pose, assessment.ground, belief.width)
    candidates = poses.unpack(assessment.candidates, belief.width) & (distance >= 0)
    score = assessment.score
    if score is None:
        score = jnp.min(distance, axis=0, where=candidates, initial=distance.size).astype(jnp.float32)
    return distance, jnp.where(jnp.any(candidates, axis=0), score, jnp.nan)


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
class Frontier(AssessingPlanner):
    """Pure exploration: always to the nearest frontier-expanding pose (Yamauchi's frontier, the paper's baseline)."""

    rules: Rules = struct.field(pytree_node=False)
    robots_a_core: ClassVar[int] = Oracle.robots_a_core
    robots_on_large_maps: ClassVar[int] = Oracle.robots_on_large_maps
    knows_outside: ClassVar[bool] = True

    def init(self, world: World) -> Board:
        """Nothing is reachable before the first observation."""
        return jnp.zeros_like(world.traversable)

    def assess(self, belief: Belief, state: Board) -> tuple[Assessment, Board]:
        """Head for the nearest frontier-expanding pose, or for the goal once it is reachable."""
        near = nearby(belief, state, self.rules)

        def by_the_whole_map() -> tuple[Assessment, Board]:
            reachable = reachable_cells(belief, state)
            candidates = self.rules.frontier_expanding(belief, reachable)
            plan = _explore_or_finish(belief, reachable, candidates, self.rules)
            return Assessment(plan, reachable, candidates), reachable

        def by_what_is_near(near: Nearby) -> tuple[Assessment, Board]:
            candidates = self.rules.frontier_expanding(belief, near.reachable)
            mode = jnp.full_like(near.first.length, EXPLORE)
            plan = Plan(action=near.first.action, mode=mode, length=near.first.length, subgoals=candidates)
            return Assessment(plan, near.reachable, candidates), near.reachable

        if near is None:
            return by_the_whole_map()
        return jax.lax.cond(near.certain, lambda: by_what_is_near(near), by_the_whole_map)

    def revised(self, state: Board, changed: Board) -> Board:
        """None of it: ground can be lost."""
        return jnp.zeros_like(state)


def any_heading(belief: Belief, nearest: PoseSet) -> PoseSet:
    """All of each cell's nearest candidates."""
    del belief
    return nearest


#: Axes that the map is mirrored along, a tuple a view; and what asks about them.
Views = tuple[tuple[int, ...], ...]
Ask = Callable[[UInt8[Array, "h w *batch"]], Estimates]


def in_turn(ask: Ask, terrain: UInt8[Array, "h w *batch"], views: Views, view: Int[Array, "*batch"]) -> Estimates:
    """The answer to the map in the view that is next."""

    def in_view(cells: Array, first: int) -> Array:
        seen_as = cells
        for number, axes in enumerate(views):
            turned = jnp.flip(cells, [first + axis for axis in axes])
            seen_as = jnp.where(view == number, turned, seen_as) if axes else seen_as
        return seen_as

    return in_view(ask(in_view(terrain, 0)), 1)


def at_once(ask: Ask, terrain: UInt8[Array, "h w *batch"], views: Views, view: Int[Array, "*batch"]) -> Estimates:
    """The mean of the answers to the map in all views. The map may fill a part of the grid only."""
    del view
    inside = terrain != OUTSIDE
    answers = [mirrored(ask(mirrored(terrain, axes, inside, 0)), axes, inside, 1) for axes in views]
    return jnp.mean(jnp.stack(answers).astype(jnp.float32), axis=0)


@struct.dataclass
class DC2G(AssessingPlanner):
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
        field of view would be new. While nothing new is seen it stays as it is, so exploration ends all the same.
      headings: of headings that a cell is reached in as soon, those to take, where distance counts: all of them, or
        those that `dc2g_jax.planning.frontiers.facing_most`.
      patience: with places that go on promising a goal.
      asking: `in_turn`, or `at_once` for all views at every question.
      fewest_maps: the estimator is asked about at a time; the last bits of an answer may depend on it.
    """

    estimator: Estimator
    rules: Rules = struct.field(pytree_node=False)
    selection: Selection = struct.field(pytree_node=False, default=ExpectedCost(distance_weight=0.0))
    rim_width: int = struct.field(pytree_node=False, default=0)
    views: Views = struct.field(pytree_node=False, default=((),))
    gain_weight: float = struct.field(pytree_node=False, default=0.0)
    headings: Callable[[Belief, PoseSet], PoseSet] = struct.field(pytree_node=False, default=any_heading)
    patience: Patience = struct.field(pytree_node=False, default=ENDLESS)
    asking: Callable[[Ask, Array, Views, Array], Estimates] = struct.field(pytree_node=False, default=in_turn)
    fewest_maps: int = struct.field(pytree_node=False, default=4)
    #: A network answers many maps at once in less time each.
    robots_a_core: ClassVar[int] = 64
    robots_on_large_maps: ClassVar[int] = 16

    def memoryless(self) -> "DC2G":
        """This planner for one robot, on maps of any size, whose state is new at every step."""
        network = self.estimator
        estimator = PaddedNetwork(network) if isinstance(network, NetworkCostToGo) else network
        return dataclasses.replace(self, estimator=estimator, asking=at_once, fewest_maps=1, patience=ENDLESS)

    def init(self, world: World) -> "ExplorationState":
        """Nothing is reachable before the first observation; the estimator sets itself up."""
        nothing = jnp.zeros_like(world.traversable)
        estimator_state = self.estimator.init(world)
        told = jax.eval_shape(self._told, world.terrain, estimator_state)
        prior = extent_of(self.estimator).prior
        return ExplorationState(
            reachable=nothing,
            estimates=jnp.full((len(self.views), *told.shape), prior, jnp.float32),
            estimated_from=nothing,
            view=jnp.zeros(nothing.shape[2:], jnp.int32),
            decided_near=jnp.zeros(told.shape[1:], jnp.int32),
            estimator=estimator_state,
        )

    def _told(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Estimates:
        """What the selection rule needs of the estimator's answer.

        Args:
          terrain: observed class indices.
          state: the estimator's.

        Raises:
          ValueError: the estimator's answer does not have the shape of the map behind an axis of outcomes.
        """
        costs = self.estimator.estimate(terrain, state)
        if costs.shape[1:] != terrain.shape:
            raise ValueError(
                f"{type(self.estimator).__name__} answers with {list(costs.shape)} for a map of {list(terrain.shape)}; "
                "give [outcomes, *shape of the map], with one outcome at least"
            )
        return self.selection.summary(costs)

    def _estimate(
        self, terrain: UInt8[Array, "h w *batch"], pose: Pose, before: Estimates, state: tuple[Array, Any]
    ) -> Estimates:
        """New estimates of what the estimator is asked about, given which of the views is next and its state."""
        (view, estimator_state), extent = state, extent_of(self.estimator)
        part = extent.part(terrain, pose)
        answer = self.asking(lambda seen_as: self._told(seen_as, estimator_state), part, self.views, view)
        return extent.merged(answer, pose, before)

    def _candidates(self, belief: Belief, reachable: Board) -> PoseSet:
        """Poses to choose a subgoal from (Algorithm 2, lines 6 to 8)."""
        revealing = frontiers.complete(belief, reachable, self.rules.sensing)
        preferred = self.rules.frontier_expanding(belief, reachable) & revealing
        candidates = jnp.where(poses.is_empty(preferred), revealing, preferred)
        if self.rim_width:
            opening = frontiers.opening(belief, candidates, self.rules.sensing, self.rim_width)
            candidates = jnp.where(poses.is_empty(opening), candidates, opening)
        return candidates

    def _penalty(
        self, belief: Belief, candidates: PoseSet, decided_near: Int[Array, "h w *batch"]
    ) -> Float[Array, "h w *batch"]:
        """What is added to the selection rule's score of each cell: patience lost, less information to be gained."""
        penalty = jnp.zeros(decided_near.shape, jnp.float32)
        if self.patience.price:
            penalty += self.patience.cost(decided_near)
        if self.gain_weight:
            sensing = self.rules.sensing
            of_one_cell = self.gain_weight / len(sensing.offsets[0])
            penalty -= of_one_cell * frontiers.information_gain(belief, candidates, sensing)
        return penalty

    def assess(self, belief: Belief, state: "ExplorationState") -> "tuple[Assessment, ExplorationState]":
        """Head for the most promising frontier-expanding pose, or for the goal once it is reachable."""
        reachable = reachable_cells(belief, state.reachable)
        candidates = self._candidates(belief, reachable)
        undecided = ~poses.is_empty(candidates) & ~bitboard.intersects(reachable, belief.goals)
        # An estimate stands until something new is seen; robots that do not explore ask for none.
        outdated = undecided & ~bitboard.is_empty(belief.seen ^ state.estimated_from)
        asked_about = state.view, state.estimator
        latest = update_estimates(
            self._estimate, outdated, belief, asked_about, state.estimates[0], fewest=self.fewest_maps
        )[None]
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
            nearest = self.headings(belief, nearest)
        decided_near = state.decided_near
        if self.patience.price:
            decided_near = decided_near + self.patience.near(belief.pose, belief.height, belief.width)
        # What subgoals are compared by, the lowest wins (Algorithm 2, line 11).
        score = self.selection(jnp.mean(estimates, axis=0), lengths) + self._penalty(belief, candidates, decided_near)
        # Without a current estimate all candidates are equal, and of equal ones the plan goes to the nearest.
        subgoals = jnp.where(undecided, nearest & _lowest(score, poses.occupied(nearest), belief.width), candidates)
        plan = _explore_or_finish(belief, reachable, subgoals, self.rules)
        state = ExplorationState(reachable, estimates, estimated_from, view, decided_near, state.estimator)
        return Assessment(plan, reachable, nearest, score, state.cost_to_go), state

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

    @property
    def cost_to_go(self) -> Float[Array, "h w *batch"]:
        """What is gone by: the mean of the estimates."""
        return jnp.mean(self.estimates, axis=(0, 1))


def _lowest(score: Float[Array, "h w *batch"], cells: Board, width: int) -> Board:
    """The cells of lowest score (Algorithm 2, line 11). Equal ones all stay: the plan goes to the nearest."""
    chosen_from = bitboard.unpack(cells, width)
    score = jnp.where(chosen_from, score, jnp.inf)
    return bitboard.pack(chosen_from & (score == jnp.min(score, axis=(0, 1))))
