"""Planners: their interface, and those of the paper.

Worlds, beliefs and states are those of one robot or of a batch, whose axes come last.

A planner is a frozen dataclass and a pytree. Learned parameters (an estimator's weights) are its leaves; rules are
static. So one compiled program serves every checkpoint of the same architecture.
"""

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax._src.estimation.estimators import Estimates, Estimator, trait, update_where
from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief, check_axes, check_poses
from dc2g_jax._src.grid.poses import PoseSet, every_heading
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.terrain import OUTSIDE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.planning.nearby import Decided, nearby
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.planning.selection import ExpectedCost, Selection, mean_of, only_outcome
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
      penalty: part of the score beyond cost-to-go and the way to the candidate; `None` for planners without one.
    """

    plan: Plan
    ground: Board
    candidates: PoseSet
    score: Float[Array, "h w *batch"] | None = None
    cost_to_go: Float[Array, "h w *batch"] | None = None
    penalty: Float[Array, "h w *batch"] | None = None


#: The answer to a planner that asks, for a belief and its state: arrays, batch axes last.
Ask = Callable[[Belief, Any], Any]


class Planner:
    """The interface of a planner. All methods are pure and traced.

    A class with `init` and `plan` is a planner, whether it derives from this one or not. Everything else may be left
    out. Define one of these; each one calls the next:

    - `plan`, the next action;
    - `assess`, the same with its inputs, for figures, recordings and `OnlinePlanner`;
    - `look`, `ask` and `conclude`, for a planner that asks now and then, for example for an estimate. A rollout on a
      CPU runs each robot by itself until it asks, then asks for all robots together: a network or a choice needs less
      time per map in larger batches, and everything else is faster for a single robot.

    Attributes:
      batch_per_core: number of robots to simulate side by side on one CPU core. One is fastest, except
        for computing answers.
      knows_outside: whether it takes maps in a larger grid of `OUTSIDE` cells, as `OnlinePlanner` pads them.
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
        """Whether the planner asks, and what its decision needs besides the answer."""
        raise NotImplementedError("a planner needs a method plan")

    def ask(self, belief: Belief, state: Any) -> Any:
        """The answer, such as an estimator's: arrays, batch axes last."""
        raise NotImplementedError("a planner with a method look needs a method ask")

    def conclude(self, belief: Belief, state: Any, looked: Any, ask: Ask) -> tuple[Assessment, Any]:
        """Decide the next action.

        Args:
          belief: what the robot knows.
          state: state of the planner.
          looked: the result of `look`.
          ask: `(belief, state) ->` the answer.
        """
        raise NotImplementedError("a planner with a method look needs a method conclude")

    def revised(self, state: Any, changed: Board) -> Any:
        """The state without what is invalid after these cells changed their class, as on maps from a camera.

        Cells may also be given that are observed for the first time: the planner then chooses again.
        """
        raise InputError(f"planner {type(self).__name__}: maps change here, and it has no method revised; define one")


#: A planner: any object with `init` and `plan`, whether it derives from `Planner` or not.
PlannerLike = Any


def _inherits(planner: PlannerLike, *methods: str) -> bool:
    """Whether these methods of a planner are those of `Planner`."""
    return all(getattr(type(planner), method, None) is getattr(Planner, method) for method in methods)


def can_be_revised(planner: PlannerLike) -> bool:
    """Whether a planner, and the one that it wraps if any, has a method `revised` of its own."""
    wrapped = getattr(planner, "planner", None)
    own = hasattr(planner, "revised") and not _inherits(planner, "revised")
    return own and (wrapped is None or can_be_revised(wrapped))


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
        own, others = f"{sensing.radius} cells", str(given.radius)
        remedy = "settings and sensing_range"
        if None not in (sensing.degrees, given.degrees) and sensing.degrees != given.degrees:
            own, others = f"{own} and {sensing.degrees:g} degrees", f"{others} and {given.degrees:g}"
            remedy = "settings, sensing_range and field_of_view"
        elif sensing.radius == given.radius:
            others += " of another kind"
        raise InputError(
            f"{who}: was made for a field of view of {own}, and the robots here have one of {others}; make it with the "
            f"same {remedy}"
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
        """The reachable cells; none if cells changed, since some of them may be lost."""
        return jnp.where(bitboard.is_empty(changed), state, jnp.uint32(0))


def preferred_poses(belief: Belief, reachable: Board, revealing: PoseSet, rules: Rules) -> PoseSet:
    """The frontier-expanding poses of those that reveal something; without any, all that do."""
    preferred = rules.frontier_expanding(belief, reachable) & revealing
    return jnp.where(poses.is_empty(preferred), revealing, preferred)


class SubgoalPlanner(Planner):
    """A planner that keeps to its subgoals until they reveal nothing more, or enough has been seen since.

    Its state is a NamedTuple that has the `reachable` cells of the last step; `subgoals`, the poses chosen last; and
    `chosen_from`, the cells that had been observed then.

    Attributes:
      rules: field of view.
      replan_fraction: share of the cells in the field of view that must be newly seen; at least one cell must.
    """

    rules: Rules
    replan_fraction: float = 0.0

    def choices(self, belief: Belief, reachable: Board) -> PoseSet:
        """The poses to choose from: those that reveal something when reached."""
        return frontiers.complete(belief, reachable, self.rules.sensing)

    def look(self, belief: Belief, state: Any) -> tuple[Bool[Array, "*batch"], Any]:
        """Whether another choice is due; this again, reachable cells, and the poses to choose from."""
        reachable = reachable_cells(belief, state.reachable)
        choices = self.choices(belief, reachable)
        undecided = ~poses.is_empty(choices) & ~bitboard.intersects(reachable, belief.goals)
        news = bitboard.count(belief.seen ^ state.chosen_from)
        enough = max(1.0, self.replan_fraction * len(self.rules.sensing.offsets[0]))
        due = undecided & ((news >= enough) | poses.is_empty(state.subgoals & choices))
        return due, (due, reachable, choices)

    def revised(self, state: Any, changed: Board) -> Any:
        """The state as if these cells had not been observed.

        If there are any, reachable cells may be lost, and another choice is due.
        """
        same = bitboard.is_empty(changed)
        return state._replace(
            reachable=jnp.where(same, state.reachable, jnp.uint32(0)),
            chosen_from=state.chosen_from & ~changed,
            subgoals=jnp.where(same, state.subgoals, jnp.uint32(0)),
        )


def with_summary(estimator: Estimator, summary: Callable[[Array], Array]) -> tuple[Estimator, Callable[[Array], Array]]:
    """The estimator that computes the summary itself, if there is one, and what is left to summarize of its answer."""
    if getattr(summary, "linear", False) and hasattr(estimator, "summarized"):
        return estimator.summarized(summary), only_outcome
    return estimator, summary


def summarized(
    estimator: Estimator, summary: Callable[[Array], Array], terrain: UInt8[Array, "h w *batch"], state: Any
) -> Estimates:
    """The summary of an estimate, such as its mean.

    Args:
      estimator: the estimator.
      summary: summary of its outcomes, see `planning.selection`.
      terrain: observed class indices.
      state: state of the estimator.

    Raises:
      InputError: the estimate does not have the shape `[outcomes, *shape of the map]`.
    """
    asked, summary = with_summary(estimator, summary)
    costs = asked.estimate(terrain, state)
    if costs.shape[1:] != terrain.shape:
        raise InputError(
            f"{type(estimator).__name__} answers with {list(costs.shape)} for a map of {list(terrain.shape)}; "
            "give [outcomes, *shape of the map], with one outcome at least"
        )
    return summary(costs).astype(jnp.float32)


@struct.dataclass
class DC2G(SubgoalPlanner):
    """Deep Cost-to-Go (Algorithm 2): go to the frontier-expanding pose with the lowest estimated cost-to-go.

    Candidates are the frontier-expanding poses of the rules that reveal something when reached; if there are none, all
    poses that do. So exploration always ends, under all rules. (The `complete` rules have no other poses; with the
    `reference` rules alone, a robot can move back and forth forever between two poses that reveal nothing.)

    Unlike this planner, the authors' published code drops no poses, and takes the first of equally good cells in raster
    order, not the nearest. Its robot goes to that cell in any heading. There, it turns to the frontier-expanding
    heading that is fewest left turns away, and left if it has one already.

    The estimator is asked whenever something new has been seen.

    Attributes:
      estimator: maps a partial map to costs-to-go; lower is better.
      rules: field of view and definition of frontiers.
      selection: rule that scores subgoals; by default the paper's.
    """

    estimator: Estimator
    rules: Rules = struct.field(pytree_node=False)
    selection: Selection = struct.field(pytree_node=False, default=ExpectedCost(distance_weight=0.0))
    batch_per_core: ClassVar[int] = 16

    @property
    def knows_outside(self) -> bool:  # type: ignore[override]
        """See `Planner`: if its estimator does."""
        return trait(self.estimator, "knows_outside")

    def init(self, world: World) -> "Choice":
        """Nothing is reachable before the first observation. The estimator initializes its own state."""
        nothing, state = jnp.zeros_like(world.traversable), self.estimator.init(world)
        told = jax.eval_shape(
            functools.partial(summarized, self.estimator, self.selection.summary), world.terrain, state
        )
        prior = trait(self.estimator, "extent").prior
        return Choice(nothing, jnp.full(told.shape, prior, jnp.float32), nothing, every_heading(nothing), state)

    def _scored(
        self, belief: Belief, reachable: Board, revealing: PoseSet, estimate: Estimates
    ) -> tuple[PoseSet, Float[Array, "h w *batch"]]:
        """The candidates, and the score of each cell with one (Algorithm 2, lines 6 to 10)."""
        candidates, lengths = preferred_poses(belief, reachable, revealing, self.rules), jnp.int32(0)
        if self.selection.distance_weight:
            candidates, lengths = search.nearest_headings(belief.pose, candidates, reachable, belief.width)
        return candidates, self.selection(estimate, lengths)

    def ask(self, belief: Belief, state: "Choice") -> Estimates:
        """The selection rule's summary of an estimate."""
        part = trait(self.estimator, "extent").part(observed_terrain(belief), belief.pose)
        return summarized(self.estimator, self.selection.summary, part, state.estimator)

    def _choose(self, inputs: tuple[Belief, Board, PoseSet], before: "Choice", ask: Ask) -> "Choice":
        """A new estimate, and the subgoals of lowest score with it (Algorithm 2, lines 6 to 11)."""
        belief, reachable, revealing = inputs
        estimate = trait(self.estimator, "extent").merged(ask(belief, before), belief.pose, before.estimate)
        candidates, score = self._scored(belief, reachable, revealing, estimate)
        return before._replace(
            estimate=estimate, chosen_from=belief.seen, subgoals=_lowest(score, candidates, belief.width)
        )

    def conclude(self, belief: Belief, state: "Choice", looked: Any, ask: Ask) -> "tuple[Assessment, Choice]":
        """Head for the most promising frontier-expanding pose, or for the goal once it is reachable.

        The scores are the current ones; the subgoal had the lowest when it was chosen.
        """
        _, (due, reachable, revealing) = looked
        state = update_where(functools.partial(self._choose, ask=ask), due, (belief, reachable, revealing), state)
        candidates, score = self._scored(belief, reachable, revealing, state.estimate)
        plan = explore_or_finish(belief, reachable, state.subgoals & revealing, self.rules)
        state = state._replace(reachable=reachable)
        return Assessment(plan, reachable, candidates, score, mean_of(state.estimate)), state


class Choice(NamedTuple):
    """State of DC2G between steps.

    Attributes:
      reachable: reachable cells at the last step.
      estimate: the selection rule's summary of the latest estimate.
      chosen_from: cells that had been observed when the subgoals were chosen.
      subgoals: poses of lowest score then; the plan goes to the nearest.
      estimator: state of the estimator.
    """

    reachable: Board
    estimate: Estimates
    chosen_from: Board
    subgoals: PoseSet
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
