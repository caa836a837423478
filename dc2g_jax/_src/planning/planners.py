"""Planners: their interface, and those of the paper.

Worlds, beliefs and states are those of one robot or of a batch, whose axes come last.

A planner is a frozen dataclass and a pytree. Learned parameters (an estimator's weights) are its leaves; rules are
static. So one compiled program serves every checkpoint of the same architecture.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax._src.estimation.estimators import Estimates, Estimator, Extent, extent_of, update_where
from dc2g_jax._src.estimation.extents import TownWindow
from dc2g_jax._src.estimation.padding import mirrored, padded
from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief, check_axes, check_poses
from dc2g_jax._src.grid.poses import PoseSet, every_heading
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.streets import in_town
from dc2g_jax._src.grid.terrain import OUTSIDE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.planning.nearby import Decided, nearby
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.planning.selection import ENDLESS, ExpectedCost, Patience, Selection, mean_of
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import apart

#: Plan modes.
EXPLORE, TO_GOAL, GAVE_UP = 0, 1, 2
Mode = Literal["explore", "to_goal", "gave_up"]
MODE_NAMES: tuple[Mode, ...] = get_args(Mode)


@struct.dataclass
class Plan:
    """One decision.

    Attributes:
      action: 0 forward, 1 turn left, 2 turn right; undefined if the planner gave up.
      mode: `EXPLORE`, `TO_GOAL` or `GAVE_UP`.
      length: number of actions to the subgoal.
      subgoals: poses at which the plan may end; it ends at the nearest.
    """

    action: Int[Array, "*batch"]
    mode: Int[Array, "*batch"]
    length: Int[Array, "*batch"]
    subgoals: PoseSet


@struct.dataclass
class Assessment:
    """One decision and its inputs, for recordings, figures and `OnlinePlanner`.

    Attributes:
      plan: the decision.
      ground: cells that the plan may use.
      candidates: candidate poses for the subgoal.
      score: score of every cell with a candidate; the lowest wins. `None` if the nearest candidate wins. Undefined
        while the planner does not explore.
      cost_to_go: the planner's cost-to-go of every cell; the last one while it does not explore. `None` for planners
        without one.
      penalty: part of the score beyond cost-to-go and distance; `None` for planners without one.
    """

    plan: Plan
    ground: Board
    candidates: PoseSet
    score: Float[Array, "h w *batch"] | None = None
    cost_to_go: Float[Array, "h w *batch"] | None = None
    penalty: Float[Array, "h w *batch"] | None = None


#: Gives the estimator's answer for a belief and a planner's state.
Ask = Callable[[Belief, Any], Estimates]


class Planner:
    """The interface of a planner. All methods are pure and traced.

    A class with `init` and `plan` is a planner, whether it derives from this one or not. Everything else may be left
    out. Define one of these; each one calls the next:

    - `plan`, the next action;
    - `assess`, the same with its inputs, for figures, recordings and `OnlinePlanner`;
    - `look`, `ask` and `conclude`, for a planner that asks an estimator now and then. A rollout on a CPU runs each
      robot by itself until it asks, then asks for all robots together: a network needs less time per map in larger
      batches, and everything else is faster for a single robot.

    Attributes:
      batch_per_core: number of robots to simulate side by side on one CPU core. A single one is fastest, except for a
        network.
      knows_outside: whether it takes maps in a larger grid, as `OnlinePlanner` pads them. A planner with an estimator
        takes what the estimator takes.
    """

    batch_per_core: ClassVar[int] = 1
    knows_outside: ClassVar[bool] = False

    def init(self, world: World) -> Any:
        """The planner's state at the start of an episode in `world`.

        Only planners that know the map ahead of time (`Oracle`, an exact estimator) may read the world.
        """
        raise NotImplementedError("a planner needs a method init")

    def plan(self, belief: Belief, state: Any) -> tuple[Plan, Any]:
        """Decide the next action from what has been observed."""
        assessment, state = self.assess(belief, state)
        return assessment.plan, state

    def assess(self, belief: Belief, state: Any) -> tuple[Assessment, Any]:
        """Decide the next action, and return the inputs. Compilation removes unused ones."""
        return self.conclude(belief, state, self.look(belief, state), self.ask)

    def look(self, belief: Belief, state: Any) -> tuple[Bool[Array, "*batch"], Any]:
        """Whether the estimator is asked, and what else the decision depends on but its answer."""
        raise NotImplementedError("a planner needs a method plan")

    def ask(self, belief: Belief, state: Any) -> Estimates:
        """The estimator's answer."""
        raise NotImplementedError("a planner with a method look needs a method ask")

    def conclude(self, belief: Belief, state: Any, looked: Any, ask: Ask) -> tuple[Assessment, Any]:
        """Decide the next action.

        Args:
          belief: what the robot knows.
          state: state of the planner.
          looked: the result of `look`.
          ask: `(belief, state) ->` the estimator's answer.
        """
        raise NotImplementedError("a planner with a method look needs a method conclude")

    def revised(self, state: Any, changed: Board) -> Any:
        """The state without what is invalid after these cells changed their class, as on maps from a camera."""
        raise InputError(f"planner {type(self).__name__}: maps change here, and it has no method revised; define one")

    def memoryless(self) -> "Planner":
        """The planner for a single robot whose state is new at every step; itself unless a subclass defines it."""
        return self


#: A planner: any object with `init` and `plan`, whether it derives from `Planner` or not.
PlannerLike = Any


def _inherits(planner: PlannerLike, *methods: str) -> bool:
    """Whether these methods of a planner are those of `Planner`."""
    return all(getattr(type(planner), method, None) is getattr(Planner, method) for method in methods)


def asks(planner: PlannerLike) -> bool:
    """Whether a planner decides by `look`, `ask` and `conclude`."""
    return _inherits(planner, "plan", "assess")


def assess(planner: PlannerLike, belief: Belief, state: Any, rules: Rules) -> tuple[Assessment, Any]:
    """A planner's decision and its inputs.

    For a planner that defines `plan`, the candidates are those of the rules on reachable ground, and the nearest wins.
    """
    if _inherits(planner, "plan"):
        return planner.assess(belief, state)
    plan, state = planner.plan(belief, state)
    reachable = reachable_cells(belief, jnp.zeros_like(belief.seen))
    return Assessment(plan, reachable, rules.frontier_expanding(belief, reachable)), state


def memoryless(planner: PlannerLike) -> PlannerLike:
    """See `Planner.memoryless`; also for planners that do not derive from `Planner`."""
    return planner.memoryless() if hasattr(planner, "memoryless") else planner


def sensing_of(planner: PlannerLike, given: Kernel | None = None, name: str | None = None) -> Kernel:
    """The field of view of a planner's robots: that of its rules.

    Args:
      planner: the planner.
      given: the field of view of planners without rules, such as `Oracle`; for others, it must be that of the rules.
      name: name of the planner for the message; `None` for that of its class.

    Raises:
      InputError: it is missing or another one.
    """
    rules, who = getattr(planner, "rules", None), f"planner {name or type(planner).__name__!r}"
    sensing = given if rules is None else rules.sensing
    if sensing is None:
        raise InputError(f"{who}: has no rules that tell what its robots see; give sensing")
    if given not in (None, sensing):
        kind = "" if sensing.radius != given.radius else " of another kind"
        raise InputError(
            f"{who}: was made for a field of view of {sensing.radius} cells, and the robots here have one of "
            f"{given.radius}{kind}; make it with the same settings and sensing_range"
        )
    return sensing


def plan_to(belief: Belief, subgoals: PoseSet, ground: Board, mode: int | Int[Array, "*batch"]) -> Plan:
    """A shortest plan over the ground to the nearest subgoal, in this mode; `GAVE_UP` if none can be reached.

    Raises:
      InputError: belief and ground are of different batches.
    """
    check_poses(belief, belief.pose)
    check_axes("cells of ground", ground.shape, *belief.goals.shape)
    first = search.first_action(belief.pose, subgoals, ground)
    mode = jnp.where(first.found, mode, GAVE_UP).astype(jnp.int32)
    return Plan(action=first.action, mode=mode, length=first.length, subgoals=subgoals)


@struct.dataclass
class Oracle(Planner):
    """Shortest plan to the nearest goal on the whole map: the lower bound for all planners."""

    def init(self, world: World) -> tuple[Board, Board]:
        """The whole map: traversable cells and goal cells."""
        return world.traversable, world.goals

    def assess(self, belief: Belief, state: tuple[Board, Board]) -> tuple[Assessment, tuple[Board, Board]]:
        """Head for the nearest goal; give up if it is unreachable. There are no candidates."""
        traversable, goals = state
        plan = plan_to(belief, every_heading(goals), traversable, TO_GOAL)
        return Assessment(plan, traversable, candidates=jnp.zeros_like(plan.subgoals)), state

    def revised(self, state: tuple[Board, Board], changed: Board) -> tuple[Board, Board]:
        """The whole state, which only depends on the world."""
        return state


def observed_terrain(belief: Belief) -> UInt8[Array, "h w *batch"]:
    """What an estimator is asked about: observed class indices, and `OUTSIDE` beyond the map."""
    terrain = belief.terrain
    if belief.outside is not None:
        terrain = jnp.where(bitboard.unpack(belief.outside, belief.width), jnp.uint8(OUTSIDE), terrain)
    # Without the barrier, XLA would unpack every cell again for each of a network's one-hot inputs.
    return jax.lax.optimization_barrier(terrain)


def reachable_cells(belief: Belief, before: Board) -> Board:
    """Reachable cells (Algorithm 2, line 4), grown from those of the previous step: ground is never lost.

    Raises:
      InputError: belief and cells are of different batches.
    """
    check_poses(belief, belief.pose)
    check_axes("reachable cells of the state", before.shape, *belief.goals.shape)
    robot = bitboard.single(belief.pose.x, belief.pose.y, *before.shape[:2])
    return bitboard.flood(robot | before, belief.traversable)


def distances_and_scores(
    belief: Belief, assessment: Assessment
) -> tuple[Int[Array, "heading h w *batch"], Float[Array, "h w *batch"]]:
    """Actions from the robot to every pose, -1 for unreachable poses; and scores, NaN for cells without candidates."""
    distance = search.distances(belief.pose, assessment.ground, belief.width)
    candidates = poses.unpack(assessment.candidates, belief.width) & (distance >= 0)
    score = assessment.score
    if score is None:
        score = jnp.min(distance, axis=0, where=candidates, initial=distance.size).astype(jnp.float32)
    return distance, jnp.where(jnp.any(candidates, axis=0), score, jnp.nan)


def _subgoals(
    belief: Belief, reachable: Board, candidates: PoseSet, rules: Rules
) -> tuple[PoseSet, Int[Array, "*batch"]]:
    """Poses to head for (Algorithm 2, lines 5 and 9): those of the goal if it is reachable, else the candidates."""
    goals = reachable & belief.goals
    goal_reachable = ~bitboard.is_empty(goals)
    poses_of_goal = rules.goal_poses(belief, goals, reachable)
    return jnp.where(goal_reachable, poses_of_goal, candidates), jnp.where(goal_reachable, TO_GOAL, EXPLORE)


def explore_or_finish(belief: Belief, reachable: Board, candidates: PoseSet, rules: Rules) -> Plan:
    """Algorithm 2 after the choice of the subgoal: go to the goal if it is reachable, else explore.

    Gives up if neither is reachable: nothing is left to explore, or an estimate is NaN.
    """
    subgoals, mode = _subgoals(belief, reachable, candidates, rules)
    return plan_to(belief, subgoals, reachable, mode)


@struct.dataclass
class Frontier(Planner):
    """Frontier exploration: go to the nearest frontier-expanding pose (Yamauchi's frontier, the paper's baseline)."""

    rules: Rules = struct.field(pytree_node=False)
    knows_outside: ClassVar[bool] = True

    def init(self, world: World) -> Board:
        """Nothing is reachable before the first observation."""
        return jnp.zeros_like(world.traversable)

    def decide(self, belief: Belief, before: Board) -> Decided:
        """The decision by all of a map, given cells that are known to be reachable."""
        reachable = reachable_cells(belief, before)
        plan = explore_or_finish(belief, reachable, self.rules.frontier_expanding(belief, reachable), self.rules)
        return Decided(plan.action, plan.mode, plan.length, reachable)

    def assess(self, belief: Belief, state: Board) -> tuple[Assessment, Board]:
        """Head for the nearest frontier-expanding pose, or for the goal once it is reachable."""
        near = nearby(belief, state, self.decide, self.rules.reach)
        if near is None:
            decided = self.decide(belief, state)
        else:
            there, certain = near
            certain &= there.mode[0] != GAVE_UP
            decided = jax.lax.cond(certain, lambda: there, lambda: self.decide(belief, there.reachable))
        reachable = decided.reachable
        candidates = self.rules.frontier_expanding(belief, reachable)
        subgoals, _ = _subgoals(belief, reachable, candidates, self.rules)
        plan = Plan(decided.action, decided.mode, decided.length, subgoals)
        return Assessment(plan, reachable, candidates), reachable

    def revised(self, state: Board, changed: Board) -> Board:
        """An empty state, since ground can be lost."""
        return jnp.zeros_like(state)


def any_heading(belief: Belief, nearest: PoseSet) -> PoseSet:
    """All of each cell's nearest candidates."""
    del belief
    return nearest


#: Axes to mirror the map along, one tuple per view.
Views = tuple[tuple[int, ...], ...]


def in_view(cells: Array, views: Views, view: Int[Array, "*batch"], first: int) -> Array:
    """Grids whose rows are on the axis `first`, as they are in view number `view`; mirroring is its own inverse."""
    seen_as = cells
    for number, axes in enumerate(views):
        turned = jnp.flip(cells, [first + axis for axis in axes])
        seen_as = jnp.where(view == number, turned, seen_as) if axes else seen_as
    return seen_as


def at_once(ask: Callable[[Array], Estimates], terrain: UInt8[Array, "h w *batch"], views: Views) -> Estimates:
    """The mean of the estimates for all views of the map. The grid may be larger than the map."""
    inside = terrain != OUTSIDE
    answers = [mirrored(ask(mirrored(terrain, axes, inside, 0)), axes, inside, 1) for axes in views]
    return jnp.mean(jnp.stack(answers).astype(jnp.float32), axis=0)


@struct.dataclass
class DC2G(Planner):
    """Deep Cost-to-Go (Algorithm 2): go to the frontier-expanding pose with the lowest estimated cost-to-go.

    Candidates are the frontier-expanding poses of the rules that reveal something when reached; if there are none, all
    poses that do. So exploration always ends, under all rules. (The `complete` rules have no other poses; with the
    `reference` rules alone, a robot can move back and forth forever between two poses that reveal nothing.)

    The defaults of selection, rim, gain and patience are the paper's.

    Attributes:
      estimator: maps a partial map to costs-to-go; lower is better.
      rules: field of view and definition of frontiers.
      selection: rule that scores subgoals.
      rim_width: candidates that see a cell more than this many cells beyond everything observed take precedence.
      views: axes to mirror the map along for the estimator, one tuple per view: test-time augmentation spread over
        steps. New estimates alternate between the views, and the planner uses the mean of each view's latest estimate.
        This halves errors that a network makes in only one view, at no extra cost. Views other than the original map
        are for estimators that only read the map.
      gain_weight: weight of the information gain: a cell's score is lower by this much if its whole field of view would
        be new. The gain does not change while nothing new is seen, so exploration still ends.
      headings: selects among the nearest headings of a cell, if the score depends on distance: all of them, or
        `planning.frontiers.facing_most`.
      patience: penalty for staying near promising cells that reveal no goal.
      replan_fraction: share of the cells in the field of view that must be newly seen before the planner decides anew;
        it also does when its subgoal reveals nothing more. 0 to decide anew as soon as any cell is.
      town_side: side of the square around the robot that the estimator is given in a town, in cells, see
        `estimation.extents.TownWindow`; `None` for the estimator's own extent everywhere.
      memory: whether the state is kept between steps. If not, for a single robot, each estimate averages all views.
    """

    estimator: Estimator
    rules: Rules = struct.field(pytree_node=False)
    selection: Selection = struct.field(pytree_node=False, default=ExpectedCost(distance_weight=0.0))
    rim_width: int = struct.field(pytree_node=False, default=0)
    views: Views = struct.field(pytree_node=False, default=((),))
    gain_weight: float = struct.field(pytree_node=False, default=0.0)
    headings: Callable[[Belief, PoseSet], PoseSet] = struct.field(pytree_node=False, default=any_heading)
    patience: Patience = struct.field(pytree_node=False, default=ENDLESS)
    replan_fraction: float = struct.field(pytree_node=False, default=0.0)
    town_side: int | None = struct.field(pytree_node=False, default=None)
    memory: bool = struct.field(pytree_node=False, default=True)
    batch_per_core: ClassVar[int] = 16

    def memoryless(self) -> "DC2G":
        """This planner for a single robot with a new state at every step, on maps of any size."""
        return dataclasses.replace(
            self, estimator=padded(self.estimator), patience=ENDLESS, town_side=None, memory=False
        )

    def init(self, world: World) -> "ExplorationState":
        """Nothing is reachable before the first observation. The estimator initializes its own state."""
        nothing = jnp.zeros_like(world.traversable)
        estimator_state = self.estimator.init(world)
        told = jax.eval_shape(self._told, world.terrain, estimator_state)
        prior = self._extent(world).prior
        choice = Choice(
            estimates=tuple(jnp.full(told.shape, prior, jnp.float32) for _ in self.views),
            estimated_from=nothing,
            view=jnp.zeros(nothing.shape[2:], jnp.int32),
            subgoals=every_heading(nothing),
        )
        return ExplorationState(nothing, choice, jnp.zeros(told.shape[1:], jnp.int32), estimator_state)

    def _extent(self, world: World) -> Extent:
        """The part of the map that the estimator is given; a world stands for a belief at the start of an episode."""
        side = self.town_side
        if side is None or max(world.height, world.width) <= side:
            return extent_of(self.estimator)
        zooms = in_town(world) if isinstance(world, Belief) else jnp.zeros(world.goals.shape[2:], bool)
        return TownWindow(zooms, side)

    def _told(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Estimates:
        """The selection rule's summary of the estimate.

        Args:
          terrain: observed class indices.
          state: state of the estimator.

        Raises:
          InputError: the estimate does not have the shape `[outcomes, *shape of the map]`.
        """
        estimator, summary = self.estimator, self.selection.summary
        if getattr(summary, "linear", False) and hasattr(estimator, "summarized"):
            estimator, summary = estimator.summarized(summary), lambda costs: costs
        costs = estimator.estimate(terrain, state)
        if costs.shape[1:] != terrain.shape:
            raise InputError(
                f"{type(self.estimator).__name__} answers with {list(costs.shape)} for a map of {list(terrain.shape)}; "
                "give [outcomes, *shape of the map], with one outcome at least"
            )
        return summary(costs).astype(jnp.float32)

    def _candidates(self, belief: Belief, reachable: Board, revealing: PoseSet) -> PoseSet:
        """Candidate poses for the subgoal (Algorithm 2, lines 6 to 8), of those that reveal something."""
        preferred = self.rules.frontier_expanding(belief, reachable) & revealing
        candidates = jnp.where(poses.is_empty(preferred), revealing, preferred)
        if self.rim_width:
            opening = frontiers.opening(belief, candidates, self.rules.sensing, self.rim_width)
            candidates = jnp.where(poses.is_empty(opening), candidates, opening)
        return candidates

    def _penalty(
        self, belief: Belief, candidates: PoseSet, decided_near: Int[Array, "h w *batch"]
    ) -> Float[Array, "h w *batch"]:
        """The term added to the score of each cell: the penalty of `patience` minus the weighted information gain."""
        penalty = jnp.zeros(decided_near.shape, jnp.float32)
        if self.patience.price:
            penalty += self.patience.cost(decided_near)
        if self.gain_weight:
            sensing = self.rules.sensing
            of_one_cell = self.gain_weight / len(sensing.offsets[0])
            penalty -= of_one_cell * frontiers.information_gain(belief, candidates, sensing)
        return penalty

    def _scored(
        self, belief: Belief, look: "Look", estimate: Estimates
    ) -> tuple[PoseSet, Float[Array, "h w *batch"], Float[Array, "h w *batch"]]:
        """The candidates, the score of each cell with one, and the penalty in it (Algorithm 2, lines 6 to 10)."""
        candidates = nearest = self._candidates(belief, look.reachable, look.revealing)
        lengths = jnp.int32(0)
        if self.selection.distance_weight:
            nearest, lengths = search.nearest_headings(belief.pose, candidates, look.reachable, belief.width)
            nearest = self.headings(belief, nearest)
        cost = self.selection(estimate, lengths)
        penalty = self._penalty(belief, candidates, look.decided_near)
        return nearest, cost + penalty, penalty

    def look(self, belief: Belief, state: "ExplorationState") -> "tuple[Bool[Array, '*batch'], Look]":
        """Whether another choice of the subgoal is due, and what it depends on."""
        reachable = reachable_cells(belief, state.reachable)
        revealing = frontiers.complete(belief, reachable, self.rules.sensing)
        undecided = ~poses.is_empty(revealing) & ~bitboard.intersects(reachable, belief.goals)
        decided_near = state.decided_near
        if self.patience.price:
            decided_near = decided_near + self.patience.near(belief.pose, belief.height, belief.width)
        news = bitboard.count(belief.seen ^ state.choice.estimated_from)
        enough = max(1, round(self.replan_fraction * len(self.rules.sensing.offsets[0])))
        # Robots that do not explore need no subgoal.
        outdated = undecided & ((news >= enough) | poses.is_empty(state.choice.subgoals & revealing))
        return outdated, Look(reachable, revealing, decided_near)

    def ask(self, belief: Belief, state: "ExplorationState") -> Estimates:
        """The selection rule's summary of an estimate, for the next view; without a memory, for all views."""
        part = self._extent(belief).part(observed_terrain(belief), belief.pose)
        told = functools.partial(self._told, state=state.estimator)
        if not self.memory:
            return at_once(told, part, self.views)
        view = state.choice.view
        return in_view(told(in_view(part, self.views, view, 0)), self.views, view, 1)

    def _choose(self, inputs: "tuple[Belief, ExplorationState, Look]", before: "Choice", ask: Ask) -> "Choice":
        """A new estimate, and the subgoals of lowest score with it (Algorithm 2, lines 6 to 11)."""
        belief, _, look = inputs
        choice = self._estimated(inputs, before, ask)
        candidates, score, _ = self._scored(belief, look, choice.estimate)
        return choice._replace(subgoals=_lowest(score, candidates, belief.width))

    def _estimated(self, inputs: "tuple[Belief, ExplorationState, Look]", before: "Choice", ask: Ask) -> "Choice":
        """A new estimate, with the subgoals of before."""
        belief, state, _ = inputs
        latest = self._extent(belief).merged(ask(belief, state), belief.pose, before.estimates[0])
        first = bitboard.is_empty(before.estimated_from)
        # The first estimate stands for all views.
        estimates = (latest, *(jnp.where(first, latest, older) for older in before.estimates[:-1]))
        return before._replace(
            estimates=estimates, estimated_from=belief.seen, view=(before.view + 1) % len(self.views)
        )

    def conclude(
        self, belief: Belief, state: "ExplorationState", looked: "tuple[Bool[Array, '*batch'], Look]", ask: Ask
    ) -> "tuple[Assessment, ExplorationState]":
        """Head for the most promising frontier-expanding pose, or for the goal once it is reachable.

        The scores are the current ones; the subgoal had the lowest when it was chosen.
        """
        make = functools.partial(self._choose if self.memory else self._estimated, ask=ask)
        outdated, look = looked
        choice = update_where(make, outdated, (belief, state, look), state.choice)
        candidates, score, penalty = self._scored(belief, look, choice.estimate)
        if not self.memory:  # the choice is always new, so it is made from these scores
            choice = choice._replace(subgoals=_lowest(score, candidates, belief.width))
        plan = explore_or_finish(belief, look.reachable, choice.subgoals & look.revealing, self.rules)
        cost_to_go = mean_of(choice.estimate)
        state = ExplorationState(look.reachable, choice, look.decided_near, state.estimator)
        return Assessment(plan, look.reachable, candidates, score, cost_to_go, penalty), state

    def revised(self, state: "ExplorationState", changed: Board) -> "ExplorationState":
        """The state without the ground, which can be lost. If observed cells changed, it is time for another choice."""
        choice = state.choice._replace(
            estimated_from=state.choice.estimated_from & ~changed,
            subgoals=jnp.where(bitboard.is_empty(changed), state.choice.subgoals, jnp.uint32(0)),
        )
        return state._replace(reachable=jnp.zeros_like(state.reachable), choice=choice)


class Look(NamedTuple):
    """What a decision of DC2G depends on besides the estimate.

    Attributes:
      reachable: reachable cells.
      revealing: poses that reveal something when reached.
      decided_near: number of decisions near each cell, if `patience` has a price.
    """

    reachable: Board
    revealing: PoseSet
    decided_near: Int[Array, "h w *batch"]


class Choice(NamedTuple):
    """The last choice of a subgoal.

    Attributes:
      estimates: the selection rule's summaries of the latest estimate of each view, the newest first.
      estimated_from: observed cells at the time of the newest estimate.
      view: number of the next view.
      subgoals: poses of lowest score; the plan goes to the nearest.
    """

    estimates: tuple[Estimates, ...]
    estimated_from: Board
    view: Int[Array, "*batch"]
    subgoals: PoseSet

    @property
    def estimate(self) -> Estimates:
        """The mean of the views' estimates."""
        return mean_of(self.estimates)


class ExplorationState(NamedTuple):
    """State of DC2G between steps.

    Attributes:
      reachable: reachable cells at the last step.
      choice: the last choice of a subgoal.
      decided_near: number of decisions near each cell, if `patience` has a price.
      estimator: state of the estimator.
    """

    reachable: Board
    choice: Choice
    decided_near: Int[Array, "h w *batch"]
    estimator: Any


def _lowest(score: Float[Array, "h w *batch"], candidates: PoseSet, width: int) -> PoseSet:
    """The poses on cells of lowest score (Algorithm 2, line 11); none if a score is NaN.

    Ties are all kept: the plan goes to the nearest.
    """
    chosen_from = bitboard.unpack(poses.occupied(candidates), width)
    # Integers in the order of the scores, NaN first. XLA has no code for the least float within an operation.
    least, most = jnp.iinfo(jnp.int32).min, jnp.iinfo(jnp.int32).max
    bits = jax.lax.bitcast_convert_type(score + 0.0, jnp.int32)
    order = jnp.where(score == score, jnp.where(bits < 0, bits ^ most, bits), least)
    order = jnp.where(chosen_from, order, most)
    lowest = apart(functools.partial(jnp.min, axis=(0, 1)), order)
    return candidates & bitboard.pack(chosen_from & (score == score) & (order == lowest))
